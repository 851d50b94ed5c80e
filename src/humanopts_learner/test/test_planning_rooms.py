"""Planning in the four rooms: option models, sweeps and play, as the paper published them."""

from collections.abc import Mapping
from functools import cache

from humanopts_env.domains.rooms import LAYOUT, PLACES, Rooms
from humanopts_env.domains.rooms_reference import reference_options
from humanopts_learner import LearnedOption
from humanopts_learner.options.learned_option import options_from_references, tabulate
from humanopts_learner.planning.exact_plan import build_model, episode_starts, ExactPlan, play_plan
from humanopts_learner.planning.models import MultiTimeModel
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import PlanRequest
from humanopts_learner.planning.solve import value_history
import numpy as np
import pytest

ROOMS = Rooms()


def hallway_options(domain: Rooms) -> list[LearnedOption]:
    """Return the ready set."""
    return options_from_references(domain, reference_options(domain).values())


@cache
def plan(action_set: str, goal: str = 'G1') -> ExactPlan:
    """Return a plan over the ready hallway options."""
    domain = Rooms(goal)
    return make_plan(domain, hallway_options(domain), PlanRequest(action_set))


@cache
def model(action_set: str, goal: str = 'G1') -> MultiTimeModel:
    """Return the model of an action set."""
    domain = Rooms(goal)
    tabled = [tabulate(option, domain) for option in hallway_options(domain)]
    found = build_model(domain, action_set, tabled, domain.gamma)
    assert isinstance(found, MultiTimeModel)
    return found


@pytest.mark.parametrize('goal', [(6, 8), (8, 8)])
def test_values_spread_room_by_room_with_options_and_cell_by_cell_without(
    goal: tuple[int, int],
) -> None:
    """
    Sutton, Precup and Singh (1999), figure 4: which states have value after each sweep.

    A primitive action carries value from the cells beside a cell. A hallway option carries it from
    the doorways of a room, and from a goal in the room, to all that can start there.
    """
    cells = PLACES
    rooms = [{c for c in cells if LAYOUT[c[0]][c[1]] == room} for room in 'abcd']
    rooms = [room | {c for c in cells if beside(c) & room} for room in rooms]
    doors = {c for c in cells if sum(c in room for room in rooms) == 2}
    spread = {
        'primitive': lambda valued: {c for c in cells if beside(c) & valued},
        'human': lambda valued: set().union(*(r for r in rooms if r & valued & (doors | {goal}))),
    }
    for action_set, sources in spread.items():
        history = value_history(model(action_set, {(6, 8): 'G1', (8, 8): 'G2'}[goal]))
        valued: set[tuple[int, int]] = set()
        for values in history:
            assert {c for c, value in zip(cells, values, strict=True) if value > 0} == valued
            valued |= sources(valued | {goal}) - {goal}
        assert valued == {*cells} - {goal}


def beside(cell: tuple[int, int]) -> set[tuple[int, int]]:
    """Return the four cells around a cell, walls included."""
    row, col = cell
    return {(row - 1, col), (row + 1, col), (row, col - 1), (row, col + 1)}


def test_one_sweep_over_options_values_the_rooms_at_the_goal_exactly() -> None:
    """Figure 4: by the best way to the goal without leaving the room, from a walk on the board."""
    cells, goal = PLACES, (6, 8)
    after_one = dict(zip(cells, value_history(model('human'))[1], strict=True))
    for letter in 'bd':
        room = [c for c in cells if LAYOUT[c[0]][c[1]] == letter]
        worth = dict.fromkeys(cells, 0.0) | {goal: 1.0}
        for _ in range(300):
            worth |= {cell: best_step(cell, worth) for cell in room}
        assert [after_one[c] for c in room] == pytest.approx([worth[c] / 0.9 for c in room])


def best_step(cell: tuple[int, int], worth: Mapping[tuple[int, int], float]) -> float:
    """Return 0.9 of the best expected worth after a step that slips in a third of cases."""
    arrived = [worth.get(there, worth[cell]) for there in beside(cell)]
    return 0.9 * (sum(arrived) / 9 + max(arrived) * (2 / 3 - 1 / 9))


def test_planning_over_options_takes_fewer_sweeps() -> None:
    """And what they are worth is near to the best there is after two of them."""
    options, both, primitives = (value_history(model(name)) for name in SETS)
    assert len(options) < len(both) < len(primitives)
    assert len(options) <= len(primitives) / 3 + 1
    assert [np.count_nonzero(history[2]) for history in (options, primitives)] == [103, 8]
    distances = [np.abs(history[2] - history[-1]).max() for history in (options, primitives)]
    assert distances[0] < 0.11 < distances[1]


@pytest.mark.parametrize(('goal', 'lost'), [('G1', 0.0120), ('G2', 0.5654)])
def test_mixtures_are_worth_as_much_as_the_best_policy(goal: str, lost: float) -> None:
    """
    Options alone are worth as much at most, and where the goal is in a room far less.

    With the goal in a doorway they lose a little, because they avoid the room's other doorway
    where the best policy passes through it.
    """
    values = {name: plan(name, goal).solution.values for name in SETS}
    assert values['human+primitive'] == pytest.approx(values['primitive'], abs=1e-6)
    assert (values['human'] <= values['primitive'] + 1e-6).all()
    assert (values['primitive'] - values['human']).max() == pytest.approx(lost, abs=1e-4)


SETS = ('human', 'human+primitive', 'primitive')


def test_play_is_keyed_by_the_seed_and_the_number_of_the_episode() -> None:
    found, starts = plan('human'), episode_starts(ROOMS, 0, 50)
    all_of_them, some = play_plan(found, starts, seed=5), play_plan(found, starts[:20], seed=5)
    assert (some.steps == all_of_them.steps[:20]).all()
    assert (some.discounted == all_of_them.discounted[:20]).all()
    assert (play_plan(found, starts, seed=6).steps != all_of_them.steps).any()
