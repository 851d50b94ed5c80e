"""
Other uses of taught options: as actions of a learner, and cut from plays of the whole task.

The simulated teacher is that of ``worlds``: it makes no errors.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
from humanopts_env.domains.base import Domain
from humanopts_env.domains.formulas import feature_columns
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.options_env import OptionsEnv
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, make_demonstration
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.qlearning import EnvLearner
from humanopts_learner.segments import cut, event_features, joined, Segment
from humanopts_teach.lesson.attempt import with_uuid
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.simulated_teacher import TeacherSettings
import numpy as np

from experiments.trials import Rows

WORLD = 'MiniGrid-DoorKey-8x8-v0'
SHOWN, WHERE_STUCK = 3, 3  # demonstrations of each option; further ones where a plan gets stuck
EPISODES, LAYOUTS = 100, 50  # to learn from; unseen ones
CUT = {
    'gymnasium:' + WORLD: (),
    'taxi': ('passenger_in_taxi',),
}  # events; none: found in the plays
STARTS = 100  # unseen starts of each option
MAX_STEPS = 300  # of a play; the teachers need fewer than 50


def learn_over_options(parameters: Mapping[str, Any]) -> Rows:
    """
    Learn DoorKey-8x8 by tabular SMDP Q-learning, over taught options and over primitive actions.

    The table is over the features that the options depend on, in both cases.

    :param parameters: seed.
    :return: a row for each: actions, solved (share of unseen layouts, greedily), steps (mean),
        solved while learning (share of the episodes).
    """
    seed = parameters['seed']
    domain = make_domain(f'gymnasium:{WORLD}')
    options = teach(
        domain,
        TeacherSettings((*reference_options(domain),), seed=seed),
        LessonRules(seed=seed, until_no_failures=False),
        lambda _, option: option.n_demonstrations >= SHOWN,
        WHERE_STUCK,
    ).options
    columns = feature_columns(domain, {name for each in options for name in each.features})
    rows = []
    for actions, chosen in (('taught options', options), ('primitive actions', ())):
        env = OptionsEnv(gymnasium.make(WORLD), chosen, primitives=not chosen)
        learner = EnvLearner(env, columns)
        learning = learner.play(EPISODES, seed, learn=True)
        played = learner.play(LAYOUTS, seed + 1, learn=False)
        rows.append(
            {
                'actions': actions,
                'solved': float(played.terminated.mean()),
                'steps': float(played.steps.mean()),
                'solved while learning': float(learning.terminated.mean()),
            }
        )
    return rows


def cut_plays(parameters: Mapping[str, Any]) -> Rows:
    """
    Compare options from segments of whole plays with options from separate demonstrations.

    :param parameters: domain (a key of ``CUT``), plays (number of them, and of the separate
        demonstrations of each option), seed.
    :return: a row per option: segments, separate (shares of unseen starts from which the option
        ends in the same situation as the teacher, within twice the steps).
    """
    name, count, seed = parameters['domain'], parameters['plays'], parameters['seed']
    domain = make_domain(name)
    whole = _plays(domain, count, generator(seed, 'whole'))
    events = CUT[name] or event_features(domain, [play for play, _ in whole])
    shown: dict[str, list[Demonstration]] = {'segments': [], 'separate': []}
    for play, actors in whole:
        segments = cut(domain, play, events)
        shown['segments'] += _named(domain, segments, [actors[each.last - 1] for each in segments])
    used = dict.fromkeys(demo.option_name for demo in shown['segments'])
    for option in used:
        others = _plays(domain, count, generator(seed, 'separate', option))
        separate = [demo for play, actors in others for demo in _parts(domain, play, actors)]
        shown['separate'] += [demo for demo in separate if demo.option_name == option]
    unseen = _plays(domain, STARTS, generator(seed, 'unseen'))
    starts = [demo for play, actors in unseen for demo in _parts(domain, play, actors)]
    rows = []
    for option in used:
        row: dict[str, Any] = {'domain': name, 'plays': count, 'option': option}
        tried = [demo for demo in starts if demo.option_name == option]
        for source, demonstrations in shown.items():
            mine = [demo for demo in demonstrations if demo.option_name == option]
            learned = learn_option(mine, domain, seed)
            row[source] = float(np.mean([_succeeds(domain, learned, demo) for demo in tried]))
        rows.append(row)
    return rows


def _plays(
    domain: Domain, count: int, rng: np.random.Generator
) -> list[tuple[Demonstration, list[str]]]:
    """Return plays of the whole task by the teacher, and the option of each step."""
    references = reference_options(domain)
    plays: list[tuple[Demonstration, list[str]]] = []
    while len(plays) < count:
        states, rewards = [domain.reset(rng)], []
        actions: list[str] = []
        actors: list[str] = []
        while not domain.is_over(states[-1]) and len(actions) < MAX_STEPS:
            able = [name for name, each in references.items() if each.can_start(states[-1])]
            if not able:
                break
            best = references[able[0]].optimal_actions(states[-1])[0]
            outcome = domain.step(states[-1], best, rng)
            states.append(outcome.state)
            actions.append(domain.actions[best].name)
            rewards.append(outcome.reward)
            actors.append(able[0])
        if domain.is_over(states[-1]):
            plays.append((make_demonstration(domain, 'all', states, actions, rewards), actors))
    return plays


def _parts(domain: Domain, play: Demonstration, actors: Sequence[str]) -> list[Demonstration]:
    """Return the demonstrations that a play consists of, by the option of each step."""
    changes = [n for n in range(1, len(actors)) if actors[n] != actors[n - 1]]
    bounds = zip([0, *changes], [*changes, len(actors)])
    segments = [Segment(play, first, last, ()) for first, last in bounds]
    return _named(domain, segments, [actors[segment.first] for segment in segments])


def _named(
    domain: Domain, segments: Sequence[Segment], names: Sequence[str]
) -> list[Demonstration]:
    """Return the demonstrations of named segments, with the features of the teacher."""
    references = reference_options(domain)
    return [
        with_uuid(segment.demonstration(name, references[name].features))
        for name, segment in joined(segments, names)
    ]


def _succeeds(domain: Domain, option: LearnedOption, shown: Demonstration) -> bool:
    """Return whether an option ends where the teacher does, within twice the teacher's steps."""
    state, rng = domain.decode(shown.states[0]), generator(0, 'run')
    end = domain.feature_values(domain.decode(shown.states[-1]))
    for _ in range(2 * len(shown.actions)):
        action = int(option.action(domain.feature_values(state)[None])[0])
        outcome = domain.step(state, action, rng)
        state, row = outcome.state, domain.feature_values(outcome.state)
        if outcome.terminated or option.ends(row[None])[0]:
            return bool((row == end).all())
    return False
