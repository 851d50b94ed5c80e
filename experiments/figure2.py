"""
Figure 2: accuracy of learned options against the number of demonstrations (section 7.1).

*Policy accuracy* is here the share of states in the option's initiation set in which the learned
policy takes one of the best actions; the paper compares returns. *Classification accuracy* of I
and beta is the share of states that are classified as the reference option does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.options.start_states import STRATEGIES
from humanopts_teach.bags.contents import read_domain
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.evaluation.summary import accuracies
from humanopts_teach.lesson.start_states import LessonRules

from experiments import paper
from experiments.cells import Cell
from experiments.lessons import teach
from experiments.people import CAREFUL, Participant, participants, VARIED
from experiments.study import BagLesson, Study, taught_in

NAME = 'fig2'
SHOWN = {'taxi': 60, 'pacman': 40}  # demonstrations of an option by one person
ASKED = 6  # at most so many start states for each of these, "not here" answers included
GROUPS = {'taxi': (CAREFUL, VARIED), 'pacman': (VARIED,)}
COSTS = {  # of a cell by domain and strategy; others: 1
    ('pacman', 'random'): 4.0,
    ('pacman', 'coverage'): 20.0,
    ('pacman', 'failures'): 12.0,
}


def cells(study: Study) -> list[Cell]:
    """Return one cell for each person, option and strategy."""
    if study.bags:
        return [Cell(NAME, asdict(lesson), again) for lesson in study.bags]
    return [
        _cell(domain, option, strategy, person)
        for domain, options in paper.TAUGHT.items()
        for group in GROUPS[domain]
        for person in participants(group, study.participants, study.seed)
        for option in options
        for strategy in STRATEGIES
    ]


def _cell(domain: str, option: str, strategy: str, person: Participant) -> Cell:
    parameters = {
        'domain': domain,
        'option': option,
        'strategy': strategy,
        'demonstrations': SHOWN[domain],
        'person': person.to_dict(),
    }
    return Cell(NAME, parameters, simulated, COSTS.get((domain, strategy), 1.0))


def simulated(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """
    Have a simulated participant teach an option, and measure it after every demonstration.

    :return: points [demonstrations, "not here" answers, policy accuracy, that of I, that of beta],
        the person's seconds, and why the lesson was cut short (empty: it was not).
    """
    person = Participant.from_dict(parameters['person'])
    domain = make_domain(parameters['domain'])
    name, wanted = parameters['option'], parameters['demonstrations']
    reference, points = reference_options(domain)[name], []

    def measure(shown: Sequence[Demonstration], option: LearnedOption) -> bool:
        points.append(_point(option, accuracies(option, domain, reference)))
        return bool(option.n_demonstrations >= wanted)

    rules = LessonRules(parameters['strategy'], budget=ASKED * wanted, seed=person.seed)
    taught = teach(domain, person.teaching(name), rules, measure)
    return {'points': points, 'seconds': taught.seconds, 'cut_short': taught.cut_short}


def again(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Learn again what a person taught in a bag; as ``simulated``."""
    lesson = BagLesson(**parameters)
    bag = open_bag(Path(lesson.bag))
    domain = read_domain(bag)
    demos = taught_in(bag, domain)[lesson.participant, lesson.option]
    reference, points = reference_options(domain).get(lesson.option), []
    for count in range(1, len(demos) + 1):
        if any(demo.kind is Kind.TRAJECTORY for demo in demos[:count]):
            option = learn_option(demos[:count], domain, lesson.seed)
            points.append(_point(option, accuracies(option, domain, reference)))
    seconds = sum(demo.seconds for demo in demos)
    return {'points': points, 'seconds': seconds, 'cut_short': ''}


def _point(option: LearnedOption, measured: Sequence[float | None]) -> list[float | None]:
    return [option.n_demonstrations, option.n_not_here, *measured]
