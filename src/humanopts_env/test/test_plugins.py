"""Domains of other packages, found by entry points: made, or refused by name with the reason."""

from collections.abc import Callable
from pathlib import Path
import time
from typing import Any

from humanopts_env.contract import check_domain, ContractError
from humanopts_env.domains.base import DomainError, Feature, FeatureKind, is_enumerable, Outcome
from humanopts_env.domains.registry import domain_names, make_domain, reference_options
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.taxi import Taxi, TaxiState
import numpy as np
import pytest

MODULE = """
from humanopts_env.domains.taxi import Taxi


class Cab(Taxi):
    def __init__(self, rows=5):
        super().__init__(rows)
        self.name, self.parameters = 'cab', {'rows': rows}


class Wide(Cab):
    def __init__(self):
        super().__init__()
        self.name = 'wide'
        self.features = [f for f in self.features if f.name != 'blocked_moves']


def broken():
    raise RuntimeError('no licence found')


def leaving():
    raise SystemExit(3)


def options(domain):
    return {'nothing': None}


def no_options(domain):
    raise KeyError('map')
"""
DOMAINS = {
    'cab': 'cab_plugin:Cab',
    'wide': 'cab_plugin:Wide',
    'broken': 'cab_plugin:broken',
    'leaving': 'cab_plugin:leaving',
    'gone': 'cab_plugin_that_is_not_there:Cab',
    'empty': 'cab_plugin:Bus',
    'rooms': 'cab_plugin:Cab',
}
OPTIONS = {'cab': 'cab_plugin:options', 'wide': 'cab_plugin:no_options'}


@pytest.fixture(autouse=True)
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install a package of another author."""
    (tmp_path / 'cab_plugin.py').write_text(MODULE)
    info = tmp_path / 'cab_plugin-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: cab-plugin\nVersion: 1.0\n')
    groups = {'humanopts.domains': DOMAINS, 'humanopts.reference_options': OPTIONS}
    lines = [
        line
        for group, points in groups.items()
        for line in (f'[{group}]', *(f'{name} = {value}' for name, value in points.items()))
    ]
    (info / 'entry_points.txt').write_text('\n'.join(lines))
    monkeypatch.syspath_prepend(str(tmp_path))


def test_a_domain_of_another_package_is_made_by_its_name() -> None:
    """With its parameters and its reference options."""
    assert {'cab', 'taxi'} <= set(domain_names())
    domain = make_domain('cab', {'rows': 6})
    assert (domain.name, dict(domain.parameters)) == ('cab', {'rows': 6})
    assert reference_options(domain) == {'nothing': None}


@pytest.mark.parametrize(
    ('name', 'text'),
    [
        ('gone', "'gone' of cab-plugin cannot be loaded from .*ModuleNotFoundError"),
        ('empty', "'empty' of cab-plugin cannot be loaded .*Bus"),
        ('broken', 'broken cannot be made: RuntimeError: no licence found'),
        ('leaving', 'leaving cannot be made: SystemExit: 3'),
        ('wide', r'wide breaks the contract of domains: .*\(10,\) features'),
        ('rooms', "'rooms' is the name of several domains, cab_plugin:Cab, .*Rooms: rename one"),
        ('bus', "no domain 'bus'; there is .*cab.*gymnasium:ENV_ID"),
    ],
)
def test_what_cannot_be_played_is_refused_by_name(name: str, text: str) -> None:
    """With the reason."""
    with pytest.raises(DomainError, match=text):
        make_domain(name)


def test_parameters_that_it_does_not_take_are_refused() -> None:
    """As ours refuse them."""
    with pytest.raises(DomainError, match=r'cab does not take the parameters .* it takes '):
        make_domain('cab', {'wheels': 4})


def test_reference_options_that_raise_are_refused() -> None:
    """By the domain's name."""
    domain = Taxi()
    domain.name = 'wide'
    with pytest.raises(DomainError, match='reference options of wide cannot be made: KeyError'):
        reference_options(domain)


class Endless(Taxi):
    """A game that goes on after its end."""

    def step(self, state: TaxiState, action: int, rng: np.random.Generator) -> Outcome[TaxiState]:
        """Stay where the task is over."""
        return Outcome(state, 0, True) if self.is_over(state) else super().step(state, action, rng)


class Narrow(Taxi):
    """A feature value without a name."""

    def __init__(self) -> None:
        """Leave out the last row's name."""
        super().__init__()
        row = Feature('taxi_row', 'the row', FeatureKind.ORDINAL, ('0', '1', '2', '3'))
        self.features = [row, *self.features[1:]]


class Dice(Taxi):
    """Chance that does not come from the generator."""

    thrown = 0

    def step(self, state: TaxiState, action: int, rng: np.random.Generator) -> Outcome[TaxiState]:
        """Take another action at every call."""
        Dice.thrown += 1
        return super().step(state, (action + Dice.thrown) % 6, rng)


class Lenient(Taxi):
    """Actions that are not there."""

    def step(self, state: TaxiState, action: int, rng: np.random.Generator) -> Outcome[TaxiState]:
        """Take the last for any."""
        return super().step(state, min(max(action, 0), 5), rng)


class Silent(Taxi):
    """No drawing."""

    def render(self, state: TaxiState, shown: Any = None) -> str:
        """Draw nothing."""
        return ''


class Reader(Taxi):
    """Any text is a state."""

    def decode(self, text: str) -> TaxiState:
        """Read what cannot be read as some state."""
        return super().decode(text) if text.startswith('taxi') else self.state_at(0)


class Jumpy(Taxi):
    """A rule that forgets its own steps."""

    def can_follow(self, state: TaxiState, action: int, successor: TaxiState) -> bool:
        """Deny everything."""
        return False


class Sudden(Taxi):
    """An end that is not announced."""

    def step(self, state: TaxiState, action: int, rng: np.random.Generator) -> Outcome[TaxiState]:
        """Say that the task is over."""
        outcome = super().step(state, action, rng)
        return Outcome(outcome.state, outcome.reward, True)


class Raising(Taxi):
    """A domain that fails."""

    def feature_values(self, state: TaxiState) -> Any:
        """Fail."""
        raise ZeroDivisionError('division by zero')


class Worthless(Taxi):
    """A reward that is no number."""

    def step(self, state: TaxiState, action: int, rng: np.random.Generator) -> Outcome[TaxiState]:
        """Give nan."""
        outcome = super().step(state, action, rng)
        return Outcome(outcome.state, float('nan'), outcome.terminated)


class TwoKeys(Taxi):
    """Two actions of one key."""

    def __init__(self) -> None:
        """Repeat an action under another name."""
        super().__init__()
        again = type(self.actions[0])('souther', 'down', 'again')
        self.actions = [*self.actions[:5], again]


@pytest.mark.parametrize(
    ('broken', 'text'),
    [
        (Endless, 'it takes a step after the end'),
        (Narrow, r'the feature taxi_row is 4 in .* out of its range 0\.\.3'),
        (Dice, 'not the same again with the same generator'),
        (Lenient, 'it takes the action -1, of 6'),
        (Silent, 'is drawn as nothing'),
        (Reader, 'it reads "no state at all" as a state'),
        (Jumpy, 'can_follow denies'),
        (Sudden, 'terminated and is_over disagree'),
        (Raising, 'it raised ZeroDivisionError: division by zero'),
        (Worthless, 'has the reward nan'),
        (TwoKeys, 'two actions have one key'),
    ],
)
def test_a_broken_promise_is_named(broken: Callable[[], Any], text: str) -> None:
    """With the name of the domain before it."""
    with pytest.raises(ContractError, match=f'^taxi breaks the contract of domains: .*{text}'):
        check_domain(broken(), 'taxi')


def test_a_domain_that_calls_itself_otherwise_is_refused() -> None:
    """A recording names the game by what it calls itself."""
    with pytest.raises(ContractError, match="it calls itself 'taxi'"):
        check_domain(Taxi(), 'cab')


def test_a_thing_that_is_no_domain_is_refused() -> None:
    """With all that is missing."""
    with pytest.raises(ContractError, match=r'it has no parameters, features, .*render'):
        check_domain(object(), 'thing')  # type: ignore[arg-type]


@pytest.mark.parametrize('domain', [Taxi(), Rooms()], ids=lambda domain: domain.name)
def test_a_good_domain_is_checked_in_the_blink_of_an_eye(domain: Any) -> None:
    """The best of three looks takes less than 50 ms."""
    times = []
    for _ in range(3):
        began = time.perf_counter()
        check_domain(domain, domain.name)
        times.append(time.perf_counter() - began)
    assert is_enumerable(domain)
    assert min(times) < 0.05
