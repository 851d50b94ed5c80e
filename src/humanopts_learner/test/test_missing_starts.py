"""Where to drive next, and which steps count, in a world that cannot be simulated."""

from collections.abc import Sequence
from dataclasses import replace
import uuid

from humanopts_env.arrays import Rows
from humanopts_env.domains.base import Action, Feature
from humanopts_env.domains.described import DescribedDomain
from humanopts_env.domains.formulas import feature_columns
from humanopts_learner.demonstrations import Demonstration, Kind, without_idle_steps
from humanopts_learner.options.learn import learn_option, make_dataset
from humanopts_learner.options.missing import missing_start
import numpy as np
import pytest

DOOR = Feature.nominal('door', 'whether the door is open', ('open', 'closed', 'locked'))
DISTANCE = Feature.continuous('distance', 'how far the charger is', 0.0, 10.0, 'm')
LAMP = Feature.nominal('lamp', 'whether the lamp is on', ('off', 'on'))
ACTIONS = [
    Action('forward', 'up', 'drive forward'),
    Action('left', 'left', 'turn left'),
    Action('wait', '.', 'wait', idle=True),
]
WORLD = DescribedDomain('rover', {}, [DOOR, DISTANCE, LAMP], ACTIONS, 0.95, 0)
CHOSEN = 'door', 'distance'
NOWHERE = np.empty((0, 3))


def demonstration(
    rows: Sequence[Sequence[float]], actions: Sequence[str], number: int = 1
) -> Demonstration:
    """Return a demonstration with these rows of features."""
    return Demonstration(
        kind=Kind.TRAJECTORY if actions else Kind.NOT_HERE,
        uuid=str(uuid.UUID(int=number)),
        domain='rover',
        domain_parameters='{}',
        participant='p1',
        session='s1',
        option_name='go to the charger',
        number=number,
        chosen_features=CHOSEN,
        feature_names=('door', 'distance', 'lamp'),
        features=tuple(tuple(map(float, row)) for row in rows),
        states=tuple(map(str, range(len(rows)))),
        actions=tuple(actions),
        rewards=tuple(float(number) for number in range(len(actions))),
    )


def drive(start: int, number: int, *, door: int = 0, action: str = 'forward') -> Demonstration:
    """Drive from a distance to the charger, a metre per step."""
    rows = [(door, distance, 0) for distance in range(start, -1, -1)]
    return demonstration(rows, [action] * start, number)


def missing(demos: Sequence[Demonstration], passed: Rows = NOWHERE) -> str:
    return missing_start(learn_option(demos, WORLD, 0), WORLD, demos, passed, 0)


def test_a_value_that_was_driven_past_comes_first_and_a_refusal_counts_as_a_start() -> None:
    demos = [drive(9, 1), drive(3, 2)]
    closed = np.array([[1.0, 5.0, 0.0]])
    assert missing(demos, closed) == 'no demonstration starts with door closed'
    demos.append(demonstration([(1, 5, 0)], [], 3))
    assert missing(demos, closed) != 'no demonstration starts with door closed'


def test_gaps_between_starts_are_named_the_largest_first() -> None:
    far = np.array([[0.0, 9.5, 0.0]])
    assert missing([drive(4, 1), drive(3, 2)], far) == (
        'no demonstration starts with distance above 4 m'
    )
    both = [drive(9, 1), drive(4, 2)]
    assert missing(both) == 'no demonstration starts with distance 4 m to 9 m'


def test_what_was_never_seen_is_asked_for_only_while_there_are_few_starts() -> None:
    starts = (2, 4, 6, 2, 4, 6)
    assert missing([drive(start, n) for n, start in enumerate(starts[:4], 1)]) == (
        'no demonstration starts with door closed'
    )
    assert missing([drive(start, n) for n, start in enumerate(starts, 1)]) == ''


def test_disagreement_is_named_by_the_range_that_holds_it() -> None:
    """One demonstration says what to do at the closed door: without it, the others say else."""
    demos = [drive(start, n) for n, start in enumerate((9, 7, 5, 3, 2, 8), 1)]
    demos += [drive(6, 7, door=1, action='left'), demonstration([(2, 5, 0)], [], 8)]
    assert missing(demos) == 'demonstrations disagree with door closed'
    assert (
        missing([*demos, drive(6, 9, door=1, action='left'), demonstration([(2, 4, 0)], [], 10)])
        == ''
    )


def test_a_slip_makes_no_leaf_but_a_few_turns_do() -> None:
    rows = [(0, 10 - step / 4, 0) for step in range(41)]
    slip = ['left' if step == 20 else 'forward' for step in range(40)]
    assert learn_option([demonstration(rows, slip)], WORLD, 0).policy.depth == 0
    turn = ['left' if 20 <= step < 26 else 'forward' for step in range(40)]
    policy = learn_option([demonstration(rows, turn)], WORLD, 0)
    assert policy.action(np.array(rows, dtype=float)).tolist()[20:26] == [1] * 6


@pytest.mark.parametrize(
    ('doors', 'actions', 'kept'),
    [
        ([0, 0, 0, 0], ['wait', 'forward', 'wait'], [1]),
        ([1, 1, 0, 0], ['wait', 'wait', 'forward'], [1, 2]),  # until the door has opened
        ([1, 1, 0], ['forward', 'wait'], [0, 1]),
        ([0, 0, 0], ['wait', 'wait'], [0, 1]),  # how to wait is what was shown
    ],
)
def test_steps_of_waiting_count_only_if_a_chosen_feature_changed(
    doors: Sequence[int], actions: Sequence[str], kept: Sequence[int]
) -> None:
    rows = [(door, 5.0, step % 2) for step, door in enumerate(doors)]
    demo = replace(demonstration(rows, actions), machine_steps=1)
    found = without_idle_steps(demo, WORLD, feature_columns(WORLD, CHOSEN))
    assert found.actions == tuple(actions[step] for step in kept)
    assert found.states == tuple(str(step) for step in (*kept, kept[-1] + 1))
    assert found.rewards == tuple(map(float, kept))
    assert found.machine_steps == int(0 in kept)
    (learned,) = make_dataset([demo], WORLD).demonstrations
    assert learned == found


def test_slow_change_while_waiting_adds_up_to_one_step() -> None:
    """A hundredth of the range of 10 m is 0.1 m."""
    rows = [(0, 5.0 + 0.04 * step, 0) for step in range(7)]
    demo = demonstration([*rows, rows[-1]], [*['wait'] * 6, 'forward'])
    found = without_idle_steps(demo, WORLD, feature_columns(WORLD, CHOSEN))
    assert found.actions == ('wait', 'wait', 'forward')
    assert found.states == ('2', '5', '6', '7')
