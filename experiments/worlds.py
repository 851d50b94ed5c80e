"""
Options taught in environments that can only be reset and stepped.

This goes beyond the paper. In a trial, a simulated teacher teaches all options of an environment
with a few demonstrations each. The teacher makes no errors, and has the reference option's
preference among equally good actions. Then the options run from starts that were never
demonstrated, and a plan with them plays unseen episodes. An option *succeeds* if it reaches the
teacher's end within twice the steps; the plan succeeds if it completes the task in the step limit.

Two other kinds of trials compare options from segments of whole plays with options from as many
separate demonstrations, and tabular Q-learning over taught options with that over primitive
actions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import gymnasium
from humanopts_env import OptionsEnv
from humanopts_env.domains.base import Domain
from humanopts_env.domains.formulas import feature_columns
from humanopts_env.domains.reference import reached, ReferenceOption
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.games import games_at
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, make_demonstration
from humanopts_learner.intervals import all_hold, Interval
from humanopts_learner.option import Option
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.request import HUMAN, PlanRequest
from humanopts_learner.planning.sampled_plan import make_sampled_plan
from humanopts_learner.qlearning import EnvLearner
from humanopts_learner.segments import cut, event_features, joined
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.simulated_teacher import TeacherSettings
from humanopts_teach.report.pages import counted
import numpy as np
import pandas as pd

from experiments import paper, report
from experiments.people import Study
from experiments.trials import Rows, Trial

NAME = 'worlds'
TITLE = 'Options taught in other environments'
LESSONS = 20
STARTS, LAYOUTS = 50, 200  # unseen starts of each option; unseen episodes of each plan
WHOLE_TASK = 'whole task'
KEYS = ['case', 'option']
PLAYS = {'taxi': 30, 'gymnasium:MiniGrid-DoorKey-8x8-v0': 6}  # whole plays per lesson
LEARNERS, EPISODES = 10, 100  # lessons with Q-learning, and episodes in each
SOLVED = 0.9  # minimum share of unseen episodes, and of lessons
LESS = 0.05  # maximum loss of success by options from segments
COST = 3.0  # approximate processor seconds of a trial


@dataclass(frozen=True)
class Case:
    """An environment, and the demonstrations and the goal of a lesson in it."""

    environment: str  # id
    shown: int  # demonstrations of each option
    goal: float  # minimum success of each option, or of the plan if there are several
    where_stuck: int = 0  # maximum further demonstrations where the plan gets stuck
    played_in: str = ''  # environment to play in; empty: the same


CASES = {
    'DoorKey-8x8': Case('MiniGrid-DoorKey-8x8-v0', 3, 0.99, 3),
    'KeyCorridorS3R2': Case('MiniGrid-KeyCorridorS3R2-v0', 3, 0.99, 3),
    'UnlockPickup': Case('MiniGrid-UnlockPickup-v0', 5, 0.99, 5),
    'DoorKey-6x6, played in 16x16': Case(
        'MiniGrid-DoorKey-6x6-v0', 5, 0.95, 3, 'MiniGrid-DoorKey-16x16-v0'
    ),
    'LavaCrossingS9N2': Case('MiniGrid-LavaCrossingS9N2-v0', 3, 0.99),
    'FourRooms': Case('MiniGrid-FourRooms-v0', 3, 0.99),
    'LunarLander': Case('LunarLander-v3', 2, 0.9),
    'MountainCar': Case('MountainCar-v0', 1, 0.9),
    'Acrobot': Case('Acrobot-v1', 1, 0.9),
}


def trials(study: Study) -> list[Trial]:
    """Return one trial per lesson and case; none if the study uses bags."""
    lessons = 0 if study.bags else study.participants
    work = [
        *(({'case': name}, teach_in_world) for name in CASES),
        *(({'case': 'segments', 'domain': name}, teach_by_whole_plays) for name in PLAYS),
        ({'case': 'Q-learning'}, learn_to_choose),
    ]
    return [
        Trial(NAME, {**parameters, 'lesson': lesson, 'seed': study.seed}, compute, COST)
        for lesson in range(1, lessons + 1)
        for parameters, compute in work
        if compute is not learn_to_choose or lesson <= LEARNERS
    ]


def _seed(parameters: Mapping[str, Any]) -> int:
    """Return the seed of a trial."""
    key = [str(value) for name, value in parameters.items() if name != 'seed']
    return int(generator(parameters['seed'], NAME, *key).integers(2**31))


def _taught(domain: Domain, case: Case, seed: int) -> Sequence[LearnedOption]:
    def enough(shown: Sequence[Demonstration], option: LearnedOption) -> bool:
        return option.n_demonstrations >= case.shown

    teacher = TeacherSettings((*reference_options(domain),), seed=seed)
    rules = LessonRules(seed=seed, until_no_failures=False)
    return teach(domain, teacher, rules, enough, case.where_stuck).options


def teach_in_world(parameters: Mapping[str, Any]) -> Rows:
    """
    Teach the options of an environment once.

    :return: one row per option, and one for the plan if there are several options: success (share
        of unseen starts), teacher (the teacher's share), demonstrations, where stuck (number of
        these given where the plan got stuck), not here (answers).
    """
    case, seed = CASES[parameters['case']], _seed(parameters)
    domain, there = world(case.environment), world(case.played_in or case.environment)
    options = {option.name: option for option in _taught(domain, case, seed)}
    rows = list[dict[str, Any]]()
    for name in reference_options(there):
        starts = starts_of(there, name, seed)
        row = {'option': name, 'teacher': float(np.mean([steps > 0 for _, steps in starts]))}
        # Skip starts from which the teacher itself fails.
        starts = [start for start in starts if start[1]]
        option = options.get(name)
        if option is None:  # never demonstrated
            rows.append({**row, 'success': 0.0})
            continue
        rows.append(
            {
                **row,
                'success': success(option, there, starts),
                'demonstrations': option.n_demonstrations,
                'where stuck': max(option.n_demonstrations - case.shown, 0),
                'not here': option.n_not_here,
            }
        )
    if len(rows) > 1 and not case.played_in:
        total = {
            name: sum(int(row.get(name, 0)) for row in rows)
            for name in ('demonstrations', 'where stuck', 'not here')
        }
        played = play_plan(domain, [*options.values()], seed)
        rows.append({'option': WHOLE_TASK, **total, **played})
    return [{'case': parameters['case'], **row} for row in rows]


@cache
def world(name: str) -> Domain:
    """Return the domain of an environment."""
    return make_domain(f'gymnasium:{name}')


def starts_of(domain: Domain, name: str, seed: int, count: int = STARTS) -> list[tuple[Any, int]]:
    """
    Draw starts of an option: states reached from resets by the teacher's preceding options.

    :return: start states, each with the number of steps that the teacher needs; 0: it fails.
    """
    rng, found = generator(seed, 'unseen starts', name), list[tuple[Any, int]]()
    references = reference_options(domain)
    option, before = references[name], [*references][: [*references].index(name)]
    while len(found) < count:
        state = domain.reset(rng)
        for each in before:
            state = led(domain, references[each], state)[0][-1]
        if option.can_start(state):
            states, actions = led(domain, option, state)
            found.append((state, len(actions) if reached(option, states[-1]) else 0))
    return found


def led(domain: Domain, option: ReferenceOption, state: Any) -> tuple[list[Any], list[str]]:
    """Return the states and actions of the teacher's run of an option from a state."""
    rng = np.random.default_rng(0)  # unused: the seed of a state determines its future
    states, actions = [state], list[str]()
    while len(actions) < domain.max_steps and (best := option.optimal_actions(states[-1])):
        states.append(domain.step(states[-1], best[0], rng).state)
        actions.append(domain.actions[best[0]].name)
    return states, actions


def success(option: Option, domain: Domain, starts: Sequence[tuple[Any, int]]) -> float:
    """Return the share of starts from which an option reaches its end within twice the steps."""
    reference, rng = reference_options(domain)[option.name], np.random.default_rng(0)
    limits = np.array([2 * steps for _, steps in starts])
    games, limit, count = games_at(domain, [state for state, _ in starts]), limits, 0
    for step in range(1, int(limits.max()) + 1):
        over = games.step(option.action(games.features()), rng).over
        ended, states = over | option.ends(games.features()) | (step >= limit), games.states()
        count += sum(reached(reference, states[place]) for place in np.flatnonzero(ended))
        games, limit = games.take(np.flatnonzero(~ended)), limit[~ended]
        if not limit.size:
            break
    return count / len(starts)


def play_plan(domain: Domain, options: Sequence[Option], seed: int) -> dict[str, Any]:
    """Plan with options, and play unseen episodes; return success and other results."""
    plan = make_sampled_plan(domain, options, PlanRequest(HUMAN, seed=seed))
    played = plan.play(seed, LAYOUTS)
    return {
        'success': float((played.total > 0).mean()),  # only the end of the task is rewarded
        'random moves': float(played.random_moves.mean()),
        'fallbacks': float(played.fallbacks.mean()),
    }


def teach_by_whole_plays(parameters: Mapping[str, Any]) -> Rows:
    """
    Cut whole plays into named segments; also demonstrate each option separately as many times.

    :return: one row per option: success (learned from segments), separate (success when learned
        from separate demonstrations), demonstrations.
    """
    name, seed = parameters['domain'], _seed(parameters)
    domain, rows = make_domain(name), []
    known: Mapping[str, ReferenceOption] = reference_options(domain)
    names = paper.TAUGHT.get(name, (*known,))
    rng, plays, running = generator(seed, 'plays'), list[Demonstration](), list[list[str]]()
    for _ in range(PLAYS[name]):
        states, actions, rewards, who = [domain.reset(rng)], list[str](), list[float](), []
        for each in names:
            while best := known[each].optimal_actions(states[-1]):
                outcome = domain.step(states[-1], best[0], rng)
                states.append(outcome.state)
                actions.append(domain.actions[best[0]].name)
                rewards.append(outcome.reward)
                who.append(each)
        plays.append(make_demonstration(domain, WHOLE_TASK, states, actions, rewards))
        running.append(who)
    events = event_features(domain, plays)
    segments: dict[str, list[Demonstration]] = {each: [] for each in names}
    for play, who in zip(plays, running):
        parts = cut(domain, play, events)
        for each, part in joined(parts, [who[part.last - 1] for part in parts]):
            segments[each].append(part.demonstration(each, known[each].features))
    for each in names:
        alone = []
        for state, _ in starts_of(domain, each, seed + 1, PLAYS[name]):
            states, actions = led(domain, known[each], state)
            alone.append(
                make_demonstration(
                    domain,
                    each,
                    states,
                    actions,
                    [0.0] * len(actions),
                    features=known[each].features,
                )
            )
        starts = starts_of(domain, each, seed)
        both = [
            success(learn_option(numbered(demos), domain, seed), domain, starts)
            for demos in (segments[each], alone)
        ]
        found = {'option': each, 'success': both[0], 'separate': both[1]}
        case = f'{domain.name.removeprefix("gymnasium:")}, whole plays'
        rows.append({'case': case, **found, 'demonstrations': len(segments[each])})
    return rows


def numbered(demonstrations: Sequence[Demonstration]) -> list[Demonstration]:
    """Number the demonstrations as those of one lesson."""
    return [
        replace(demo, number=number, uuid=f'{demo.option_name} {number}')
        for number, demo in enumerate(demonstrations, start=1)
    ]


def learn_to_choose(parameters: Mapping[str, Any]) -> Rows:
    """
    Learn by tabular Q-learning to choose among taught options, or among primitive actions.

    :return: one row per set of actions: success (whether at least ``SOLVED`` of the unseen
        episodes are solved after ``EPISODES``), demonstrations.
    """
    case, seed, rows = CASES['DoorKey-8x8'], _seed(parameters), []
    domain = world(case.environment)
    options = _taught(domain, case, seed)
    columns = feature_columns(domain, {name for option in options for name in option.features})
    for chosen in (options, ()):
        env = OptionsEnv(gymnasium.make(case.environment), chosen, primitives=not chosen)
        learner = EnvLearner(env, columns)
        learner.play(EPISODES, seed, learn=True)
        solved = learner.play(STARTS, seed + 1, learn=False).terminated.mean()
        rows.append(
            {
                'case': f'DoorKey-8x8, {EPISODES} episodes of Q-learning',
                'option': 'taught options' if chosen else 'primitive actions',
                'success': float(solved >= SOLVED),
                'demonstrations': sum(option.n_demonstrations for option in chosen),
            }
        )
    return rows


def present(rows: pd.DataFrame) -> report.Section:
    """Return the report section from one row per lesson and option."""
    lessons = rows.drop(columns='trial', errors='ignore')
    means = [
        name
        for name in ('teacher', 'separate', 'where stuck', 'not here', 'random moves')
        if name in lessons
    ]
    summary = report.mean_intervals(lessons, KEYS, 'success', 0.0, 1.0).rename(
        columns={'count': 'lessons', 'mean': 'success'}
    )
    by = lessons.groupby(KEYS, sort=False)
    summary = summary.join(by['demonstrations'].max().rename('most demonstrations'), on=KEYS)
    summary = summary.join(by[means].mean(), on=KEYS)
    tables = [
        report.Table('worlds-summary', 'Success by option', summary),
        report.Table('worlds-lessons', 'Each lesson', lessons, shown=False),
    ]
    facts = {'starts': STARTS, 'layouts': LAYOUTS, 'episodes': EPISODES}
    return report.Section(NAME, TITLE, _comparisons(lessons), (), tables, facts)


def _comparisons(lessons: pd.DataFrame) -> list[report.Comparison]:
    """Compare the mean success in each case with the goals."""
    found = []
    for (case,), rows in report.grouped(lessons, ['case']):
        options = {name: mine for (name,), mine in report.grouped(rows, ['option'])}
        values = {name: Interval.of(mine['success']) for name, mine in options.items()}
        about = f'{rows.groupby("option").size().max()} lessons'
        if case in CASES:
            goal, each = CASES[case].goal, CASES[case]
            decides = {k: v for k, v in values.items() if k == WHOLE_TASK} or values
            verdict = all_hold(value.above(goal) for value in decides.values())
            shown = counted(each.shown, 'demonstration')
            extra = f' and at most {each.where_stuck} where the plan got stuck'
            said = (
                f'{case}: success of at least {goal:.0%} after {shown} of each option'
                f'{extra if each.where_stuck else ""}.'
            )
        elif 'separate' in rows and rows['separate'].notna().any():
            less = {
                name: Interval.of_difference(mine['separate'], mine['success'])
                for name, mine in options.items()
            }
            verdict = all_hold(value.at_most(LESS) for value in less.values())
            said = (
                f'{case}: segments teach as well as separate demonstrations (within {LESS:.0%}).'
            )
            values |= {f'{name}, separate - segments': value for name, value in less.items()}
        else:
            verdict = values['taught options'].mean >= SOLVED
            said = f'{case}: solved with taught options in at least {SOLVED:.0%} of the lessons.'
        found.append(report.compare(said, verdict, about, values, '.3g'))
    return found
