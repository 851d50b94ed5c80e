"""What the choice between options depends on: a battery that no option mentions."""

from collections.abc import Sequence

from humanopts_env.domains.base import Action, Feature
from humanopts_env.domains.replayed_domain import History, ReplayedDomain, World
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.action_set import ActionSet, AnyOption
from humanopts_learner.planning.columns import suggest_column
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import HUMAN, PlanRequest
from humanopts_learner.planning.sampled_plan import play_games, SampledPlan
import numpy as np
import pytest

CELLS, FULL, LOW = 12, 40, 14  # cells of a street; steps of a full battery; where people charge it
WEST, EAST, DROP, PLUG = range(4)
WAYS, NO_YES = ('west', 'east', 'here'), ('no', 'yes')
DELIVER, CHARGE = 'deliver', 'charge'


class Street:
    """Parcels are delivered in a street with a charger at its west end."""

    def reset(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.cell, self.target = self.rng.integers(CELLS, size=2).tolist()
        self.battery = int(self.rng.integers(FULL // 4, FULL + 1))
        self.last = ''

    def step(self, action: int) -> tuple[float, bool]:
        self.battery -= 1
        self.last = ''
        if action == DROP and self.cell == self.target:
            self.last, self.target = DELIVER, int(self.rng.integers(CELLS))
        elif action == PLUG and self.cell == 0:
            self.last, self.battery = CHARGE, FULL
        elif action in (WEST, EAST):
            self.cell = min(max(self.cell + 2 * action - 1, 0), CELLS - 1)
        return float(self.last == DELIVER), self.battery == 0

    def features(self) -> Sequence[float]:
        ways = [(place > self.cell) + 2 * (place == self.cell) for place in (self.target, 0)]
        return [self.cell, *ways, self.battery, self.last == DELIVER, self.last == CHARGE]


class Streets(ReplayedDomain):
    name, gamma, max_steps = 'street', 0.98, 150
    parameters: dict[str, int] = {}
    features = (
        Feature.number('cell', 'which cell it is', CELLS),
        Feature.nominal('target_way', 'which way the target is', WAYS),
        Feature.nominal('charger_way', 'which way the charger is', WAYS),
        Feature.continuous('battery', 'how full the battery is', 0, FULL, 'steps'),
        Feature.nominal('delivered', 'whether a parcel was just delivered', NO_YES),
        Feature.nominal('charged', 'whether it was just charged', NO_YES),
    )
    actions = tuple(Action(name, name[0], name) for name in ('west', 'east', 'drop', 'plug'))

    def make_world(self) -> World:
        return Street()


STREETS = Streets()
CHOSEN = {DELIVER: ('target_way', 'delivered'), CHARGE: ('charger_way', 'charged')}


def shown(name: str, number: int, state: History) -> Demonstration:
    """Return what a person shows who charges only when the battery is low."""
    states, actions, rng = [state], [], np.random.default_rng(0)
    way, done, last = (1, 4, DROP) if name == DELIVER else (2, 5, PLUG)
    while (low := state.features[3] < LOW or name == DELIVER) and not state.over:
        action = (WEST, EAST, last)[int(states[-1].features[way])]
        states.append(STREETS.step(states[-1], action, rng).state)
        actions.append(STREETS.actions[action].name)
        if states[-1].features[done]:
            break
    assert low == bool(actions)
    return Demonstration(
        Kind.TRAJECTORY if actions else Kind.NOT_HERE,
        f'{name}{number}',
        STREETS.name,
        '{}',
        'ann',
        'one',
        option_name=name,
        number=number,
        chosen_features=CHOSEN[name],
        feature_names=tuple(feature.name for feature in STREETS.features),
        features=tuple(state.features for state in states),
        states=tuple(map(STREETS.encode, states)),
        actions=tuple(actions),
        rewards=(-1.0,) * len(actions),
        terminated=states[-1].over,
        can_start_at_end=bool(actions) and name == DELIVER,
    )


@pytest.fixture(scope='module')
def taught() -> dict[str, list[Demonstration]]:
    starts = STREETS.sample_states(np.random.default_rng(1), 200)
    high = [state for state in starts if state.features[3] >= 2 * LOW and state.features[0] > 0]
    low = [state for state in starts if 11 < state.features[3] < LOW and state.features[0] > 0]
    return {
        DELIVER: [
            shown(DELIVER, n, state) for n, state in enumerate([*high[:6], low[0]], start=1)
        ],
        CHARGE: [shown(CHARGE, n, state) for n, state in enumerate(low[:6], start=1)],
    }


@pytest.fixture(scope='module')
def options(taught: dict[str, list[Demonstration]]) -> list[LearnedOption]:
    return [learn_option(demos, STREETS, 0) for demos in taught.values()]


def mean_return(options: Sequence[LearnedOption], *columns: str) -> float:
    request = PlanRequest(HUMAN, game_steps=8_000, seed=1, columns=columns)
    plan = make_plan(STREETS, options, request)
    assert isinstance(plan, SampledPlan)
    return float(plan.play(2, 20).total.mean())


def test_the_battery_is_suggested_from_what_was_shown(
    taught: dict[str, list[Demonstration]], options: list[LearnedOption]
) -> None:
    name, _, edges = suggest_column(STREETS, options, taught).partition(':')
    assert name == 'battery'
    numbers = [float(edge) for edge in edges.split(',')]
    assert any(LOW - 2 < number < 2 * LOW for number in numbers)
    assert np.diff(numbers) == pytest.approx(FULL / 10)


def test_nothing_is_suggested_where_the_options_were_shown_alike(
    taught: dict[str, list[Demonstration]], options: list[LearnedOption]
) -> None:
    assert suggest_column(STREETS, options[:1], {DELIVER: taught[DELIVER]}) == ''
    charge = [
        shown(CHARGE, n, STREETS.decode(demo.states[0])) for n, demo in enumerate(taught[CHARGE])
    ]
    deliver = [shown(DELIVER, n, STREETS.decode(demo.states[0])) for n, demo in enumerate(charge)]
    alike = {DELIVER: deliver, CHARGE: charge}
    assert suggest_column(STREETS, options, alike) == ''


def test_a_plan_needs_the_column_of_the_battery(
    taught: dict[str, list[Demonstration]], options: list[LearnedOption]
) -> None:
    """Symbols alone deliver until the battery is empty, which is worse than random choice."""
    actions = ActionSet(STREETS, HUMAN, options)
    policy = AnyOption(np.random.default_rng(3))
    at_random = play_games(actions, policy, STREETS.gamma, 2, 20).total.mean()
    column = suggest_column(STREETS, options, taught)
    assert mean_return(options) < at_random < 0.75 * mean_return(options, column)
