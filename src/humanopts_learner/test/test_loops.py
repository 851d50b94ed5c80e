"""Runs that repeat themselves: detected by features, and broken by random moves."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.base import Action, Feature
from humanopts_env.domains.replayed_domain import History, ReplayedDomain, World
from humanopts_env.games import games_at
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.execution import Fixed, Loops, NONE, play, Played, RowOptions
from humanopts_learner.options.files import option_from_json, option_to_json
from humanopts_learner.options.learn import learn_option
from humanopts_learner.run import Run, RunStatus
import numpy as np
import pytest

LENGTH = 10


class Corridor:
    """A corridor of cells; the task is over at its east end."""

    def reset(self, seed: int) -> None:
        self.cell = 0

    def step(self, action: int) -> tuple[float, bool]:
        self.cell = min(max(self.cell + 2 * action - 1, 0), LENGTH - 1)
        return -1.0, self.cell == LENGTH - 1

    def features(self) -> Sequence[float]:
        return [self.cell, self.cell % 2 + 1e-6 * self.cell]


class CorridorDomain(ReplayedDomain):
    name, gamma, max_steps = 'corridor', 0.9, 100
    parameters: dict[str, int] = {}
    features = (
        Feature.number('cell', 'which cell it is', LENGTH),
        Feature.continuous('tile', 'which colour the tile has', 0.0, 2.0),
    )
    actions = (Action('west', 'left', 'go west'), Action('east', 'right', 'go east'))

    def make_world(self) -> World:
        return Corridor()


CORRIDOR = CorridorDomain()
START = CORRIDOR.decode('seed 0 actions -')


@dataclass(frozen=True)
class East:
    """Go east; go back west from one cell, and so never past it."""

    turn: int
    name: str = 'go east'
    max_steps: int = 60

    def can_start(self, rows: Rows) -> Flags:
        return np.ones(len(rows), dtype=np.bool_)

    def action(self, rows: Rows) -> Ints:
        return np.where(rows[:, 0] == self.turn, 0, 1)

    def ends(self, rows: Rows) -> Flags:
        return np.zeros(len(rows), dtype=np.bool_)


def played(turn: int, most_visits: int, rng: np.random.Generator | None) -> Played:
    games = games_at(CORRIDOR, [START] * 20)
    loops = Loops(CORRIDOR, np.array([most_visits]), len(games), rng)
    policy = Fixed(np.zeros(len(games), dtype=np.intp))
    options, chance = RowOptions([East(turn)]), np.random.default_rng(0)
    return play(games, options, policy, chance, 60, once=True, loops=loops)


def test_random_moves_lead_out_of_a_loop() -> None:
    found = played(4, 1, np.random.default_rng(1))
    assert found.over.mean() > 0.5
    assert (found.runs.stuck == 5).all()  # cells 1, 2, 3, 4, 3: cell 3 is visited again
    assert (found.runs.random_moves > 0).all()
    assert (found.runs.random_moves < found.runs.steps).all()


def test_a_run_without_a_loop_takes_no_random_moves() -> None:
    found = played(NONE, 1, np.random.default_rng(1))
    assert found.over.all()
    assert (found.runs.random_moves == 0).all()
    assert (found.runs.stuck == NONE).all()


@pytest.mark.parametrize(('visits', 'steps'), [(1, 5), (2, 9), (0, 60)])
def test_without_random_moves_it_ends_where_it_repeats_itself(visits: int, steps: int) -> None:
    """A cell visited twice in a demonstration may be visited twice as often; with 0, never."""
    found = played(4, visits, None)
    assert (found.runs.steps == steps).all()
    assert not found.over.any()


def shown(actions: str) -> Demonstration:
    """Return a demonstration of moves to the west and the east from the west end."""
    state, states = START, [START]
    for sign in actions:
        state = CORRIDOR.step(state, 'we'.index(sign), np.random.default_rng(0)).state
        states.append(state)
    return Demonstration(
        Kind.TRAJECTORY,
        actions,
        CORRIDOR.name,
        '{}',
        'ann',
        'ann',
        option_name='go east',
        number=len(actions),
        chosen_features=('cell',),
        feature_names=('cell', 'tile'),
        features=tuple(state.features for state in states),
        states=tuple(map(CORRIDOR.encode, states)),
        actions=tuple({'w': 'west', 'e': 'east'}[sign] for sign in actions),
        rewards=(-1.0,) * len(actions),
        terminated=states[-1].over,
    )


def test_visits_are_learned_in_replayed_domains_and_kept_in_files() -> None:
    straight = learn_option([shown('e' * 9)], CORRIDOR, 0)
    assert straight.most_visits == 1
    back = learn_option([shown('e' * 9), shown('eewewe')], CORRIDOR, 0)
    assert back.most_visits == 3  # the second cell
    assert option_from_json(option_to_json(back))[0] == back
    assert 'most_visits' not in option_to_json(replace(back, most_visits=0))


@pytest.mark.parametrize('unstick', [True, False])
def test_a_live_run_reports_its_random_moves(unstick: bool) -> None:
    """An option that was mostly shown to turn back at the second cell does so forever."""
    option = replace(learn_option([shown('ewewee')], CORRIDOR, 0), max_steps=50)
    rng = np.random.default_rng(2) if unstick else None
    run, state, result = Run(option, CORRIDOR, START, (1, 0), unstick=rng), START, None
    while result is None:
        outcome = CORRIDOR.step(state, run.next_action(), np.random.default_rng(0))
        state: History = outcome.state
        result = run.observe(state, outcome.reward, outcome.terminated, False)
    assert (result.random_moves > 0) == unstick
    assert result.status is (RunStatus.REACHED if unstick else RunStatus.MAX_STEPS)
