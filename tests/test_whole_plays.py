"""Options are learned from segments of whole plays, and are the actions of a learner."""

import numpy as np
import pytest

from experiments import whole_plays
from experiments.whole_plays import CUT, cut_plays, learn_over_options

pytestmark = pytest.mark.heavy


@pytest.mark.parametrize('domain', CUT)
def test_segments_teach_as_well_as_separate_demonstrations(
    domain: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(whole_plays, 'STARTS', 30)
    rows = [
        row
        for seed in (1, 2, 3)
        for row in cut_plays({'domain': domain, 'plays': 3, 'seed': seed})
    ]
    means = {each: np.mean([row[each] for row in rows]) for each in ('segments', 'separate')}
    assert means['segments'] > means['separate'] - 0.1
    assert {row['plays'] for row in rows} == {3}


def test_over_taught_options_doorkey_is_learned_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(whole_plays, 'EPISODES', 5)
    monkeypatch.setattr(whole_plays, 'LAYOUTS', 5)
    options, primitive = learn_over_options({'seed': 1})
    assert options['solved'] >= 0.8 > 0.2 >= primitive['solved']
    assert options['steps'] < 100 < primitive['steps']
