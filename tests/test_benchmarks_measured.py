"""What the benchmarks report is right; how fast anything is, is not asserted."""

from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_learner.demonstrations import check_demonstration
import pytest

from benchmarks.games import BATCH, game_rows
from benchmarks.learning import demonstrations, learning_rows
from benchmarks.measured import compare, in_turns
from benchmarks.taxi_case import OPTIONS


def test_ratio_is_of_the_medians() -> None:
    row = compare('a', [0.5, 9.0, 0.1], 'b', [0.25, 0.25])
    assert (row.seconds, row.samples, row.per_second) == (0.5, 3, 2.0)
    assert (row.yardstick_seconds, row.yardstick_samples, row.ratio) == (0.25, 2, 2.0)
    assert row.to_dict()['ratio'] == 2.0


@pytest.mark.parametrize(('count', 'slow'), [(99, None), (101, 0.99)])
def test_percentile_is_told_where_there_are_samples_for_it(count: int, slow: float | None) -> None:
    row = compare('a', [n / 100 for n in range(count)], 'b', [1.0])
    assert (row.slow_seconds, row.yardstick_slow_seconds) == (slow, None)


def test_works_take_turns_and_the_first_turn_is_not_counted() -> None:
    calls: list[str] = []

    def work(name: str) -> float:
        calls.append(name)
        return float(len(calls))

    assert in_turns([lambda: work('a'), lambda: work('b')], 2) == [[3.0, 5.0], [4.0, 6.0]]
    assert ''.join(calls) == 'ababab'


def test_what_is_learned_from_are_whole_demonstrations_of_the_option() -> None:
    domain = Taxi()
    reference = reference_options(domain)[OPTIONS[0]]
    shown = demonstrations(domain, reference, 12)
    assert [demo.number for demo in shown] == list(range(1, 13))
    assert len({demo.uuid for demo in shown}) == 12
    for demo in shown:
        check_demonstration(demo, domain)
        assert reference.can_start(domain.decode(demo.states[0]))
        ends = [reference.ends(domain.decode(text)) for text in demo.states]
        assert ends == [False] * len(demo.actions) + [True]


def test_learning_has_rows_for_trees_and_criteria_beside_one_tree() -> None:
    heard: list[float] = []
    rows = learning_rows((2, 3), 1, lambda share, text: heard.append(share))
    assert [row.what for row in rows] == [
        f'after {count} demonstrations: {what}'
        for count in (2, 3)
        for what in ('three trees fitted', 'the criteria judged')
    ]
    domain = Taxi()
    shown = demonstrations(domain, reference_options(domain)[OPTIONS[0]], 3)
    steps = sum(len(demo.actions) for demo in shown)
    assert rows[-1].facts == {'demonstrations': 3, 'rows': steps}
    assert heard == [0.0, 0.5]


def test_games_are_counted_in_steps_of_single_games() -> None:
    rows = game_rows(batch_steps=1, single_steps=20, repeats=1)
    assert [row.facts['steps'] for row in rows] == [BATCH] * 4
    assert [row.facts['yardstick_steps'] for row in rows] == [20] * 4
    names = {PacMan().name, Taxi().name}
    assert {row.what.partition(':')[0].lower().replace('-', '') for row in rows} == names
    assert all(row.seconds > 0 and row.yardstick_seconds > 0 for row in rows)
