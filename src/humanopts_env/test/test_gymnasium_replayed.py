"""Gymnasium environments without a table are replayed; features are observed or extracted."""

from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from enum import Enum
from multiprocessing import get_context
from pathlib import Path
import re
import sys
import time
from typing import Any

import gymnasium
from gymnasium import spaces
from humanopts_env.domains.base import Domain, DomainError, FeatureKind, shown_values
from humanopts_env.domains.capabilities import caption_of
from humanopts_env.domains.described import published_state
from humanopts_env.domains.gymnasium_replayed import groups_of, ReplayedEnvironment
from humanopts_env.domains.minigrid_features import COLOURS
from humanopts_env.domains.registry import domain_from_json, make_domain, parameters_json
from humanopts_env.game import Accepted, Command, Game, Reason, Refused, Source
from humanopts_env.games import new_games
from humanopts_env.testing import DomainContract
import numpy as np
import pytest

WALK, LANDER = 'gymnasium:test/Walk-v0', 'gymnasium:LunarLander-v3'
DOORKEY = 'gymnasium:MiniGrid-DoorKey-{0}x{0}-v0'
EVERY = spaces.Dict(
    {
        'speed': spaces.Box(-np.inf, np.inf, (2,)),
        'gear': spaces.Discrete(3, start=1),
        'cell': spaces.MultiDiscrete([30, 4]),
        'lamps': spaces.MultiBinary(2),
        'near': spaces.Box(0, 1, (2, 2)),
        'pair': spaces.Tuple([spaces.Discrete(2), spaces.Box(0, 5, dtype=np.float32)]),
        'mission': spaces.Text(5),
    }
)


class TestLunarLander(DomainContract):
    def make(self) -> Domain:
        return make_domain(LANDER)


class TestDoorKey(DomainContract):
    def make(self) -> Domain:
        return make_domain(DOORKEY.format(8))


class TestKeyCorridor(DomainContract):
    def make(self) -> Domain:
        return make_domain('gymnasium:MiniGrid-KeyCorridorS3R2-v0')


class Mood(Enum):
    CALM = 0
    ALERT = 1


class Walk(gymnasium.Env[Any, Any]):
    """A walk on a line to 5 or -5; what is special is an argument."""

    metadata: dict[str, Any] = {'render_modes': ['ansi']}

    def __init__(self, special: str = '', render_mode: str | None = None) -> None:
        """Start anywhere between."""
        self.special, self.render_mode = special, render_mode
        self.action_space = spaces.Discrete(3, start=-1)  # type: ignore[assignment]
        self.observation_space = spaces.Box(-6, 6, (1,))
        if special == 'image':
            self.observation_space = spaces.Box(0, 255, (64, 64, 3), np.uint8)
        if special == 'spaces':
            self.observation_space = EVERY  # type: ignore[assignment]
        if special == 'sequence':
            self.observation_space = spaces.Sequence(spaces.Discrete(2))  # type: ignore[assignment]
        if special == 'keys':
            self.action_space = spaces.Discrete(80)  # type: ignore[assignment]
        self.seen = np.zeros(1, np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Draw a position."""
        super().reset(seed=seed)
        self.place, self.steps, self.mood = int(self.np_random.integers(-2, 3)), 0, Mood.CALM
        if self.special == 'fickle':
            self.place += np.random.default_rng().random()
        return self.observe(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Walk; the observation is always the same array."""
        if self.special == 'slow':
            time.sleep(2.6)
        self.steps += 1
        self.place += int(action)
        if self.special == 'raises' and self.place == 2:
            raise RuntimeError('the floor is wet')
        if self.special == 'endless':
            self.place = min(max(self.place, -3), 3)
        self.mood = Mood(int(self.place > 0))
        return self.observe(), 0.0, abs(self.place) >= 5, self.steps >= 7, {}

    def observe(self) -> Any:
        """Return the observation."""
        if self.special == 'spaces':
            values = EVERY.sample() | {'lamps': np.zeros(2, np.int8), 'near': np.eye(2)}
            values |= {'speed': np.full(2, self.place, np.float32), 'gear': np.int64(2)}
            return values | {'cell': np.array([29, 3]), 'pair': (1, np.array([9.0]))}
        self.seen[0] = self.place
        return self.seen

    def render(self) -> str:  # type: ignore[override]
        """Show the position."""
        return f'at {self.place}'


@pytest.fixture(scope='module', autouse=True)
def walk() -> Iterator[None]:
    """Register the walk."""
    gymnasium.register('test/Walk-v0', entry_point=Walk)
    yield
    del gymnasium.registry['test/Walk-v0']


@pytest.fixture
def extractor(tmp_path: Path) -> Callable[..., Domain]:
    """Write an extractor to a file, and make the domain of an environment with it."""

    def make(body: str, name: str = WALK, more: str = '', **parameters: Any) -> Domain:
        file = tmp_path / 'seen.py'
        file.write_text(f'import numpy as np\ndef features(env):\n    {body}\n{more}\n')
        return make_domain(name, {'features': f'{file}:features', **parameters})

    return make


def played(domain: Domain, actions: Any, seed: int = 0) -> list[Any]:
    """Return the states of an episode."""
    rng = np.random.default_rng(seed)
    states = [domain.reset(rng)]
    for action in actions:
        states.append(domain.step(states[-1], action, rng).state)
    return states


def test_documented_observations_have_names_and_units() -> None:
    names = {
        'CartPole-v1': ['cart_position', 'cart_speed', 'pole_angle', 'pole_speed'],
        'MountainCar-v0': ['position', 'speed'],
        'Acrobot-v1': ['cos_1', 'sin_1', 'cos_2', 'sin_2', 'speed_1', 'speed_2'],
        'LunarLander-v3': [
            *['x', 'y', 'x_speed', 'y_speed', 'angle', 'angular_speed', 'left_leg', 'right_leg']
        ],
    }
    for env_id, wanted in names.items():
        domain = make_domain(f'gymnasium:{env_id}')
        assert [feature.name for feature in domain.features] == wanted
        assert domain.parameters == {'features': 'observation'}
    assert {a.name: a.key for a in make_domain(LANDER).actions} == {
        'nothing': 'down',
        'fire_left': 'left',
        'fire_main': 'up',
        'fire_right': 'right',
    }


def test_every_kind_of_space_becomes_features() -> None:
    domain = make_domain(WALK, {'special': 'spaces'})
    kinds = {feature.name: feature.kind for feature in domain.features}
    assert kinds == {
        'cell_0': FeatureKind.ORDINAL,
        'cell_1': FeatureKind.NOMINAL,
        'gear': FeatureKind.NOMINAL,
        'lamps_0': FeatureKind.NOMINAL,
        'lamps_1': FeatureKind.NOMINAL,
        **{f'near_{place}': FeatureKind.CONTINUOUS for place in ('0_0', '0_1', '1_0', '1_1')},
        'pair_0': FeatureKind.NOMINAL,
        'pair_1': FeatureKind.CONTINUOUS,
        'speed_0': FeatureKind.CONTINUOUS,
        'speed_1': FeatureKind.CONTINUOUS,
    }
    assert domain.parameters['ranges'] == {'speed_0': [-20.0, 20.0], 'speed_1': [-20.0, 20.0]}
    values = shown_values(domain, domain.reset(np.random.default_rng(0)))
    assert (values['cell_0'], values['gear'], values['pair_0']) == ('29', '2', '1')
    assert values['pair_1'] == '5'  # clipped: the environment says 9


def test_a_state_does_not_change_when_the_environment_reuses_its_array() -> None:
    states = played(make_domain(WALK), [2, 2, 0])
    first = states[0].features[0]
    assert [state.features[0] - first for state in states] == [0, 1, 2, 1]


def test_an_episode_is_over_only_when_the_environment_terminates() -> None:
    """Truncations, by TimeLimit or by the environment itself, are left to max_steps."""
    walk, grid = make_domain(WALK), make_domain(DOORKEY.format(5), {'max_steps': 3})
    assert not any(state.over for state in played(walk, [1] * 9))
    assert played(walk, [2] * (5 - int(walk.reset(np.random.default_rng(0)).features[0])))[-1].over
    assert grid.max_steps == 3
    assert not any(state.over for state in played(grid, [0] * 5))
    assert make_domain('gymnasium:CartPole-v1', {'max_episode_steps': 20}).max_steps == 20
    assert make_domain(WALK, {'special': 'endless'}).max_steps == 1000


def test_kinds_and_ranges_of_plain_values_are_measured(extractor: Callable[..., Domain]) -> None:
    body = (
        "return {'place': env.place, 'right': env.place > 0, 'mood': env.mood, "
        "'side': 'left' if env.place < 0 else 'right'}"
    )
    domain = extractor(body, more="QUESTIONS = {'side': 'which side it is on'}")
    assert domain.parameters['ranges'] == {
        'place': [-20.0, 20.0],
        'right': ['no', 'yes'],
        'mood': ['alert', 'calm', 'other'],
        'side': ['left', 'right', 'other'],
    }
    questions = [feature.question for feature in domain.features]
    assert questions == ['what place is', 'what right is', 'what mood is', 'which side it is on']
    again = domain_from_json(domain.name, parameters_json(domain))
    assert again.features == domain.features


def test_declared_ranges_are_used(extractor: Callable[..., Domain]) -> None:
    domain = extractor(
        "return {'place': env.place, 'far': None if env.place < 0 else env.place, 'pace': 2.5}",
        more="RANGES = {'place': range(-3, 4), 'far': (0, 5, 'none'), 'pace': (0.0, 2.0, 'm/s')}",
    )
    assert 'ranges' not in domain.parameters
    start = int(played(domain, [])[0].features[0]) - 3  # the range begins with -3
    ends = [played(domain, [1 + sign] * (4 - sign * start))[-1] for sign in (-1, 1)]
    texts = [list(shown_values(domain, state).values()) for state in ends]
    assert texts == [['-3', 'none', '2 m/s'], ['3', '4', '2 m/s']]


def test_names_of_actions_come_from_the_extractor(extractor: Callable[..., Domain]) -> None:
    actions = extractor("return {'x': 1}", more="ACTIONS = ['west', 'wait', 'east']").actions
    assert [(a.name, a.key) for a in actions] == [
        ('west', 'left'),
        ('wait', 'down'),
        ('east', 'right'),
    ]
    grid = extractor("return {'x': env.agent_pos[0]}", DOORKEY.format(5))
    assert [a.name for a in grid.actions][:3] == ['left', 'right', 'forward']
    assert [a.name for a in make_domain(WALK).actions] == ['action_0', 'action_1', 'action_2']


def test_an_extractor_replaces_a_table(extractor: Callable[..., Domain]) -> None:
    lake = 'gymnasium:FrozenLake-v1'
    assert not isinstance(make_domain(lake), ReplayedEnvironment)
    replayed = extractor("return {'cell': env.s}", lake)
    assert isinstance(replayed, ReplayedEnvironment)
    assert [feature.name for feature in replayed.features] == ['cell']


def test_a_picture_shows_its_state_and_leaves_the_world_alone() -> None:
    domain = make_domain(WALK)
    assert isinstance(domain, ReplayedEnvironment)
    for state in reversed(played(domain, [2, 0, 0, 2])):
        assert domain.world(state).picture() == f'at {state.features[0]:.0f}'  # type: ignore[attr-defined]
    lander = make_domain(LANDER)
    assert isinstance(lander, ReplayedEnvironment)
    rng = np.random.default_rng(1)
    state = lander.reset(rng)
    for _ in range(40):
        image = lander.world(state).picture()  # type: ignore[attr-defined]
        state = lander.step(state, 2, rng).state
    assert image.shape == (400, 600, 3)
    assert make_domain(LANDER).decode(lander.encode(state)) == state  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ('body', 'text'),
    [
        ('return {}', 'it returned {}, not the values of features by name'),
        ('return 3', 'it returned 3, not the values of features by name'),
        ("raise KeyError('agent')", "failed: KeyError: 'agent'"),
        ("return {'Place': 1}", "the name 'Place' is not like agent_row"),
        ("return {f'at_{env.steps}': 1}", 'other names than before: at_0, at_1'),
        (
            "return {'place': env.place / np.float64(0 * env.place)}",
            r'place is \S+ in some states',
        ),
        ("return {'place': env.seen}", 'place is of the type ndarray; return each of its numbers'),
        ("return {'place': env.place or None}", 'place is None in some states: declare its range'),
    ],
)
@pytest.mark.filterwarnings('ignore:.*encountered in:RuntimeWarning')
def test_an_extractor_that_cannot_be_used_is_refused(
    extractor: Callable[..., Domain], body: str, text: str
) -> None:
    with pytest.raises(DomainError, match=text) as refusal:
        extractor(body)
    assert WALK in str(refusal.value)
    assert '\n' not in str(refusal.value)


@pytest.mark.parametrize(
    ('more', 'text'),
    [
        ("RANGES = {'pace': (0, 1)}", "RANGES has 'pace', which is not a feature; there are x"),
        ("RANGES = {'x': 3}", r'the range of x is 3; write one like \(0.0, 1.5\)'),
        ("RANGES = {'x': ('a', 'b')}", r"x is 1, and its range is \('a', 'b'\)"),
        ("QUESTIONS = {'y': 'why'}", "QUESTIONS has 'y'"),
        ("ACTIONS = ['west']", 'has 3 actions, and ACTIONS names 1'),
        ('import nothing_like_it', 'cannot be loaded: ModuleNotFoundError'),
        ('del features', 'has no function features'),
    ],
)
def test_a_declaration_that_cannot_be_used_is_refused(
    extractor: Callable[..., Domain], more: str, text: str
) -> None:
    with pytest.raises(DomainError, match=text):
        extractor("return {'x': 1}", more=more)


@pytest.mark.parametrize(
    ('name', 'parameters', 'text'),
    [
        (WALK, {'special': 'image'}, r'64 x 64 x 3 numbers .* write an extractor'),
        (WALK, {'special': 'sequence'}, 'observations of the kind Sequence .* write an extractor'),
        (WALK, {'special': 'keys'}, '80 actions, and there are keys for 62'),
        (
            WALK,
            {'special': 'fickle'},
            'not determined by its seed: after 0 identical actions, obs',
        ),
        (WALK, {'special': 'slow'}, r'took \d+\.\d s for 1 steps'),
        (WALK, {'special': 'raises'}, 'failed: RuntimeError: the floor is wet'),
        (
            WALK,
            {'features': 'nope'},
            "no features 'nope'; give FILE.py:NAME, or one of observation",
        ),
        (WALK, {'features': '/no/such.py:f'}, 'cannot be loaded: FileNotFoundError'),
        (WALK, {'ranges': {'observation': 3}}, 'the range of observation is 3'),
        (WALK, {'ranges': 3}, 'ranges is 3, but must be given by feature name'),
        (DOORKEY.format(8), {'features': 'observation'}, r'7 x 7 x 3 numbers \(image\)'),
        ('gymnasium:no_such_package:Env-v0', {}, 'pip install no_such_package'),
    ],
)
def test_an_environment_that_cannot_be_taught_is_refused(
    name: str, parameters: dict[str, Any], text: str
) -> None:
    with pytest.raises(DomainError, match=text) as refusal:
        make_domain(name, parameters)
    assert name in str(refusal.value)
    assert '\n' not in str(refusal.value)


def test_a_group_has_some_of_the_features_in_their_order_not_all() -> None:
    parts = [f'observation_{number}' for number in range(12)]
    assert groups_of(parts) == []
    (group,) = groups_of([*parts, 'speed'])
    assert (group.words, group.features) == ('the observation', tuple(parts))


def test_nodes_do_not_check_again_what_the_game_has_checked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each step of this environment sleeps, and none is taken."""
    slept: list[float] = []
    monkeypatch.setattr(time, 'sleep', slept.append)
    assert make_domain(WALK, {'special': 'slow'}, checked=True).features
    assert slept == []


@pytest.mark.parametrize(
    ('module', 'text'),
    [
        ('minigrid', 'needs the module minigrid; install its package: .* -m pip install minigrid'),
        (
            'humanopts_env.domains.gymnasium_replayed',
            'needs the package gymnasium: ModuleNotFound',
        ),
    ],
)
def test_a_missing_package_is_named(
    monkeypatch: pytest.MonkeyPatch, module: str, text: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(DomainError, match=text):
        make_domain(DOORKEY.format(8))


def test_a_step_that_fails_later_is_refused_and_the_game_continues(
    extractor: Callable[..., Domain],
) -> None:
    """An extractor fails where no walk at the start has been."""
    body = "return {'place': env.place if env.steps < 300 else float('nan')}"
    game = Game(extractor(body, special='endless'))
    assert game.reset('', 0, Source.MACHINE).transition is not None

    def commanded(action: str) -> Accepted | Refused:
        at = game.transition
        return game.command(Command('/m#1', 1, Source.MACHINE, at.episode, at.step, action))

    while isinstance(answer := commanded('action_1'), Accepted):
        pass
    assert answer.reason is Reason.FAILED
    assert answer.detail.endswith('failed: place is nan')
    assert game.transition.step == 299
    assert isinstance(commanded('action_1'), Refused)
    assert game.reset('', 1, Source.MACHINE).transition is not None
    assert isinstance(commanded('action_1'), Accepted)


def test_the_extractor_of_the_documentation_drives_a_car(tmp_path: Path) -> None:
    page = Path(__file__).parents[3] / 'docs/how-to/teach-in-your-own-environment.md'
    first, more = re.findall(r'```python\n(.*?)```', page.read_text(), re.DOTALL)
    (tmp_path / 'racing.py').write_text(first + more)
    domain = make_domain(
        'gymnasium:CarRacing-v3',
        {'continuous': False, 'features': f'{tmp_path}/racing.py:features'},
    )
    assert [action.key for action in domain.actions] == ['c', 'right', 'left', 'up', 'down']
    games, rng, total = (
        new_games(domain, 2, np.random.default_rng(0)),
        np.random.default_rng(0),
        0.0,
    )
    for _ in range(200):
        bearing, speed = games.features().T
        steer = np.where(bearing > 0, 2, 1)
        total += games.step(np.where(abs(bearing) > 0.1, steer, 3 * (speed < 30)), rng).reward
    assert (total > 50).all()


# MiniGrid.


def test_names_and_ranges_are_equal_in_all_sizes() -> None:
    assert make_domain(DOORKEY.format(6)).features == make_domain(DOORKEY.format(16)).features


@pytest.mark.parametrize('size', [6, 8, 16])
def test_doorkey_is_solved_by_following_the_paths(size: int) -> None:
    """The first moves of the shortest paths lead to the key, the door and the goal."""
    domain = make_domain(DOORKEY.format(size))
    number = {action.name: index for index, action in enumerate(domain.actions)}
    rng = np.random.default_rng(size)
    for _ in range(10):
        state = domain.reset(rng)
        for _ in range(20 * size):
            seen = shown_values(domain, state)
            thing = (
                'goal'
                if seen['door_state'] == 'open'
                else 'door'
                if seen['carrying'] == 'key'
                else 'key'
            )
            move = seen[f'{thing}_path']
            if move == 'there':
                move = {'key': 'pickup', 'door': 'toggle'}[thing]
            outcome = domain.step(state, number[move], rng)
            state = outcome.state
            if outcome.terminated:
                break
        assert outcome.reward > 0


def test_the_mission_of_an_episode_is_its_caption() -> None:
    """It differs by seed where the ball to pick up has another colour."""
    domain = make_domain('gymnasium:MiniGrid-KeyCorridorS3R1-v0')
    rng = np.random.default_rng(0)
    missions = {caption_of(domain, domain.reset(rng)) for _ in range(20)}
    assert missions <= {f'pick up the {colour} ball' for colour in COLOURS}
    assert len(missions) > 1


def test_offsets_are_relative_to_the_agent() -> None:
    domain = make_domain(DOORKEY.format(8))
    rng = np.random.default_rng(3)
    state = domain.reset(rng)
    here = shown_values(domain, state)
    for turn in (1, 1, 1, 1):  # to the right
        state = domain.step(state, turn, rng).state
        seen = shown_values(domain, state)
        assert int(seen['key_ahead']) == int(here['key_right'])
        assert int(seen['key_right']) == -int(here['key_ahead'])
        assert seen['left'] == here['front']
        here = seen


@pytest.mark.parametrize(
    ('env_id', 'things'),
    [
        ('KeyCorridorS3R2', ['key', 'ball', 'door']),
        ('UnlockPickup', ['key', 'box', 'door']),
        ('LavaCrossingS9N2', ['goal', 'lava']),
        ('FourRooms', ['goal']),
        ('RedBlueDoors-8x8', ['blue_door', 'red_door']),
        ('Fetch-8x8-N3', ['key', 'ball', 'target']),
        ('Dynamic-Obstacles-8x8', ['ball', 'goal']),
    ],
)
def test_each_kind_of_object_has_features(env_id: str, things: list[str]) -> None:
    names = [f.name for f in make_domain(f'gymnasium:MiniGrid-{env_id}-v0').features]
    end = '_distance'
    assert [name.removesuffix(end) for name in names if name.endswith(end)] == things


def test_another_process_makes_an_equal_domain() -> None:
    domain = make_domain(LANDER, {'gravity': -8.0})
    state = domain.sample_states(np.random.default_rng(0), 1)[0]
    with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as process:
        there = process.submit(parameters_json, domain)
        decoded = process.submit(published_state, domain, domain.encode(state), ())
        assert (there.result(), decoded.result()) == (parameters_json(domain), state)
