"""A demo whose policies are planned to the ends that were shown."""

from pathlib import Path

from graph_support.command import run_demo, shown_in_bag
from humanopts_learner.demonstrations import GOAL, METHODS
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.cli import main
import pytest


@pytest.mark.slow  # the quick form, whose nodes die, is in test_node_deaths.py
def test_few_demonstrations_are_enough_and_the_bag_gives_the_same(
    tmp_path: Path, domain_id: int
) -> None:
    demo = run_demo(tmp_path, domain_id, '--learn', 'goal', '--seed', 1, '--episodes', 10)
    assert (demo.status, demo.errors) == (0, '')
    for option in demo.summary['options']:
        assert (option['method'], option['policy_accuracy']) == (GOAL, 1.0)
        assert option['n_demonstrations'] <= 6
    assert demo.summary['offline']['options'] == demo.summary['options']
    assert {shown.method for shown in shown_in_bag(open_bag(demo.bag))} == {GOAL}
    assert METHODS[GOAL] in (demo.folder / 'report.html').read_text('utf-8')


def test_where_states_cannot_be_listed_the_demo_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(['demo', '--domain', 'pacman', '--learn', 'goal']) == 2
    said = capsys.readouterr().err
    assert said.startswith('humanopts demo: the states of pacman cannot be listed')
    assert said.count('\n') == 1
