"""
The simulated rover stands still soon after any fault while an option or a person drives it.

Half a second is measured, so nothing runs beside it. ``make faults`` injects more of them.
"""

from pathlib import Path

from graph_support.faults import BY_OPTION, BY_PERSON, inject, inject_between_hosts, LATE
import pytest

FAULTS = [
    ('option server killed', BY_OPTION),
    ('option server stopped', BY_OPTION),
    ('terminal killed', BY_PERSON),
    ('terminal stopped', BY_OPTION),
    ('world killed', BY_OPTION),
    ('world stopped', BY_PERSON),
    ('scan stale', BY_OPTION),
    ('scan NaN', BY_PERSON),
    ('emergency topic', BY_PERSON),
    ('service stop', BY_OPTION),
]


@pytest.mark.slow
@pytest.mark.live
@pytest.mark.timeout(400)
def test_the_wheels_stand_still_soon_after_a_fault_and_nothing_recorded_is_lost(
    tmp_path: Path,
) -> None:
    measured, lost = inject(tmp_path / 'graph', FAULTS, seed=1)
    late = [each for each in measured if each.seconds >= LATE or not each.stayed]
    assert late == []
    assert lost == []


@pytest.mark.hosts
@pytest.mark.live
@pytest.mark.timeout(400)
def test_the_wheels_stand_still_soon_after_the_cable_to_their_driver_is_pulled(
    tmp_path: Path,
) -> None:
    assert inject_between_hosts(tmp_path, '--faults', '4') == 0
