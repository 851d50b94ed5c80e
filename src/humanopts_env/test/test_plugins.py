"""Domains of other packages, found by entry points: made, or refused by name with the reason."""

from pathlib import Path

from humanopts_env.domains.base import DomainError
from humanopts_env.domains.names import domain_names
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.domains.taxi import Taxi
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
        ('wide', r'wide breaks the contract of domains: .* shape \(10,\), not \(9,\)'),
        ('rooms', "'rooms' is the name of several domains, cab_plugin:Cab, .*Rooms: rename one"),
        ('bus', "unknown domain 'bus'; choose from .*cab.*gymnasium:ENV_ID"),
    ],
)
def test_what_cannot_be_played_is_refused_by_name(name: str, text: str) -> None:
    with pytest.raises(DomainError, match=text):
        make_domain(name)


def test_parameters_that_it_does_not_take_are_refused() -> None:
    with pytest.raises(DomainError, match=r'cab does not take the parameter .* it takes '):
        make_domain('cab', {'wheels': 4})


def test_reference_options_that_raise_are_refused() -> None:
    domain = Taxi()
    domain.name = 'wide'
    with pytest.raises(DomainError, match='reference options of wide cannot be made: KeyError'):
        reference_options(domain)
