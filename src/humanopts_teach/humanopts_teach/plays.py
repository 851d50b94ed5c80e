"""
Plays of the whole task, from bags, tables and Minari datasets, and storage of their segments.

A play is a demonstration of the whole task; ``humanopts_learner.segments`` cuts it.
"""

from collections.abc import Mapping, Sequence
import os
from pathlib import Path
import time
from typing import Any

from humanopts_env.domains.base import ActableDomain, Domain, is_enumerable
from humanopts_env.domains.registry import make_domain
from humanopts_env.gym_env import DomainEnv
from humanopts_learner.demonstrations import Demonstration, DemonstrationError, make_demonstration
from humanopts_learner.segments import Segment, suggested_features
from humanopts_teach.bags import BagError
from humanopts_teach.bags.contents import read_description, read_episodes
from humanopts_teach.bags.reader import Bag
from humanopts_teach.export.minari_dataset import FOLDER
from humanopts_teach.lesson.attempt import demonstration_of
from humanopts_teach.lesson.lesson import Lesson
from humanopts_teach.lesson.requests import (
    AddDemonstrations,
    AnswerQuestion,
    DefineOption,
    LessonRequest,
    OpenSession,
)
from humanopts_teach.lesson.seeded_starts import LessonRules, SeededStarts
from humanopts_teach.lesson.store import DemonstrationStore
import numpy as np

WHOLE_TASK = 'the whole task'
Plays = Mapping[int, Demonstration]  # by episode number


class PlayError(ValueError):
    """Plays cannot be read, or their segments cannot be kept; the message says why."""


def plays_in_bag(bag: Bag, episodes: Sequence[int] = ()) -> tuple[ActableDomain, Plays]:
    """
    Return the episodes of a bag by number, as counted by ``bag play``.

    Episodes with a single state or missing steps are left out, and noted in ``bag.damage``.

    :param episodes: numbers of the episodes to read; none: all.
    :raises BagError: the bag does not name its domain, or has no such episode.
    """
    domain, plays, left_out = read_description(bag), {}, 0
    for number, episode in enumerate(read_episodes(bag), start=1):
        if episodes and number not in episodes:
            continue
        if len(episode.transitions) < 2 or episode.has_gaps:
            left_out += 1
        else:
            plays[number] = demonstration_of(
                domain, episode.transitions, option_name=WHOLE_TASK, participant='', session=''
            )
    if left_out:
        bag.note(f'episodes of one state, or with steps missing, are left out: {left_out}')
    if lost := sorted({*episodes} - {*plays}):
        numbers = ', '.join(map(str, lost))
        raise BagError(f'{bag.path} has no episode {numbers} with all of its steps recorded')
    return domain, plays


def plays_in_dataset(name: str, folder: Path | None = None) -> tuple[Domain, Plays]:
    """
    Return the episodes of a Minari dataset on disk by number.

    States are restored by repeating the recorded actions, or from observations that identify
    states.

    :param folder: folder of Minari's datasets; None: Minari's default.
    :raises PlayError: Minari is not installed, the dataset does not exist or does not name its
        environment, or an episode cannot be repeated.
    :raises DomainError: the environment cannot be created.
    """
    try:
        import minari
    except ImportError as error:
        raise PlayError(
            'reading a Minari dataset needs minari, which is not installed: '
            'pip install "minari[arrow]"'
        ) from error
    if folder is not None:
        os.environ[FOLDER] = os.path.abspath(folder)
    try:
        dataset = minari.load_dataset(name)
    except FileNotFoundError as error:
        there = ', '.join(sorted(minari.list_local_datasets())) or 'none'
        raise PlayError(f'no dataset {name!r} on this disk; there is: {there}') from error
    except ValueError as error:
        raise PlayError(f'{name!r} is not a dataset of Minari: {error}') from error
    spec = dataset.env_spec
    if spec is None:
        raise PlayError(f'{name} does not name the environment that it was recorded in')
    made = spec.make().unwrapped if spec.id.startswith('humanopts/') else None
    arguments = {key: value for key, value in spec.kwargs.items() if key != 'render_mode'}
    domain = made.domain if made is not None else make_domain(f'gymnasium:{spec.id}', arguments)
    plays = {}
    for number in dataset.episode_indices.tolist():
        (facts,) = dataset.storage.get_episode_metadata([number])
        (episode,) = dataset.iterate_episodes([number])
        rewards = np.asarray(episode.rewards, dtype=np.float64).tolist()
        start = getattr(dataset.action_space, 'start', 0)
        actions = [int(action) - int(start) for action in np.ravel(episode.actions)]
        if made is not None:
            states, gained = _played_again(made, facts, actions)
        elif is_enumerable(domain):
            states = [domain.state_at(int(index)) for index in np.ravel(episode.observations)]
            gained = rewards
        elif facts.get('seed') is None:
            raise PlayError(
                f'episode {number} of {name} was recorded without its seed, so its states '
                'cannot be restored'
            )
        else:
            states, gained = _replayed(domain, int(facts['seed']), actions)
        same = domain.is_over(states[-1]) == bool(episode.terminations[-1])
        if not (same and np.allclose(gained, rewards)):
            raise PlayError(
                f'episode {number} of {name} has different rewards or a different end when it '
                'is repeated'
            )
        try:
            plays[number] = make_demonstration(
                domain,
                WHOLE_TASK,
                states,
                [domain.actions[action].name for action in actions],
                rewards,
            )
        except DemonstrationError as error:
            raise PlayError(f'episode {number} of {name} cannot be repeated: {error}') from error
    return domain, plays


Played = tuple[list[Any], list[float]]  # T + 1 states, T rewards


def _played_again(env: DomainEnv, facts: Mapping[str, Any], actions: Sequence[int]) -> Played:
    """Repeat an episode in a humanopts environment."""
    env.reset(seed=facts.get('seed'), options=facts.get('options'))
    states, rewards = [env.state], []
    for action in actions:
        rewards.append(env.step(action)[1])
        states.append(env.state)
    return states, rewards


def _replayed(domain: Any, seed: int, actions: Sequence[int]) -> Played:
    """Repeat an episode in a world that is restored by replay."""
    states, rewards = [domain.decode(f'seed {seed} actions -')], []
    for action in actions:
        outcome = domain.step(states[-1], action, np.random.default_rng(0))
        states.append(outcome.state)
        rewards.append(outcome.reward)
    return states, rewards


def keep_segments(
    domain: ActableDomain,
    named: Mapping[str, Sequence[Segment]],
    folder: Path,
    participant: str,
) -> dict[str, tuple[str, ...]]:
    """
    Add segments as demonstrations of their options to the folder of a lesson.

    A lesson adds them, so the same names, limits and checks apply as during teaching. A new
    option depends on the features suggested by its segments.

    :param named: segments by option name.
    :return: the features of each option.
    :raises PlayError: the lesson refuses a request; earlier options are kept.
    :raises StoreError: the folder cannot be written, or is used by a lesson.
    """
    chosen = {}
    with DemonstrationStore(folder / 'demonstrations') as store:
        budget = max(LessonRules().budget, *map(len, named.values()))
        starts = SeededStarts(domain, LessonRules(budget=budget))
        lesson = Lesson(
            domain, store, starts, clock=time.monotonic, today=lambda: time.strftime('%Y%m%d')
        )

        def ask(request: LessonRequest) -> None:
            answer = lesson.carry_out(request)
            if not answer.carried_out:
                raise PlayError(answer.detail)

        ask(OpenSession(participant))
        for name, segments in named.items():
            ask(DefineOption(name))
            suggested = suggested_features(domain, segments)
            while (view := lesson.view).question_id:
                ask(AnswerQuestion(view.question_id, yes=view.question_feature in suggested))
            features = lesson.view.chosen_features
            ask(AddDemonstrations(tuple(s.demonstration(name, features) for s in segments)))
            chosen[name] = features
    return chosen
