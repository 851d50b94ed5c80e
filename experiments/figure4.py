"""
Figure 4: steps per episode of Q-learning in Taxi, by action set (section 7.3).

One cell is one person's options, or those of one extraction, or none, learned with by several
learners. Every action set has the same budget: as many rates are tried, in as many runs, and the
best of them learn anew with other chance.
"""

from collections.abc import Mapping
from typing import Any

from humanopts_env.domains.taxi import Taxi
from humanopts_env.seeding import generator
from humanopts_learner.automatic.extract import find_options
from humanopts_learner.options.option import option_tables
from humanopts_learner.planning.action_sets import (
    AUTOMATIC,
    AUTOMATIC_AND_PRIMITIVE,
    HUMAN,
    HUMAN_AND_PRIMITIVE,
    PRIMITIVE,
    TabledOption,
)
from humanopts_learner.qlearning.choices import choices_of
from humanopts_learner.qlearning.curves import best_rates, drawn_rates
from humanopts_learner.qlearning.learn import learn, Method

from experiments import paper
from experiments.cells import Cell
from experiments.study import Study
from experiments.taught import options_of, teachers

NAME, DOMAIN = 'fig4', 'taxi'
SETS = {  # what is learned with: whose options, and the action set
    'primitive': ('nobody', PRIMITIVE),
    'human': ('person', HUMAN),
    'automatic': ('machine', AUTOMATIC),
    'human + primitive': ('person', HUMAN_AND_PRIMITIVE),
    'automatic + primitive': ('machine', AUTOMATIC_AND_PRIMITIVE),
}
METHODS = tuple(method.value for method in Method)
LIMIT = 1000  # steps of an episode at most; the domain's own 200 would hide how long they get
TRIED, TRIALS = 10, 3  # rates that are tried, and learners for each
COSTS = {'nobody': 2.0, 'person': 2.0, 'machine': 2.0}


def cells(study: Study) -> list[Cell]:
    """Return one cell for each method, action set, and person, extraction or repetition."""
    people = [teacher.parameters for teacher in teachers(study, DOMAIN)]
    numbers = range(1, (len(people) or study.participants) + 1)
    sources: dict[str, list[dict[str, Any]]] = {
        'nobody': [{'number': number} for number in numbers],
        'person': [{'teacher': dict(known)} for known in people],
        'machine': [{'extraction': study.seed + number - 1} for number in numbers],
    }
    return [
        Cell(
            NAME,
            {
                'set': name,
                'method': method,
                'learners': study.seeds,
                'episodes': paper.EPISODES,
                'seed': study.seed,
                **source,
            },
            compute,
            COSTS[whose],
        )
        for method in METHODS
        for name, (whose, _) in SETS.items()
        for source in sources[whose]
    ]


def compute(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """
    Learn with one action set.

    :return: mean steps of the learners by episode, the rates, and the names of the options.
    """
    domain, chosen = Taxi(), SETS[parameters['set']][1]
    options = _options(parameters, domain)
    choices = choices_of(domain, chosen, options)
    method, episodes = Method(parameters['method']), parameters['episodes']
    search, judging = (_seed(parameters, purpose) for purpose in ('search', 'judging'))
    rates = drawn_rates(parameters['seed'], TRIED)
    best = best_rates(domain, choices, rates, TRIALS, episodes, search, method, LIMIT)
    learners = [best] * parameters['learners']
    judged = learn(domain, choices, learners, episodes, judging, method, max_steps=LIMIT)
    return {
        'steps': judged.steps.mean(axis=0).tolist(),
        'learning_rate': best.learning_rate,
        'explore': best.explore,
        'options': [option.name for option in options],
    }


def _options(parameters: Mapping[str, Any], domain: Taxi) -> list[TabledOption]:
    if 'teacher' in parameters:
        taught = options_of(parameters['teacher'], domain).options
        return [TabledOption(o.name, o.max_steps, option_tables(o, domain)) for o in taught]
    if 'extraction' in parameters:
        return list(find_options(domain, parameters['extraction']).tabled)
    return []


def _seed(parameters: Mapping[str, Any], purpose: str) -> int:
    """Return a seed that differs between cells that differ in whose options they have."""
    source = [str(parameters.get(name)) for name in ('number', 'teacher', 'extraction')]
    rng = generator(parameters['seed'], 'figure 4', purpose, *source)
    return int(rng.integers(2**31))
