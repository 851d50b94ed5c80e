"""Whole launches in one ROS_DOMAIN_ID, beside a robot: each bag holds its own people alone."""

from collections.abc import Iterator
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
from typing import Any

from graph_support.command import Command
from humanopts_env.domains.registry import make_domain
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.cli import main
import pytest
from teach_support.page_client import PageClient

pytestmark = [pytest.mark.whole, pytest.mark.timeout(400)]  # on a busy machine
TAUGHT = {
    'of-root': 'go to passenger and pickup',
    'of-b': 'north-west room to north doorway',
    'anna': 'go west',
    'ben': 'go west',
}
NODES = 'recorder,game,lesson,learner,option_server,simulated_teacher'
PART = ('--only', NODES)  # what a lesson needs
QUESTIONS = len(make_domain('taxi').features)
ROBOT = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node('driver')
topics = [node.create_publisher(String, name, 10) for name in ('odom', 'scan', 'b/scan', 'tf')]
node.create_timer(0.02, lambda: [topic.publish(String(data='x')) for topic in topics])
node.create_timer(0.5, lambda: node.get_logger().info('driving'))
rclpy.spin(node)
"""


@pytest.fixture
def commands(tmp_path: Path, domain_id: int) -> Iterator[dict[str, Command]]:
    """Two launches and a browser server, each with its output in a folder of its own."""
    started: dict[str, Command] = {}
    for name, arguments in (
        ('taxi', ('up', 'taxi', *PART, '--taught', TAUGHT['of-root'])),
        (
            'rooms',
            (
                'up',
                'rooms',
                *PART,
                '--namespace',
                '/b',
                '--record',
                '/scan',
                '--taught',
                TAUGHT['of-b'],
            ),
        ),
        ('pages', ('teach', 'taxi', '--browser', '--port', 0, '--learn', 'goal')),
    ):
        folder = tmp_path / name
        folder.mkdir()
        out = ('--out', folder / 'data')
        started[name] = Command((*arguments, *out), folder, domain_id)
    yield started
    for command in started.values():
        command.close()


@pytest.fixture
def robot(domain_id: int) -> Iterator[None]:
    """A node that is none of ours, on the graph."""
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain_id)}
    with subprocess.Popen([sys.executable, '-c', ROBOT], env=environment) as process:
        yield
        process.kill()


def teach(page: PageClient) -> None:
    """Name an option on a page, and show it once."""
    page.until('panel', 'What next?')
    page.press('1')
    page.until('panel', 'What is the option called?')
    page.press('ctrl-u', *'go west', 'enter')
    for number in range(1, QUESTIONS + 1):
        page.until('panel', f'question {number} of {QUESTIONS}')
        page.press('y' if number < 3 else 'n')
    page.until('panel', 'Enter shows start 1.')
    page.press('enter')
    page.until('panel', 'next: start 1')
    page.press('left')
    page.until('panel', 'start 1, step 1')
    page.press('enter')
    page.until('panel', '(1 shown')


def told(capsys: pytest.CaptureFixture[str], *arguments: Any) -> Any:
    """Return what a command prints as JSON."""
    capsys.readouterr()
    assert main(['bag', *map(str, arguments), '--json']) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


@pytest.mark.usefixtures('robot')
def test_each_bag_is_whole_and_holds_the_people_of_its_own_graph(
    commands: dict[str, Command], capsys: pytest.CaptureFixture[str]
) -> None:
    pages = commands['pages']
    pages.until(lambda: 'Open ' in pages.output, 'the address')
    found = re.search(r'Open (\S+)(/\S+) in a browser', pages.output)
    assert found is not None
    shown = [PageClient(found.group(1), f'{found.group(2)}/{who}') for who in ('anna', 'ben')]
    for page in shown:
        teach(page)
    for name in ('taxi', 'rooms'):
        data = commands[name].folder / 'data'
        commands[name].until(lambda d=data: list(d.glob('options/*/*.json')), 'a learned option')
    for command in commands.values():
        command.send(signal.SIGINT)
    for command in commands.values():
        assert command.ended(60) == 0, command.errors
    bags = {
        'of-root': commands['taxi'].folder / 'data',
        'of-b': commands['rooms'].folder / 'data',
        'anna': pages.folder / 'data' / 'anna',
        'ben': pages.folder / 'data' / 'ben',
    }
    for who, data in bags.items():
        (bag,) = (data / 'bags').iterdir()
        assert told(capsys, 'check', bag)['whole']
        info = told(capsys, 'info', bag)
        code = who if who in ('anna', 'ben') else 'p1'
        assert (info['participants'], info['omitted']) == ([code], [])
        (option,) = told(capsys, 'eval', bag)['options']
        assert (option['participant'], option['option_name']) == (code, TAUGHT[who])
        opened = open_bag(bag)
        names = {topic for topic in opened.topics if topic not in ('/rosout', '/parameter_events')}
        prefix = opened.facts['namespace'].rstrip('/') + '/'
        assert ('/scan' in names) is (who == 'of-b')  # it was asked for there
        names.discard('/scan')
        assert all(name.startswith(prefix) for name in names)
        assert not [name for name in names if name.rpartition('/')[2] in ('odom', 'scan', 'tf')]
        lines = [recorded.message for recorded in opened.messages(['/rosout'])]
        assert 'driving' not in [line.msg for line in lines]
