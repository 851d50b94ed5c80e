"""Fixtures of the live graph."""

from collections.abc import Iterator
import gc
import os
from pathlib import Path

from graph_support.command import DemoRun, EPISODES, shared_demo
from graph_support.live import free_domain_id, Graph, open_graph
from humanopts_ros.middleware import PROFILES
from humanopts_ros.workarounds import prepare_discovery
import pytest
from teach_support.bags import write_lesson

os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'  # a misspelt field is an error, here and in the nodes
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
prepare_discovery()
if late := os.environ.get('STRESS_PROFILE'):  # of make test-stress
    os.environ[PROFILES[0]] = late
os.environ['TERM'] = 'xterm-256color'  # what the pseudo-terminals of the tests understand


HERE = Path(__file__).parent
LEASE = 5  # s after which the middleware knows that a process was killed; usual are 20
LIVE = {'demo', 'domain_id', 'live', 'shared'}  # fixtures of tests that need the graph
LONGEST = (  # files, the longest first
    'test_demo_pacman.py',
    'test_node_deaths.py',
    'test_study.py',
    'test_launches_side_by_side.py',
    'test_soak.py',
    'test_cli.py',
    'test_demo.py',
    'test_browser.py',
    'test_keyboard_teleop.py',
    'test_launcher.py',
    'test_recorder.py',
    'test_side_by_side.py',
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """
    Mark the tests that need the graph, and put the files of all others before theirs.

    The longest of their files come first, so that no process is left with one at the end.
    """
    files = set()
    for item in items:
        mine = HERE in item.path.parents  # other tests have fixtures of the same names
        if mine and not LIVE.isdisjoint(getattr(item, 'fixturenames', ())):
            item.add_marker('live')
            files.add(item.path)

    def place(item: pytest.Item) -> tuple[bool, int]:
        name = item.path.name
        return item.path in files, LONGEST.index(name) if name in LONGEST else len(LONGEST)

    items.sort(key=place)


@pytest.fixture(scope='module', autouse=True)
def settled() -> None:
    """Leave what earlier modules made out of each search for garbage: mypy makes millions."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    """A graph of one test."""
    with open_graph(tmp_path_factory.mktemp('graph')) as graph:
        yield graph


@pytest.fixture(scope='module')
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    """A graph that the tests of a module share."""
    with open_graph(tmp_path_factory.mktemp('graph')) as graph:
        yield graph


@pytest.fixture
def domain_id() -> Iterator[int]:
    """A ROS_DOMAIN_ID that no other test uses meanwhile."""
    with free_domain_id() as number:
        yield number


@pytest.fixture
def short_lease(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let processes that are started from now on notice sooner which of them were killed."""
    profile = Path(os.environ[PROFILES[-1]]).read_text('utf-8')
    mark = '<leaseAnnouncement>'
    assert mark in profile
    lease = f'<leaseDuration><sec>{LEASE}</sec></leaseDuration>'
    (tmp_path / 'profile.xml').write_text(profile.replace(mark, lease + mark), 'utf-8')
    for name in os.environ.keys() & PROFILES:
        monkeypatch.setenv(name, str(tmp_path / 'profile.xml'))


@pytest.fixture(scope='session')
def demo(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> DemoRun:
    """A whole demo, which all tests of what it leaves share, in whichever process they run."""
    own = tmp_path_factory.getbasetemp()
    everybodys = own if worker_id == 'master' else own.parent
    arguments = ('--domain', 'taxi', '--seed', 1, '--episodes', EPISODES)
    return shared_demo(everybodys / 'demo', *arguments)


@pytest.fixture(scope='session')
def lesson_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of a short lesson on Taxi."""
    return write_lesson(tmp_path_factory.mktemp('lesson') / 'bag')
