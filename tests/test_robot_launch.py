"""Commands with a robot, ros:FILE.yaml: what is launched, recorded and refused."""

from pathlib import Path
import signal
from typing import Any

from graph_support.live import Graph, open_graph
from graph_support.robot import Robot, WORLD_FILE
from humanopts_teach.bags.contents import read_description
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.cli import main
from humanopts_teach.command_line import LaunchOptions, PageOptions
from humanopts_teach.commands import CommandError
from humanopts_teach.commands.browser import teach_in_browser
from humanopts_teach.commands.session import default_folder, setup_from
from humanopts_teach.launching.processes import processes
from humanopts_teach.study.plan import PlanFileError, read_plan
import pytest


@pytest.fixture
def scout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A world file in the working directory, as it is named on the command line."""
    (tmp_path / 'scout.yaml').write_text(WORLD_FILE)
    monkeypatch.chdir(tmp_path)
    return 'ros:scout.yaml'


def test_the_node_world_takes_the_place_of_game(scout: str, tmp_path: Path) -> None:
    setup = setup_from(scout, LaunchOptions(), bag_name='up', step_period=0.15)
    specs = {spec.name: spec for spec in processes(setup)}
    assert 'game' not in specs
    assert specs['world'].parameters['world'] == str(tmp_path / 'scout.yaml')
    assert specs['world'].parameters['step_period'] == 0.0  # it would stand between actions
    assert f'{tmp_path}/scout.yaml' in specs['recorder'].parameters['attach']  # type: ignore[operator]
    assert default_folder(scout) == Path('runs/scout')
    game = {spec.name for spec in processes(setup_from('taxi', LaunchOptions(), bag_name='up'))}
    assert 'world' not in game


REFUSED: dict[str, tuple[list[Any], str]] = {
    'demo': (['demo'], 'scout.yaml is a robot; this operation needs a domain'),
    'teacher': (
        ['up', '--taught', 'dock'],
        'the simulated teacher needs a domain that can be simulated; scout cannot be simulated',
    ),
    'parameter': (['up', '--parameter', 'rows=3'], 'takes no parameters: change its'),
    'goal': (['up', '--learn', 'goal'], 'the states of scout cannot be listed'),
    'formula': (['up', '--derive', 'x - z'], "'z'"),
}


@pytest.mark.parametrize('case', REFUSED)
def test_what_needs_rules_or_does_not_fit_is_refused_with_one_line(
    case: str, scout: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (command, *options), sentence = REFUSED[case]
    assert main([command, scout, *options]) == 2
    out, err = capsys.readouterr()
    assert out == ''
    assert err.count('\n') == 1
    assert sentence in err


def test_a_mistake_in_the_file_is_one_line(scout: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path('scout.yaml').write_text(WORLD_FILE.replace('key: down', 'key: up'))
    assert main(['up', scout]) == 2
    err = capsys.readouterr().err
    assert err == (
        "humanopts up: scout.yaml: 'scout' cannot be used: two actions have one key: "
        'up, up, ., g, c, b\n'
    )


def test_one_person_at_a_time_teaches_a_robot_in_a_browser(scout: str) -> None:
    setup = setup_from(scout, LaunchOptions(), bag_name='up')
    with pytest.raises(CommandError, match='taught by one person at a time: --seats 1'):
        teach_in_browser(setup, PageOptions(browser=True, seats=2), '')


def test_a_study_finds_the_world_file_beside_its_plan(scout: str, tmp_path: Path) -> None:
    plan = tmp_path / 'plan.yaml'
    plan.write_text(
        f'study: s\nall: {{teach: 10}}\nconditions:\n- {{name: one, domain: {scout}}}\n'
    )
    try:
        (condition,) = read_plan(plan).conditions
    except PlanFileError as error:
        pytest.fail(str(error))
    assert condition.domain == f'ros:{tmp_path}/scout.yaml'


def test_the_bag_has_the_world_file_and_on_request_the_topics_of_the_robot(
    scout: str, shared: Graph, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Robot(shared)
    said = tmp_path / 'said.txt'
    words = ['up', scout, '--only', 'recorder,world', '--out', 'out', '--record', '/odom']
    with said.open('wb') as output:
        up = shared.run(['-m', 'humanopts_teach', *words], 'up', stdout=output)
    shared.until(lambda: 'Ctrl-C' in said.read_text(), 'it to be ready', 60.0)
    assert up.kill(signal.SIGINT) == 0, up.said()
    (path,) = (tmp_path / 'out/bags').iterdir()
    bag = open_bag(path)
    assert (bag.facts['domain'], bag.facts['world_file']) == ('ros:scout.yaml', 'scout.yaml')
    assert [file.data.decode() for file in bag.attached()] == [WORLD_FILE]
    topics = {*bag.topics}
    assert {'/odom', '/action_progress', '/game_state'} <= topics
    assert '/scan' not in topics
    assert read_description(bag).name == 'scout'
    assert main(['bag', 'eval', str(path)]) == 2
    assert 'scout is a robot; this command needs' in capsys.readouterr().err


def test_a_launch_says_what_the_world_waits_for(scout: str, tmp_path: Path) -> None:
    said = tmp_path / 'said.txt'
    words = ['up', scout, '--only', 'world', '--no-record', '--out', 'out']
    with open_graph(tmp_path / 'graph') as graph:
        with said.open('wb') as output:
            up = graph.run(['-m', 'humanopts_teach', *words], 'up', stdout=output)
        what = '/world waits for a message on /odom (nav_msgs/msg/Odometry): nothing publishes it'
        graph.until(lambda: f'humanopts: {what}\n' in up.said(), 'what it waits for', 60.0)
        Robot(graph)
        graph.until(lambda: 'Ctrl-C' in said.read_text(), 'it to be ready', 60.0)
        assert up.kill(signal.SIGINT) == 0, up.said()
