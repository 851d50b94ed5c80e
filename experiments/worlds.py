"""
Options taught in environments that can only be reset and stepped.

This goes beyond the paper. In a trial, a simulated teacher teaches all options of an environment,
a few demonstrations each. The teacher makes no errors, and takes the usual one of equally good
moves. Then the options run from starts that were never demonstrated, and a plan with them plays
unseen episodes. An option *succeeds* if it reaches the end that the teacher reaches from there,
within twice the steps; the plan succeeds if it does the whole task within the environment's limit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from humanopts_env.arrays import Flags
from humanopts_env.domains.gymnasium_reference import WatchedOption
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.domains.replayed_domain import History, ReplayedDomain
from humanopts_env.games import games_at
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.option import Option
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.request import HUMAN, PlanRequest
from humanopts_learner.planning.sampled_plan import make_sampled_plan
from humanopts_teach.evaluation.games import carried_over
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.simulated_teacher import TeacherSettings
import numpy as np

from experiments.people import Study
from experiments.trials import Rows, Trial

NAME = 'worlds'
TITLE = 'Options taught in other environments'
LESSONS = 20
STARTS, LAYOUTS = 50, 200  # unseen starts of each option; unseen episodes of each plan
WHOLE_TASK = 'whole task'
KEYS = ['case', 'option']


@dataclass(frozen=True)
class Case:
    """An environment, and what a lesson in it has to show."""

    environment: str  # id
    shown: int  # demonstrations of each option
    goal: float  # lowest success of each option, or of the plan if there are several
    where_stuck: int = 0  # further demonstrations of any option where the plan gets stuck
    played_in: str = ''  # environment to play in; empty: the same
    cost: float = 10.0  # approximate processor seconds of a lesson


CASES = {
    'DoorKey-8x8': Case('MiniGrid-DoorKey-8x8-v0', 3, 0.99, 3),
    'KeyCorridorS3R2': Case('MiniGrid-KeyCorridorS3R2-v0', 3, 0.99, 3),
    'UnlockPickup': Case('MiniGrid-UnlockPickup-v0', 5, 0.99, 5),
    'DoorKey-6x6, played in 16x16': Case(
        'MiniGrid-DoorKey-6x6-v0', 3, 0.95, 3, 'MiniGrid-DoorKey-16x16-v0'
    ),
    'LavaCrossingS9N2': Case('MiniGrid-LavaCrossingS9N2-v0', 3, 0.99),
    'FourRooms': Case('MiniGrid-FourRooms-v0', 3, 0.99),
    'LunarLander': Case('LunarLander-v3', 2, 0.9),
    'MountainCar': Case('MountainCar-v0', 1, 0.9),
    'Acrobot': Case('Acrobot-v1', 1, 0.9),
}


def trials(study: Study) -> list[Trial]:
    """Return one trial per case and lesson; none with bags."""
    lessons = 0 if study.bags else study.participants
    return [
        Trial(
            NAME, {'case': name, 'lesson': lesson, 'seed': study.seed}, teach_in_world, case.cost
        )
        for lesson in range(1, lessons + 1)
        for name, case in CASES.items()
    ]


def teach_in_world(parameters: Mapping[str, Any]) -> Rows:
    """
    Teach the options of an environment once.

    :return: one row per option, and one for the plan if there are several options: success (share
        of unseen starts), teacher (the teacher's share), demonstrations, not here (answers).
    """
    case = CASES[parameters['case']]
    seed = int(generator(parameters['seed'], NAME, *map(str, parameters.values())).integers(2**31))
    domain = world(case.environment)
    references = reference_options(domain)

    def enough(shown: Sequence[Demonstration], option: LearnedOption) -> bool:
        return option.n_demonstrations >= case.shown

    rules = LessonRules(seed=seed, until_no_failures=False)
    teacher = TeacherSettings((*references,), f'lesson{parameters["lesson"]}', seed=seed)
    taught = teach(domain, teacher, rules, enough, case.where_stuck)
    options = {option.name: option for option in taught.options}
    there = world(case.played_in or case.environment)
    rows = []
    for name, reference in reference_options(there).items():
        starts = starts_of(there, name, seed)
        option = options.get(name)
        rows.append(
            {
                'option': name,
                'success': 0.0,
                'teacher': float(np.mean([steps > 0 for _, steps in starts])),
                'demonstrations': 0,
                'not here': 0,
            }
        )
        if option is not None:
            # Where the teacher fails itself, there is no end to reach.
            able = [start for start in starts if start[1]]
            runs = succeeds(carried_over(option, there), reference, there, able)
            rows[-1] |= {
                'success': float(runs.mean()),
                'demonstrations': option.n_demonstrations,
                'not here': option.n_not_here,
            }
    if len(rows) > 1 and not case.played_in:
        rows.append({'option': WHOLE_TASK, **play_plan(domain, taught.options, seed)})
    return [{'case': parameters['case'], **row} for row in rows]


@cache
def world(environment: str) -> ReplayedDomain:
    """Return the domain of an environment; each process makes it once."""
    domain = make_domain(f'gymnasium:{environment}')
    assert isinstance(domain, ReplayedDomain)
    return domain


def starts_of(domain: ReplayedDomain, name: str, seed: int) -> list[tuple[History, int]]:
    """
    Draw starts of an option: the teacher takes the options before it from resets of the task.

    :return: start state and the number of steps that the teacher needs; 0: it fails.
    """
    rng, found = generator(seed, 'unseen starts', name), list[tuple[History, int]]()
    references: Mapping[str, Any] = reference_options(domain)
    before = [*references][: [*references].index(name)]
    while len(found) < STARTS:
        state = domain.reset(rng)
        for each in before:
            state, _ = led(domain, references[each], state)
        if references[name].can_start(state):
            end, steps = led(domain, references[name], state)
            found.append((state, steps if references[name].reached(end) else 0))
    return found


def led(domain: ReplayedDomain, option: WatchedOption, state: History) -> tuple[History, int]:
    """Return the state in which the teacher ends an option, and its number of steps."""
    rng, steps = np.random.default_rng(0), 0  # the seed of a state determines its future
    while not state.over and steps < domain.max_steps and (best := option.optimal_actions(state)):
        state, steps = domain.step(state, best[0], rng).state, steps + 1
    return state, steps


def succeeds(
    option: Option,
    reference: Any,
    domain: ReplayedDomain,
    starts: Sequence[tuple[History, int]],
) -> Flags:
    """Return (N,): whether an option reaches the teacher's end within twice the steps."""
    success, rng = np.zeros(len(starts), dtype=np.bool_), np.random.default_rng(0)
    limits = np.array([2 * steps for _, steps in starts])
    games, running = games_at(domain, [state for state, _ in starts]), np.arange(len(starts))
    for step in range(1, int(limits.max()) + 1):
        over = games.step(option.action(games.features()), rng).over
        ended = over | option.ends(games.features()) | (step >= limits[running])
        states = games.states()
        for place in np.flatnonzero(ended).tolist():
            success[running[place]] = reference.reached(states[place])
        games, running = games.take(np.flatnonzero(~ended)), running[~ended]
        if not running.size:
            break
    return success


def play_plan(domain: ReplayedDomain, options: Sequence[Option], seed: int) -> dict[str, Any]:
    """Plan with options, and play unseen episodes; return success and other results."""
    request = PlanRequest(HUMAN, seed=seed)
    played = make_sampled_plan(domain, options, request).play(seed, LAYOUTS)
    return {
        'success': float((played.total > 0).mean()),
        'random moves': float(played.random_moves.mean()),
        'fallbacks': float(played.fallbacks.mean()),
    }
