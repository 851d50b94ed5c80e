"""Options played in many games at once, against one game after another, written out by hand."""

from dataclasses import dataclass
from typing import Any

from humanopts_env.arrays import Flags, Ints, Rows
from humanopts_env.domains.registry import make_domain
from humanopts_env.games import games_at
from humanopts_learner import play, RowOptions
from humanopts_learner.execution import Seen
from humanopts_learner.option import PrimitiveOption
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import PlanRequest, Sampling
from humanopts_learner.planning.sampled_plan import make_sampled_plan
from hypothesis import given, settings, strategies
import numpy as np
import pytest

WORLDS = [('taxi', {}), ('rooms', {}), ('pacman', {'maze': 'yard'})]


@dataclass(frozen=True)
class HashOption:
    """An option that acts and ends by the remainders of sums of features."""

    name: str
    key: int
    n_actions: int
    max_steps: int

    def can_start(self, rows: Rows) -> Flags:
        return np.ones(len(rows), dtype=np.bool_)

    def action(self, rows: Rows) -> Ints:
        found: Ints = (rows.sum(axis=1).astype(np.intp) * self.key + self.key) % self.n_actions
        return found

    def ends(self, rows: Rows) -> Flags:
        found: Flags = (rows.sum(axis=1).astype(np.intp) + self.key) % 3 == 0
        return found


class InTurn:
    """Options one after another, in each game from one of its own; some are stopped."""

    def __init__(self, count: int, games: int, stopping: int) -> None:
        self.count, self.next, self.stopping = count, np.arange(games), stopping

    def choose(self, seen: Seen, games: Ints) -> Ints:
        option = self.next[games] % self.count
        self.next[games] += 1
        return option

    def stops(self, seen: Any, option: Ints) -> Flags | None:
        if not self.stopping:
            return None
        stopped: Flags = seen.rows.sum(axis=1).astype(np.intp) % self.stopping == 0
        return stopped


@settings(max_examples=25, deadline=None)
@given(
    world=strategies.sampled_from(WORLDS),
    keys=strategies.lists(strategies.integers(1, 50), min_size=1, max_size=3),
    limit=strategies.integers(1, 5),
    length=strategies.integers(1, 30),
    stopping=strategies.sampled_from([0, 4]),
    once=strategies.booleans(),
    seed=strategies.integers(0, 1000),
)
def test_games_side_by_side_are_games_one_by_one(
    world: tuple[str, dict[str, Any]],
    keys: list[int],
    limit: int,
    length: int,
    stopping: int,
    once: bool,
    seed: int,
) -> None:
    domain = make_domain(*world)
    options = [HashOption(str(k), k, len(domain.actions), limit) for k in keys]
    starts = domain.sample_states(np.random.default_rng(seed), 6)
    chance = [np.random.default_rng([seed, game]) for game in range(6)]
    policy = InTurn(len(options), 6, stopping)
    played = play(
        games_at(domain, starts), RowOptions(options), policy, chance, length, gamma=0.9, once=once
    )
    for game, state in enumerate(starts):
        rng, number, runs, taken, over = np.random.default_rng([seed, game]), game, [], 0, False
        while taken < length and not over and not (once and runs):
            option, begun, gains = number % len(options), taken, []
            number += 1
            while True:
                action = options[option].action(domain.feature_values(state)[None])
                outcome = domain.step(state, int(action[0]), rng)
                state, over, taken = outcome.state, outcome.terminated, taken + 1
                gains.append(outcome.reward)
                row = domain.feature_values(state)[None]
                reached = bool(options[option].ends(row)[0])
                if reached or over or len(gains) == limit or taken == length:
                    stopped = False
                    break
                if stopped := bool(stopping and row.sum().astype(int) % stopping == 0):
                    break
            total = sum(gains)
            discounted = sum(0.9**i * gain for i, gain in enumerate(gains))
            runs.append((option, begun, len(gains), total, discounted, reached, over, stopped))
        found, mine = played.runs, played.runs.game == game
        parts = (found.option, found.begun, found.steps, found.total, found.discounted)
        flags = found.reached, found.over, found.stopped
        assert [tuple(each) for each in zip(*(p[mine].tolist() for p in (*parts, *flags)))] == [
            (*run[:4], pytest.approx(run[4]), *run[5:]) for run in runs
        ]
        assert played.over[game] == over
        assert played.by_game(found.total)[game] == pytest.approx(sum(run[3] for run in runs))


def test_a_game_that_is_over_is_not_played() -> None:
    taxi: Any = make_domain('taxi')
    over = next(taxi.state_at(s) for s in np.flatnonzero(taxi.over()))
    games = games_at(taxi, [over, taxi.state_at(int(taxi.start_states()[0]))])
    options = RowOptions([PrimitiveOption('north', 1, 6)])
    played = play(games, options, InTurn(1, 2, 0), np.random.default_rng(0), 3)
    assert played.over.tolist() == [True, False]
    assert played.runs.game.tolist() == [1, 1, 1]


class GoUp:
    """A rule written by hand: north until the first row."""

    name, max_steps = 'to the first row', 20

    def can_start(self, rows: Rows) -> Flags:
        found: Flags = rows[:, 0] > 0
        return found

    def action(self, rows: Rows) -> Ints:
        return np.full(len(rows), NORTH)

    def ends(self, rows: Rows) -> Flags:
        found: Flags = rows[:, 0] == 0
        return found


NORTH = 1  # of Taxi


@pytest.mark.parametrize('action_set', ['human', 'human+primitive'])
def test_a_rule_written_by_hand_is_an_option_to_plan_with(action_set: str) -> None:
    """By exact models and by sampled ones, where it is the best for the first moves."""
    taxi: Any = make_domain('taxi')
    rule = GoUp()
    exact = make_plan(taxi, [rule], PlanRequest(action_set))
    assert exact.names[0] == rule.name
    few = PlanRequest(action_set, game_steps=20_000, sampling=Sampling(n_games=100))
    sampled = make_sampled_plan(taxi, [rule], few)
    state = taxi.decode('taxi 4,4 passenger R destination G')
    for plan in (exact, sampled):
        name = plan.choose(state).name
        assert name == rule.name or (name.startswith('action:') and action_set != 'human')
    top = taxi.decode('taxi 0,4 passenger R destination G')
    assert sampled.choose(top).fallback is (action_set == 'human')
