"""
Planning in a world without known rules: when to deliver, and when to charge the battery.

This goes beyond the paper. The world is ``examples/own_robot/street.py``; the learner knows
only what the node publishes. In a trial, a simulated person demonstrates two options, *deliver*
and *charge*; neither depends on the battery. The machine then drives ``EPISODES`` episodes. Its
later choices are compared with a hand-written rule and with random choice.

The options run as in a live game (``humanopts_learner.run``), and their runs are assembled from
states, goals and results as in the node ``planner``.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any
from uuid import NAMESPACE_OID, uuid5

from humanopts_env.domains.base import Action, Feature
from humanopts_env.domains.described import DescribedDomain, SeenState
from humanopts_env.game import Transition
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.intervals import Interval
from humanopts_learner.option_runs import OptionRun, RunCollector
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.columns import suggest_column
from humanopts_learner.planning.recorded_plan import (
    make_recorded_plan,
    MIN_SAMPLES,
    OptionLearner,
    RecordedPlan,
)
from humanopts_learner.planning.request import HUMAN, PlanRequest, Sampling
from humanopts_learner.run import Run
from humanopts_teach.report.figures import Drawing
import numpy as np
import pandas as pd

from experiments import report
from experiments.people import Study
from experiments.trials import Rows, Trial

NAME = 'battery'
TITLE = 'Plans in a world that cannot be simulated'
LESSONS = 20
COST = 15.0
EPISODES = 100  # driven before each plan
JUDGED = 100  # episodes for judging each policy
SHOWN = 8  # demonstrations per option
LOW = 40.0  # charge below which the person charges, %
RULE_AT = 36.0  # charge below which the rule charges, %: the best of 30, 32, ..., 40
DELIVER, CHARGE = 'deliver', 'charge'
WAYS = {DELIVER: ('target_way', 'drop', 'delivered'), CHARGE: ('charger_way', 'plug', 'charged')}
HERE = 2.0  # value of a ``*_way`` feature at the place itself
RULE, RANDOM = 'hand-written rule', 'random choice'
MODELS, Q_LEARNING = 'models of recorded runs', 'Q-learning while driving'
SYMBOLS, ASKED = 'symbols of the options', 'symbols and the battery'
KEYS = ['policy', 'abstract states']
NEAR, MORE = 0.95, 1.8  # goals: minimum ratios to the rule, and to random choice
Choose = Callable[[SeenState, np.random.Generator], str]  # the next option


@cache
def world() -> Any:
    """Load the module of the world from its file; the example is not installed."""
    path = Path(__file__).parents[1] / 'examples' / 'own_robot' / 'street.py'
    spec = spec_from_file_location('street', path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def described() -> DescribedDomain:
    """Return the description of the world as a domain."""
    street = world()
    return DescribedDomain(
        'street',
        {},
        [
            Feature.nominal(name, question, values)
            if values
            else Feature.continuous(name, question, 0.0, street.FULL, '%')
            for name, (question, values) in street.FEATURES.items()
        ],
        [Action(name, key, text) for name, (key, text) in street.ACTIONS.items()],
        street.GAMMA,
        street.MAX_STEPS,
    )


def state_of(street: Any) -> SeenState:
    """Return the state that a street publishes."""
    return SeenState(repr(street.features()), tuple(street.features()), street.empty)


def value_of(state: SeenState, name: str) -> float:
    """Return the value of a feature."""
    return state.features[[*world().FEATURES].index(name)]


def demonstrate(name: str, number: int, seed: int) -> Demonstration:
    """Demonstrate an option where the person would choose it: charge if the battery is low."""
    domain, street = described(), world().Street()
    street.reset(int(generator(seed, NAME, 'teacher', name, number).integers(2**31)))
    low, high = (0.5 * LOW, LOW) if name == CHARGE else (LOW, world().FULL)
    street.battery = street.chance.uniform(low, high)
    street.errand = street.chance.choice(world().ERRANDS)  # the previous one
    way, action, errand = WAYS[name]
    states, actions, rewards = [state_of(street)], list[str](), list[float]()
    while street.errand != errand or not actions or value_of(states[-1], 'base_way') != HERE:
        done = world().ERRANDS[int(value_of(states[-1], 'errand'))] == errand
        home = done and value_of(states[-1], 'base_way') != HERE
        toward = world().WAYS[int(value_of(states[-1], 'base_way' if home else way))]
        actions.append(action if toward == 'here' else toward)
        rewards.append(street.step(actions[-1]))
        states.append(state_of(street))
    return Demonstration(
        Kind.TRAJECTORY,
        str(uuid5(NAMESPACE_OID, f'{name} {number} {seed}')),
        domain.name,
        '{}',
        'p1',
        's1',
        option_name=name,
        number=number,
        chosen_features=('base_way', way, 'errand'),
        feature_names=tuple(feature.name for feature in domain.features),
        features=tuple(state.features for state in states),
        states=tuple(state.text for state in states),
        actions=tuple(actions),
        rewards=tuple(rewards),
        can_start_at_end=True,
    )


def taught(seed: int) -> tuple[list[LearnedOption], str]:
    """Return the learned options and the column suggested by their demonstrations."""
    shown = {
        name: [demonstrate(name, number, seed) for number in range(1, SHOWN + 1)] for name in WAYS
    }
    options = [learn_option(demos, described(), seed) for demos in shown.values()]
    return options, suggest_column(described(), options, shown)


def drive(
    options: Sequence[LearnedOption],
    choose: Choose,
    episodes: int,
    seed: int,
    on_run: Callable[[OptionRun], object] = lambda run: None,
) -> list[float]:
    """
    Drive episodes as ``run_policy`` does, and return the number of deliveries in each.

    :param on_run: callback that receives each run of an option.
    """
    domain, street, named = described(), world().Street(), {each.name: each for each in options}
    collector, returns = RunCollector(domain), []
    for episode in range(1, episodes + 1):
        street.reset(int(generator(seed, NAME, 'start', episode).integers(2**31)))
        rng, total = generator(seed, NAME, 'choices', episode), 0.0
        step, state = 0, state_of(street)
        collector.on_state('', Transition(episode, 0, state.text, state.features))
        while not (street.empty or street.cut_off):
            option = named[choose(state, rng)]
            run = Run(option, domain, state, (episode, step), unstick=rng)
            end = None
            while end is None:
                action = domain.actions[run.next_action()].name
                reward, step = street.step(action), step + 1
                state, total = state_of(street), total + reward
                collector.on_state(
                    '',
                    Transition(episode, step, state.text, state.features, action, reward=reward),
                )
                end = run.observe(state, reward, street.empty, street.cut_off)
            for found in collector.on_result(end):
                on_run(found)
        returns.append(total)
    return returns


def at_random(state: SeenState, rng: np.random.Generator) -> str:
    """Choose one of the options at random."""
    return (DELIVER, CHARGE)[int(rng.integers(2))]


def by_rule(state: SeenState, rng: np.random.Generator) -> str:
    """Charge if the battery is low, otherwise deliver."""
    return CHARGE if value_of(state, 'battery') < RULE_AT else DELIVER


def greedy(plan: RecordedPlan) -> Choose:
    """Return a function that chooses by a plan."""
    return lambda state, rng: plan.choose(state).name


def trials(study: Study) -> list[Trial]:
    """Return one trial per lesson; none if the study uses bags."""
    lessons = 0 if study.bags else study.participants
    return [
        Trial(NAME, {'lesson': lesson, 'seed': study.seed}, give_lesson, COST)
        for lesson in range(1, lessons + 1)
    ]


def give_lesson(parameters: Mapping[str, Any]) -> Rows:
    """
    Teach the options, drive, plan, and judge every policy in the same episodes.

    :return: one row per policy and kind of abstract states: deliveries (mean per episode), states
        (number of abstract states), runs (number recorded).
    """
    lesson = int(generator(parameters['seed'], NAME, parameters['lesson']).integers(2**31))
    options, column = taught(lesson)
    domain, rows = described(), []

    def judge(policy: str, kind: str, choose: Choose, **known: int) -> None:
        deliveries = float(np.mean(drive(options, choose, JUDGED, lesson + 1)))
        rows.append({**dict(zip(KEYS, (policy, kind))), 'deliveries': deliveries, **known})

    judge(RULE, '', by_rule)
    judge(RANDOM, '', at_random)
    tried: list[OptionRun] = []
    drive(options, at_random, EPISODES, lesson, tried.append)
    for name, columns in ((SYMBOLS, ()), (ASKED, (column,))):
        sampling = Sampling(min_samples=MIN_SAMPLES)
        request = PlanRequest(HUMAN, columns=columns, sampling=sampling)
        for policy in (MODELS, Q_LEARNING):
            runs, learner = list(tried), None
            if policy == Q_LEARNING:
                learner = OptionLearner.of(domain, options, (), request)
                runs = learned_runs(options, learner, lesson)
            plan = make_recorded_plan(domain, options, runs, request, learner)
            found = {'states': len(plan.solution.values), 'runs': plan.recorded_runs}
            judge(policy, name, greedy(plan), **found)
    return rows


def learned_runs(
    options: Sequence[LearnedOption], learner: OptionLearner, seed: int
) -> list[OptionRun]:
    """Let the machine learn while driving, and return its runs."""
    runs: list[OptionRun] = []

    def on_run(run: OptionRun) -> None:
        runs.append(run)
        learner.learn(run)

    drive(options, lambda state, rng: learner.choose(state, rng).name, EPISODES, seed, on_run)
    return runs


def present(rows: pd.DataFrame) -> report.Section:
    """Return the report section from one row per lesson, policy and kind of abstract states."""
    lessons = rows.drop(columns='trial', errors='ignore')
    summary = report.mean_intervals(lessons, KEYS, 'deliveries')
    means = lessons.groupby(KEYS, sort=False)[['states', 'runs']].mean()
    summary = summary.rename(columns={'count': 'lessons', 'mean': 'deliveries'})
    tables = [
        report.Table('battery-summary', 'Deliveries per episode', summary.join(means, on=KEYS)),
        report.Table('battery-lessons', 'Each lesson', lessons, shown=False),
    ]
    picture = report.Picture(
        'battery',
        'Deliveries per episode: the dots are lessons, the bars means with 95 % intervals.',
        (7.6, 3.2),
        partial(_draw, lessons),
    )
    facts = {'episodes': EPISODES, 'judged': JUDGED}
    return report.Section(NAME, TITLE, _comparisons(lessons), [picture], tables, facts)


def _comparisons(lessons: pd.DataFrame) -> list[report.Comparison]:
    """Compare the plans with the rule and with random choice, lesson by lesson."""
    of = {keys: mine['deliveries'].to_numpy() for keys, mine in report.grouped(lessons, KEYS)}
    rule, chance, found = of[RULE, ''], of[RANDOM, ''], []
    case = f'{len(rule)} lessons'
    for policy in (MODELS, Q_LEARNING):
        plan, blind = of[policy, ASKED], of[policy, SYMBOLS]
        near, more = Interval.of_ratio(plan, rule), Interval.of_ratio(plan, chance)
        said = f'{policy}: at least {NEAR:g} of the deliveries of the rule.'
        found.append(report.compare(said, near.above(NEAR), case, {'share': near}, '.3f'))
        said = f'{policy}: at least {MORE:g} times the deliveries of random choice.'
        found.append(report.compare(said, more.above(MORE), case, {'times': more}, '.3f'))
        less = Interval.of_ratio(blind, chance)
        said = f'{policy}, by the symbols of the options alone: fewer deliveries than by chance.'
        found.append(report.compare(said, less.below(1.0), case, {'times': less}, '.3f'))
    return found


def _draw(lessons: pd.DataFrame, work: Drawing) -> None:
    rows = lessons.assign(way=lessons[KEYS].agg(', '.join, axis=1).str.strip(', '), series='')
    style = {'ms': 3.5, 'alpha': 0.5}
    report.draw_samples(work.axes, rows, 'way', 'deliveries', 'series', Interval.of, **style)
    work.axes.set(xlabel='mean deliveries per episode')
