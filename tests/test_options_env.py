"""Options as the actions of a Gymnasium environment."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
import re
import subprocess
import sys
from typing import Any
import warnings

import gymnasium
from gymnasium.utils.env_checker import check_env
from humanopts_env import OptionsEnv
from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.base import DomainError
from humanopts_env.domains.formulas import feature_columns
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.games import games_at
from humanopts_env.options_env import MAX_REFUSALS
from humanopts_env.seeding import generator
from humanopts_learner.execution import Fixed, play, RowOptions
from humanopts_learner.options.files import save_option
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.qlearning import EnvLearner
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.simulated_teacher import TeacherSettings
import minigrid  # noqa: F401 - registers its environments
import numpy as np
import pytest

EXAMPLE = Path(__file__).parents[1] / 'examples/options_as_actions/q_learning.py'
SOUTH, NORTH, EAST, WEST, PICK_UP, PUT_DOWN = range(6)


def never(rows: Rows) -> Flags:
    return np.zeros(len(rows), dtype=np.bool_)


def always(rows: Rows) -> Flags:
    return np.ones(len(rows), dtype=np.bool_)


@dataclass(frozen=True)
class Keep:
    """An option that repeats an action until its condition holds; Taxi's first feature is row."""

    repeated: int
    starts: Callable[[Rows], Flags] = always
    until: Callable[[Rows], Flags] = never
    max_steps: int = 1000
    name: str = 'keep going'

    def can_start(self, rows: Rows) -> Flags:
        return self.starts(rows)

    def action(self, rows: Rows) -> Ints:
        return np.full(len(rows), self.repeated)

    def ends(self, rows: Rows) -> Flags:
        return self.until(rows)


TO_SOUTH = Keep(SOUTH, until=lambda rows: rows[:, 0] == 4)
FROM_NORTH = Keep(EAST, starts=lambda rows: rows[:, 0] == 0, max_steps=2)


def taxi(*options: Any, state: str = '', **arguments: Any) -> OptionsEnv:
    """Return an environment of Taxi that has begun in a state."""
    env = OptionsEnv(gymnasium.make('humanopts/Taxi-v0'), options, **arguments)
    env.reset(seed=1, options={'state': state or 'taxi 1,2 passenger R destination B'})
    return env


@pytest.mark.parametrize(
    ('name', 'arguments'),
    [
        ('humanopts/Taxi-v0', {}),
        ('FrozenLake-v1', {'is_slippery': False}),
        ('Taxi-v4', {}),
        ('MiniGrid-DoorKey-6x6-v0', {}),
        ('MountainCar-v0', {}),
    ],
)
def test_gymnasiums_checker_is_satisfied(name: str, arguments: dict[str, Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        warnings.filterwarnings('ignore', '.*different from the unwrapped version')
        env = gymnasium.make(name, **arguments)
        check_env(
            OptionsEnv(env, [FROM_NORTH, Keep(SOUTH, max_steps=3)], primitives=True),
            skip_render_check=True,
        )
        check_env(OptionsEnv(env, [Keep(EAST, max_steps=3), FROM_NORTH]), skip_render_check=True)


def test_a_run_is_worth_its_discounted_rewards() -> None:
    """Three steps of -1 each to row 4."""
    env = taxi(TO_SOUTH, gamma=0.5)
    *_, reward, terminated, truncated, info = env.step(0)
    assert (reward, terminated, truncated) == (-1.75, False, False)
    said = ('duration', 'discount', 'undiscounted', 'option_end')
    assert [info[name] for name in said] == [3, 0.125, -3.0, 'reached']
    assert env.features()[0] == 4


def test_a_run_is_that_of_play() -> None:
    env = taxi(TO_SOUTH, FROM_NORTH)
    domain: Any = env.unwrapped
    state = domain.domain.decode('taxi 1,2 passenger R destination B')
    games = games_at(domain.domain, [state])
    first, rng = np.zeros(1, dtype=np.intp), generator(1, 'play')
    played = play(
        games,
        RowOptions([TO_SOUTH]),
        Fixed(first),
        rng,
        200,
        gamma=env.gamma,
        once=True,
    )
    _, reward, _, _, info = env.step(0)
    runs = played.runs
    assert (runs.steps[0], runs.discounted[0]) == (info['duration'], reward)


def test_the_ways_to_end_are_told_apart() -> None:
    aboard = 'taxi 4,0 passenger aboard destination B'
    north = 'taxi 0,2 passenger R destination B'
    ended = taxi(Keep(PUT_DOWN), state='taxi 4,3 passenger aboard destination B').step(0)
    assert ended[1:4] == (1.0, True, False)
    assert (ended[4]['discount'], ended[4]['option_end']) == (0.0, 'terminated')
    assert taxi(FROM_NORTH, TO_SOUTH, state=north).step(0)[4]['option_end'] == 'max_steps'
    cut_off = taxi(Keep(WEST), state=aboard).step(0)
    assert cut_off[2:4] == (False, True)
    assert (cut_off[4]['duration'], cut_off[4]['option_end']) == (200, 'truncated')
    assert cut_off[4]['discount'] > 0


def test_a_refused_option_takes_no_step_and_a_hundred_end_the_episode() -> None:
    env = taxi(FROM_NORTH, TO_SOUTH)
    before = env.features()
    assert env.action_masks().tolist() == [False, True]
    for refusal in range(1, MAX_REFUSALS + 1):
        _, reward, terminated, truncated, info = env.step(0)
        assert (reward, terminated, truncated) == (0.0, False, refusal == MAX_REFUSALS)
        assert (info['duration'], info['discount'], info['option_end']) == (0, 1.0, 'refused')
        np.testing.assert_array_equal(env.features(), before)
    assert info['action_mask'].tolist() == [0, 1]
    env.reset(seed=1)
    assert not env.step(0)[3]


def test_what_was_returned_is_not_changed_by_what_follows() -> None:
    env = OptionsEnv(gymnasium.make('humanopts/PacMan-v0'), [Keep(0, starts=never)], True)
    first, _ = env.reset(seed=1)
    kept = first.copy()
    second = env.step(0)[0]
    second[:] = -1
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(env.step(0)[0], kept)


def test_an_episode_ends_where_nothing_can_start() -> None:
    env = taxi(FROM_NORTH, Keep(SOUTH, starts=lambda rows: rows[:, 0] < 2, max_steps=1))
    assert env.step(1)[2:4] == (False, True)
    assert env.action_masks().all()  # a mask leaves a choice
    assert env.step(0)[2:4] == (False, True)


def test_primitive_actions_follow_the_options_and_can_always_start() -> None:
    env = taxi(FROM_NORTH, primitives=True)
    assert env.action_masks().tolist() == [False, *[True] * 6]
    info = env.step(1 + NORTH)[4]
    assert (info['duration'], info['undiscounted']) == (1, -1.0)
    assert env.features()[0] == 0


def test_environments_without_a_choice_among_actions_are_refused() -> None:
    with pytest.raises(DomainError, match='choose among numbered actions, not Box'):
        OptionsEnv(gymnasium.make('Pendulum-v1'), [TO_SOUTH])
    with pytest.raises(DomainError, match='there are no options'):
        OptionsEnv(gymnasium.make('humanopts/Taxi-v0'), [])
    with pytest.raises(DomainError, match=r'make it with gymnasium\.make'):
        OptionsEnv(type(gymnasium.make('FrozenLake-v1').unwrapped)(), [TO_SOUTH])


@pytest.fixture(scope='module')
def taught() -> Sequence[LearnedOption]:
    domain = make_domain('taxi')
    return teach(domain, TeacherSettings(tuple(reference_options(domain)), seed=1)).options


@pytest.mark.heavy
def test_q_learning_completes_the_task_with_options_that_were_taught(
    taught: Sequence[LearnedOption],
) -> None:
    """The best plan needs 13 steps on the mean; the primitive actions know nothing by then."""
    domain, played = make_domain('taxi'), {}
    for options in (taught, []):
        env = OptionsEnv(gymnasium.make('humanopts/Taxi-v0'), options, primitives=not options)
        learner = EnvLearner(env, feature_columns(domain, [each.name for each in domain.features]))
        learner.play(50, 1, learn=True)
        played[len(options)] = learner.play(50, 2, learn=False)
    with_options, primitive = played.values()
    assert with_options.terminated.mean() > 0.9 > 0.3 > primitive.terminated.mean()
    assert np.median(with_options.steps) < 16
    ended = with_options.terminated
    assert (with_options.returns == 3 - with_options.steps)[ended].all()  # 0 and 1, else -1


@pytest.mark.heavy
def test_the_example_learns_from_the_folder_of_a_lesson(
    taught: Sequence[LearnedOption], tmp_path: Path
) -> None:
    for option in taught:
        save_option(tmp_path / 'options', option, [])
    done = subprocess.run(
        [sys.executable, EXAMPLE, 'humanopts/Taxi-v0', tmp_path, '--episodes', '20'],
        capture_output=True,
        text=True,
        check=True,
    )
    first, *_ = done.stdout.splitlines()
    assert first == f'actions: {", ".join(sorted(option.name for option in taught))}'
    solved = [int(each) for each in re.findall(r'episodes: (\d+) of 10 solved', done.stdout)]
    assert sum(solved[:2]) > 15 > 8 > sum(solved[2:])  # with options; primitive actions
