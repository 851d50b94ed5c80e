"""The exam: how many runs it has, what its verdicts say, and that nothing is learned from them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import NAMESPACE_OID, uuid5

from humanopts_env.domains.taxi import Taxi
from humanopts_learner.demonstrations import Demonstration, Kind, version_of
from humanopts_learner.intervals import Interval
from humanopts_learner.option_trainer import OptionTrainer
from humanopts_learner.options.exam import exam_length, with_verdicts
from humanopts_learner.options.files import load_options
from humanopts_learner.options.judge import judge, Thresholds
from humanopts_learner.summary import Criterion, OptionSummary
import numpy as np
import pytest

TAXI, SEED = Taxi(), 2
Judged = Callable[..., Demonstration]


@pytest.fixture
def judged(fetching: list[Demonstration]) -> Judged:
    """Return a run of the option that is learned from demonstrations, as judged by the person."""

    def make(
        shown: list[Demonstration], number: int, *, right: bool = True, exam: bool = True
    ) -> Demonstration:
        return replace(
            fetching[20 + number],
            kind=Kind.JUDGED,
            uuid=str(uuid5(NAMESPACE_OID, f'{len(shown)} {number} {right} {exam}')),
            number=number,
            right=right,
            exam=exam,
            option_version=version_of(shown),
        )

    return make


def test_an_exam_after_a_failed_one_is_longer_and_gives_the_same_limit_at_a_higher_level() -> None:
    assert [exam_length(5, failed) for failed in range(5)] == [5, 9, 11, 12, 13]
    assert exam_length(0, 3) == 0
    limit = Interval.of_share(np.ones(5, dtype=bool)).low
    assert f'{limit:.0%}' == '57%'
    for failed in (1, 2, 3):
        level, runs = 1 - 0.05 / (failed + 1) ** 2, exam_length(5, failed)
        lows = [Interval.of_share(np.ones(n, dtype=bool), level).low for n in (runs - 1, runs)]
        assert lows[0] < limit <= lows[1]


def test_an_option_at_the_limit_rarely_passes_any_of_its_exams() -> None:
    share = Interval.of_share(np.ones(5, dtype=bool)).low
    assert share**5 == pytest.approx(0.058, abs=0.001)
    fails = [1 - share ** exam_length(5, failed) for failed in range(50)]
    assert 1 - np.prod(fails) < 0.07


def test_verdicts_count_for_the_version_that_ran(
    fetching: list[Demonstration], judged: Judged
) -> None:
    first, second = fetching[:5], fetching[:6]
    criteria = (Criterion('return', 0.0, 1.0, met=True),)
    before = OptionSummary('go', 'p1', criteria=criteria)

    def summary(*demos: Demonstration) -> OptionSummary:
        return with_verdicts(before, demos, 2)

    none = summary(*first)
    assert (none.exam_runs, none.exam_needed, none.learned) == (0, 2, False)
    assert none.status == 'not learned: the exam is incomplete (0 of 2 runs)'
    runs = judged(first, 1), judged(first, 2), judged(first, 3, exam=False)
    passed = summary(*first, *runs)
    assert (passed.exam_right, passed.exam_runs, passed.n_questions) == (2, 2, 1)
    assert passed.learned
    failed = summary(*first, runs[0], judged(first, 2, right=False))
    assert (failed.exam_right, failed.exam_runs, failed.learned) == (1, 2, False)
    assert (failed.exams_failed, failed.exam_needed) == (0, 2)
    again = summary(*second, runs[0], judged(first, 2, right=False))  # of another version
    assert (again.exam_runs, again.exams_failed) == (0, 1)
    assert again.exam_needed == exam_length(2, 1) == 4
    assert not summary(*second, *runs).learned


@pytest.mark.parametrize('exam', [True, False])
def test_nothing_is_learned_from_a_judged_run_and_it_is_known_when_opened_again(
    fetching: list[Demonstration], judged: Judged, tmp_path: Path, exam: bool
) -> None:
    shown = fetching[:5]
    trainer = OptionTrainer(tmp_path, TAXI, Thresholds(), SEED)
    for demo in shown:
        trainer.take(demo)
    (before,) = trainer.options()
    files = load_options(tmp_path)
    run = judged(shown, 1, exam=exam)
    assert trainer.take(run)
    (after,) = trainer.options()
    assert (after.file, load_options(tmp_path)) == (before.file, files)
    assert (after.summary.exam_runs, after.summary.n_questions) == (exam, not exam)
    assert after.summary.n_demonstrations == before.summary.n_demonstrations
    assert after.summary == judge([*shown, run], TAXI, Thresholds(), SEED)  # as from a bag
    assert OptionTrainer(tmp_path, TAXI, Thresholds(), SEED).options() == [after]
    assert not trainer.take(run)
    assert trainer.take(replace(run, withdrawn=True))
    assert trainer.options() == [before]


def test_a_run_judged_before_any_demonstration_or_after_the_last_is_kept_but_is_no_option(
    fetching: list[Demonstration], judged: Judged, tmp_path: Path
) -> None:
    trainer: Any = OptionTrainer(tmp_path, TAXI, Thresholds(), SEED)
    run = judged(fetching[:1], 1)
    trainer.take(run)
    assert trainer.options() == []
    trainer.take(fetching[0])
    assert trainer.options()[0].summary.exam_runs == 1
    trainer.take(replace(fetching[0], withdrawn=True))
    assert trainer.options() == OptionTrainer(tmp_path, TAXI, Thresholds(), SEED).options() == []
