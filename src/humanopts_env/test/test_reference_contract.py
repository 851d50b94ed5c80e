"""The reference options of every domain of ours keep their contract."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.reference import ReferenceOption
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_env.reference_contract import ReferenceContract
import numpy as np
import pytest

pytestmark = pytest.mark.heavy

PICKUP = reference_options(Taxi())['go to passenger and pickup']
ONLY_SOUTH = np.arange(6) == 0


OURS: dict[str, Any] = {
    'Taxi': Taxi,
    'LargerTaxi': partial(Taxi, 14, 9),
    'RoomsWithTheGoalInARoom': partial(Rooms, 'G2'),
    'PacMan': PacMan,
    'ChasedPacMan': partial(PacMan, 'yard', ghosts='chase'),
    'PacManWithThePapersFeatures': partial(PacMan, 'yard', features='paper'),
}
for _name, _make in OURS.items():
    globals()[f'Test{_name}'] = type(
        f'Test{_name}', (ReferenceContract,), {'make': staticmethod(_make)}
    )


@pytest.mark.parametrize(
    ('test', 'change'),
    [
        ('test_a_person_can_be_told_what_each_means', {'definition': ''}),
        ('test_a_person_can_be_told_what_each_means', {'features': PICKUP.features[::-1]}),
        ('test_a_person_can_be_told_what_each_means', {'name': 'Pickup'}),
        ('test_each_can_start_somewhere', {'initiation': np.zeros(500, dtype=np.bool_)}),
        ('test_it_acts_where_it_can_start', {'optimal': np.zeros((500, 6), dtype=np.bool_)}),
        ('test_it_acts_where_it_can_start', {'termination': np.zeros(500, dtype=np.bool_)}),
        ('test_its_features_tell_where', {'features': ('taxi_row',)}),
        ('test_every_run_comes_to_its_end', {'optimal': PICKUP.initiation[:, None] & ONLY_SOUTH}),
    ],
)
def test_what_breaks_the_contract_is_found(test: str, change: dict[str, Any]) -> None:
    """By the test that is meant to."""
    broken = replace(PICKUP, **change)

    class Suite(ReferenceContract):
        def make(self) -> Domain[Any]:
            return Taxi()

        def options(self, domain: Domain[Any]) -> Mapping[str, ReferenceOption]:
            return {broken.name: broken}

    (name,) = [name for name in dir(Suite) if name.startswith(test)]
    with pytest.raises(AssertionError):
        getattr(Suite(), name)()
