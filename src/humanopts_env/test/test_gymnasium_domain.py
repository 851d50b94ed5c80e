"""Gymnasium environments with a table as domains, against the environments themselves."""

from collections.abc import Iterator
from typing import Any

import gymnasium
from humanopts_env.board import Board
from humanopts_env.domains.base import DomainError
from humanopts_env.domains.gymnasium_domain import gymnasium_domain, GymnasiumDomain
from humanopts_env.domains.registry import domain_from_json, make_domain, parameters_json
from humanopts_env.domains.tabular import reachable
from humanopts_env.domains.taxi import Taxi
from humanopts_env.testing import DomainContract
import numpy as np
import pytest

TABLES = ('Taxi-v4', 'FrozenLake-v1', 'FrozenLake8x8-v1', 'CliffWalking-v1')
LAKE = gymnasium_domain('FrozenLake-v1')


GAMES: dict[str, Any] = {
    'Taxi': lambda: gymnasium_domain('Taxi-v4')(),
    'FrozenLake': LAKE,
    'CliffWalking': lambda: gymnasium_domain('CliffWalking-v1')(),
    'LakeOfTheUsersOwn': lambda: LAKE(desc=['SFFG', 'FHFF', 'SFFF'], is_slippery=False),
    'NumberedStates': lambda: gymnasium_domain('test/Chain-v0')(),
}
for _name, _make in GAMES.items():
    globals()[f'Test{_name}'] = type(
        f'Test{_name}', (DomainContract,), {'make': staticmethod(_make)}
    )


class Chain(gymnasium.Env[Any, Any]):
    """Three numbered states, as an environment that nobody knows; what is wrong is an argument."""

    metadata: dict[str, Any] = {'render_modes': ['ansi']}

    def __init__(self, wrong: str = '', render_mode: str | None = None) -> None:
        """Build a table, or a broken one."""
        self.observation_space = gymnasium.spaces.Discrete(3)
        self.action_space = gymnasium.spaces.Discrete(80 if wrong == 'keys' else 2)
        self.render_mode, self.s = render_mode, 0
        end = [(1.0, 2, 1.0, True)]
        forward = {
            'sum': [(0.5, 1, 0.0, False)],
            'fickle': [(1.0, 0, float(np.random.default_rng().random()), False)],
            'state': [(1.0, 3, 0.0, False)],
            'reward': [(1.0, 1, float('nan'), False)],
            'form': [(1.0, 1)],
            'both': [(0.5, 2, 1.0, True), (0.5, 2, 1.0, False)],
        }.get(wrong, [(0.5, 1, 0.0, False), (0.5, 0, 0.0, False)])
        count = int(self.action_space.n)
        self.P = {
            0: dict.fromkeys(range(count), forward),
            1: {0: end, 1: end},
            2: {0: end, 1: end},
        }
        if wrong == 'keys':
            self.P |= {s: dict.fromkeys(range(80), end) for s in (1, 2)}
        if wrong == 'box':
            self.observation_space = gymnasium.spaces.Box(0, 1)  # type: ignore[assignment]

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[int, dict[str, Any]]:
        """Begin in 0 or 1."""
        super().reset(seed=seed)
        self.s = int(self.np_random.integers(2))
        return self.s, {}

    def render(self) -> str:  # type: ignore[override]
        """Mark the state as Gymnasium's toys do."""
        cells = [gymnasium.utils.colorize(c, 'red', highlight=True) for c in 'abc']
        return 'a chain\n' + ''.join(
            cells[i] if i == self.s else gymnasium.utils.colorize(c, 'blue')
            for i, c in enumerate('abc')
        )


@pytest.fixture(scope='module', autouse=True)
def chain() -> Iterator[None]:
    """Register the chain."""
    gymnasium.register('test/Chain-v0', entry_point=Chain)
    yield
    del gymnasium.registry['test/Chain-v0']


@pytest.mark.parametrize('env_id', TABLES)
def test_the_transitions_are_the_environments_own(env_id: str) -> None:
    """State by state and action by action, outside states where the task is over."""
    domain = gymnasium_domain(env_id)()
    table, theirs = domain.transitions(), gymnasium.make(env_id).unwrapped.P  # type: ignore[attr-defined]
    visited = reachable(domain)
    for state in np.flatnonzero(~domain.over()).tolist():
        for action in range(len(domain.actions)):
            at, expected, found = (state, action), {}, {}
            for share, to, gain, over in theirs[state][action]:
                assert over == domain.is_over(int(to)) or not share or not visited[state]
                expected[int(to), float(gain)] = expected.get((int(to), float(gain)), 0.0) + share
            for share, to, gain in zip(
                table.probability[at], table.successor[at].tolist(), table.reward[at].tolist()
            ):
                if share > 0:
                    found[to, gain] = found.get((to, gain), 0.0) + share
            assert found == pytest.approx(expected)


def test_features_are_those_of_the_states_own_encoding() -> None:
    """Taxi has those of ours; grids have rows and columns; others are numbered."""
    taxi = gymnasium_domain('Taxi-v4')()
    assert taxi.features == Taxi().features
    assert taxi.encode(328) == 'taxi 3,1 passenger Y destination R'
    assert taxi.decode('taxi 3,1 passenger Y destination R') == 328
    cliff = gymnasium_domain('CliffWalking-v1')()
    assert cliff.encode(36) == 'row 3, col 0'
    assert gymnasium_domain('test/Chain-v0')().encode(2) == 'state 2'


@pytest.mark.parametrize(('env_id', 'start'), [('FrozenLake-v1', 5), ('CliffWalking-v1', 18)])
def test_an_arrow_leads_where_it_points(env_id: str, start: int) -> None:
    """The first outcome is the intended one, on slippery ice too."""
    domain = gymnasium_domain(env_id)(**({'desc': ['SFFF'] * 4} if 'Lake' in env_id else {}))
    moves = {'up': (-1, 0), 'down': (1, 0), 'left': (0, -1), 'right': (0, 1)}
    for number, action in enumerate(domain.actions):
        here = domain.feature_table()[start]
        there = domain.feature_table()[domain.transitions().successor[start, number, 0]]
        assert tuple((there - here).tolist()) == moves[action.key]


def test_an_environment_brings_its_own_drawing() -> None:
    chain = gymnasium_domain('test/Chain-v0')()
    assert chain.board(1) == Board(picture='a chain\na█c', notes=('state: 1',))
    assert chain.board(1, ()) == Board()


def test_a_name_with_the_prefix_is_resolved() -> None:
    """As messages and files carry it, with the environment's arguments."""
    domain = make_domain('gymnasium:FrozenLake-v1', {'is_slippery': False, 'map_name': '8x8'})
    assert domain.name == 'gymnasium:FrozenLake-v1'
    assert isinstance(domain, GymnasiumDomain)
    assert domain.n_states == 64
    assert domain.transitions().deterministic
    again = domain_from_json(domain.name, parameters_json(domain))
    assert dict(again.parameters) == dict(domain.parameters)
    drawn = domain_from_json('gymnasium:FrozenLake-v1', '{"desc": ["SF", "FG"]}')
    assert isinstance(drawn, GymnasiumDomain)
    assert drawn.n_states == 4


@pytest.mark.parametrize(
    ('name', 'parameters', 'text'),
    [
        ('gymnasium:Pendulum-v1', {}, 'only environments with Discrete actions can be taught'),
        ('gymnasium:Nope-v1', {}, r'Nope-v1 cannot be made: .*Nope'),
        (
            'gymnasium:FrozenLake-v1',
            {'map': 3},
            'FrozenLake-v1 does not take the parameter map; it takes',
        ),
        ('gymnasium:test/Chain-v0', {'wrong': 'fickle'}, 'a different game each time'),
        ('gymnasium:FrozenLake-v1', {'is_slippery': 'False'}, 'is "False", but must be true'),
        ('gymnasium:FrozenLake-v1', {'desc': ['SF', 7]}, r'of the type list\[str\] \| None'),
        ('gymnasium:FrozenLake-v1', {'max_episode_steps': 'a'}, r'of the type int \| None'),
        ('gymnasium:FrozenLake-v1', {'render_mode': 'ansi'}, 'leave render_mode out'),
        ('gymnasium:FrozenLake-v1', {'desc': {1}}, 'the parameter desc of .* cannot be kept'),
        ('gymnasium:Taxi-v4', {'fickle_passenger': True}, 'outside its table'),
        ('gymnasium:test/Chain-v0', {'wrong': 'sum'}, r'P\[0\]\[0\] has probabilities \[0\.5\]'),
        ('gymnasium:test/Chain-v0', {'wrong': 'state'}, 'leads to state 3 of 3'),
        ('gymnasium:test/Chain-v0', {'wrong': 'reward'}, 'reward nan'),
        ('gymnasium:test/Chain-v0', {'wrong': 'form'}, 'a table that cannot be read'),
        (
            'gymnasium:test/Chain-v0',
            {'wrong': 'both'},
            'state 2 ends the task when entered one way',
        ),
        ('gymnasium:test/Chain-v0', {'wrong': 'keys'}, '80 actions'),
        ('gymnasium:test/Chain-v0', {'wrong': 'box'}, 'needs Discrete'),
    ],
)
def test_what_cannot_be_a_domain_is_refused_by_name(
    name: str, parameters: dict[str, Any], text: str
) -> None:
    with pytest.raises(DomainError, match=text) as refusal:
        make_domain(name, parameters)
    assert name in str(refusal.value)
