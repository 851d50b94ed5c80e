"""The demo of Pac-Man: options taught, planned from samples, played, and judged in games."""

from typing import Any

from graph_support.command import DemoRun, run_demo
from graph_support.live import free_domain_id
import pytest

TAUGHT = [
    'go to the closest food',
    'avoid ghost',
    'go to the nearest power pellet',
    'eat the ghost',
]
pytestmark = [pytest.mark.whole, pytest.mark.timeout(300)]
STEPS = 20_000  # of games, that each plan is sampled from
PARTS = ('episode', 'planning', 'boards', 'games')  # of a report
SECONDS = {'table_seconds', 'model_seconds', 'sweep_seconds'}


@pytest.fixture(scope='module')
def demo(tmp_path_factory: pytest.TempPathFactory) -> DemoRun:
    """A demo of short games in a small maze, with criteria that are soon met."""
    with free_domain_id() as number:
        return run_demo(
            *(tmp_path_factory.mktemp('pacman'), number, '--domain', 'pacman'),
            *('--parameter', 'maze=yard', '--parameter', 'max_steps=60'),
            *('--success', 0, '--return-share', 0.99),
            *('--initiation-error', 0.2, '--termination-error', 0.2),
            *('--strategy', 'random', '--seed', 2, '--episodes', 2),
            *('--games', 0, '--game-steps', STEPS),
            seconds=300.0,
        )


def test_demo_teaches_four_options_and_judges_sampled_plans(demo: DemoRun) -> None:
    assert (demo.status, demo.errors) == (0, '')
    assert [option['option_name'] for option in demo.summary['options']] == TAUGHT
    assert all(option['learned'] for option in demo.summary['options'])
    played = demo.summary['execution']
    assert played['episodes'] == 2
    assert played['mean_return'] > 500
    human, primitive = demo.summary['planning']
    assert (human['action_set'], primitive['action_set']) == ('human', 'primitive')
    assert human['mean_return_low'] > primitive['mean_return_high']
    for plan in (human, primitive):
        assert (plan['episodes'], plan['game_steps']) == (1000, STEPS)
        assert plan['mean_return_low'] < plan['mean_return'] < plan['mean_return_high']
        assert list(plan['outcomes']) == ['cleared', 'lives left']


def test_the_bag_alone_gives_the_same_options_and_plans(demo: DemoRun) -> None:
    offline = demo.summary['offline']
    assert offline['options'] == demo.summary['options']
    for live, again in zip(demo.summary['planning'], offline['planning'], strict=True):
        assert {key for key in live if live[key] != again[key]} <= SECONDS


def test_the_report_shows_an_episode_and_no_board_of_values(demo: DemoRun) -> None:
    report = (demo.folder / 'report.html').read_text('utf-8')
    assert [part for part in PARTS if f'id="{part}"' in report] == ['episode', 'planning']
    assert demo.summary['games'] is None


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_whole_demo_compares_every_policy(
    tmp_path_factory: pytest.TempPathFactory, domain_id: int
) -> None:
    """With the default of 1,000 games; minutes."""
    folder = tmp_path_factory.mktemp('whole')
    demo = run_demo(folder, domain_id, '--domain', 'pacman', '--seed', 1, seconds=1800.0)
    assert (demo.status, demo.errors) == (0, '')
    rows: list[dict[str, Any]] = demo.summary['games']['rows']
    names = [
        'human, 3 options',
        'human, 5 options',
        'human, 5 options, interrupted, 4-fold steps',
        'primitive',
        'random choice, 5 options',
        'hand-written rule',
    ]
    assert [(row['setting'], row['name']) for row in rows] == [
        (f'ghosts={ghosts}', name) for ghosts in ('random', 'chase') for name in names
    ]
    assert {row['games'] for row in rows} == {1000}
    _, five, _, _, free, _ = rows[:6]
    human, primitive = demo.summary['planning']
    assert human['mean_return_low'] > primitive['mean_return_high']
    assert five['score'] == human['mean_return']  # the same plan in the same games
    assert five['score_low'] > free['score_high']
    report = (demo.folder / 'report.html').read_text('utf-8')
    assert f'{five["score"]:,.0f}' in report
