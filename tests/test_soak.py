"""A lesson goes on among random faults: the short form of ``make soak``."""

import math
from pathlib import Path

from graph_support.soak import run
import pytest

KINDS = ('kill', 'stop', 'terminal', 'clock', 'files', 'messages')
SEED = 1


@pytest.mark.timeout(300)
def test_nothing_is_lost_or_done_twice_among_random_faults(
    tmp_path: Path,
    domain_id: int,
    monkeypatch: pytest.MonkeyPatch,
    short_lease: None,
) -> None:
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain_id))
    outcome, report = run(*(tmp_path, math.inf, SEED, KINDS, len(KINDS)), messages=100, settle=0.1)
    print(report)
    assert outcome.violations == []
    assert len(outcome.recoveries) == len(KINDS)
    assert outcome.messages == 100
