"""The page docs/reference/graph.md and the live graph say the same."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
import os
from pathlib import Path
import pty
import re
import select
import signal
from typing import Any

from graph_support.live import Graph, LEARNER, LESSON, module_of, OPTION_SERVER, PLANNER, TEACHER
from humanopts_interfaces.msg import NodeStatus, RecorderStatus
from humanopts_ros import qos
from humanopts_teach.launching.processes import processes, Setup
import pytest
from rclpy.action import (
    get_action_client_names_and_types_by_node,
    get_action_names_and_types,
    get_action_server_names_and_types_by_node,
)
from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy

PAGE = Path(__file__).parents[1] / 'docs' / 'reference' / 'graph.md'
# What rclpy adds to every node, whoever writes it.
RCLPY_TOPICS = {'rosout', 'parameter_events'}
RCLPY_SERVICES = re.compile(
    r'/((describe|get|list|set)_parameters(_atomically)?|get_parameter_types)$'
    r'|/get_type_description$|/_action/'
)
RCLPY_PARAMETERS = {'use_sim_time', 'start_type_description_service'}
PROFILES = {
    'latched': (qos.LATCHED, DurabilityPolicy.TRANSIENT_LOCAL),
    'stream': (qos.STREAM, DurabilityPolicy.VOLATILE),
}
TEST = 'person'  # the test's own node
# At the end the silent teacher's question is answered, and the teacher is gone: a warning of rmw.
pytestmark = pytest.mark.filterwarnings('ignore:failed to send response')
HOSTED = {module_of(node): node for node in (LEARNER, LESSON, OPTION_SERVER, PLANNER, TEACHER)}


@dataclass(frozen=True)
class Entry:
    """One topic, service or action, and who is at its ends."""

    type: str
    given: frozenset[str]  # who publishes or serves it
    taken: frozenset[str]  # who reads or calls it


def rows(heading: str) -> list[list[str]]:
    """Return the cells of the table below a heading of the page, without its head."""
    section = PAGE.read_text('utf-8').split(f'\n## {heading}\n')[1].split('\n## ')[0]
    lines = [line for line in section.splitlines() if line.startswith('|')]
    return [[cell.strip().strip('`') for cell in line.strip('|').split('|')] for line in lines[2:]]


def names(cell: str) -> frozenset[str]:
    everybody = frozenset(row[0] for row in rows('Nodes'))
    return everybody if cell == 'all' else frozenset(filter(None, re.split(', *', cell)))


def documented(heading: str) -> dict[str, Entry]:
    return {r[0]: Entry(r[1], names(r[-2]), names(r[-1])) for r in rows(heading)}


def told(entries: dict[str, Entry]) -> list[str]:
    """Return a line for each entry, so that a difference can be read."""
    return sorted(
        f'{name} {entry.type} from {sorted(entry.given)} to {sorted(entry.taken)}'
        for name, entry in entries.items()
    )


@pytest.fixture(scope='module')
def full(shared: Graph) -> Iterator[Graph]:
    """``humanopts teach`` in a terminal, with game and recorder; the other nodes run here."""
    master, slave = pty.openpty()
    recorder = shared.listen(RecorderStatus, 'recorder_status', qos.CURRENT)
    shared.watch('/')
    out = shared.folder / 'out'
    words = ['teach', 'taxi', '--only', 'recorder,game', '--out', str(out)]
    teach = shared.run(
        ['-m', 'humanopts_teach', *words],
        'teach',
        stdin=slave,
        stdout=slave,
        start_new_session=True,
    )
    teach.expected = {130}

    def ready(*nodes: str) -> None:
        def look() -> bool:
            if select.select([master], [], [], 0)[0]:
                os.read(master, 65536)
            assert teach.process.poll() is None, teach.said()
            return all(shared.state(f'/{node}') == NodeStatus.STATE_READY for node in nodes)

        shared.until(look, f'{nodes} to be ready', 60.0)

    setup = Setup('taxi', out, taught=('go to passenger',), keyboard=True)
    hosted = {spec.name: spec for spec in processes(setup) if spec.module in HOSTED}
    teacher = hosted.pop('simulated_teacher')  # the last: it unsubscribes when all is taught
    for spec in hosted.values():
        shared.start(HOSTED[spec.module], **spec.parameters)
    ready(*(names('all') - {teacher.name}))
    shared.start(TEACHER, **teacher.parameters)
    ready(teacher.name)
    with shared.silent('/simulated_teacher'):
        shared.until(lambda: recorder and recorder[-1].complete, 'the recorder')
        shared.until(lambda: len(nodes_of(shared)) == len(names('all')), 'the names of all nodes')
        yield shared
    teach.kill(signal.SIGTERM)
    os.close(master)
    os.close(slave)


def nodes_of(graph: Graph) -> list[str]:
    return sorted({name for name in graph.node.get_node_names() if name != TEST})


def ends(infos: list[Any]) -> frozenset[str]:
    return frozenset(info.node_name for info in infos) - {TEST}


def topics(graph: Graph) -> dict[str, str]:
    """Return the names and types of all topics that carry messages and are not rclpy's own."""
    found = {}
    for topic, types in graph.node.get_topic_names_and_types():
        if topic.strip('/') not in RCLPY_TOPICS and not topic.startswith(('/_game/', '/_node/')):
            (found[topic.strip('/')],) = types
    return found


def visible(name: str) -> bool:
    return not any(part.startswith('_') for part in name.split('/'))


def by_node(graph: Graph, method: str) -> dict[str, set[str]]:
    """Return which nodes have a service, as servers or as clients."""
    found: dict[str, set[str]] = {}
    for node in nodes_of(graph):
        for name, _ in getattr(graph.node, method)(node, '/'):
            found.setdefault(name.strip('/'), set()).add(node)
    return found


def test_every_node_is_on_the_page(full: Graph) -> None:
    assert nodes_of(full) == sorted(row[0] for row in rows('Nodes'))


def live_topics(graph: Graph) -> dict[str, Entry]:
    return {
        name: Entry(
            kind,
            ends(graph.node.get_publishers_info_by_topic(f'/{name}')),
            ends(graph.node.get_subscriptions_info_by_topic(f'/{name}')) - {'recorder'},
        )
        for name, kind in topics(graph).items()
        if visible(name)
    }


def test_every_topic_is_on_the_page_with_its_type_and_both_ends(full: Graph) -> None:
    """Ends are found one after another."""
    page = told(documented('Topics'))
    with suppress(AssertionError):  # what is missing is told below
        full.until(lambda: told(live_topics(full)) == page, 'all ends')
    assert told(live_topics(full)) == page


def test_every_topic_has_the_qos_that_the_page_names(full: Graph) -> None:
    for name, _, profile, *_ in rows('Topics'):
        for info in full.node.get_publishers_info_by_topic(f'/{name}'):
            offered = info.qos_profile
            assert offered.durability == PROFILES[profile][1], name
            assert offered.reliability == ReliabilityPolicy.RELIABLE, name
    history = {row[0]: row[2] for row in profiles()}
    assert history == {'latched': f'last {qos.LATCHED.depth}', 'stream': 'all'}
    assert qos.STREAM.history == HistoryPolicy.KEEP_ALL
    assert {row[0]: row[1] for row in profiles()} == {
        name: durability.name.lower().replace('_', ' ')
        for name, (_, durability) in PROFILES.items()
    }
    assert all(profile.durability == durability for profile, durability in PROFILES.values())


def profiles() -> list[list[str]]:
    lines = [r for r in PAGE.read_text('utf-8').split('\n## ')[0].splitlines() if r[:1] == '|']
    return [[cell.strip() for cell in line.strip('|').split('|')] for line in lines[2:]]


def test_every_service_is_on_the_page_with_its_type_and_both_ends(full: Graph) -> None:
    expected = told(documented('Services'))
    with suppress(AssertionError):  # the endpoints of a node become known after its name
        full.until(lambda: told(services(full)) == expected, 'every service')
    assert told(services(full)) == expected


def services(graph: Graph) -> dict[str, Entry]:
    servers = by_node(graph, 'get_service_names_and_types_by_node')
    callers = by_node(graph, 'get_client_names_and_types_by_node')
    return {
        name.strip('/'): Entry(
            types[0],
            frozenset(servers.get(name.strip('/'), ())),
            frozenset(callers.get(name.strip('/'), ())),
        )
        for name, types in graph.node.get_service_names_and_types()
        if not RCLPY_SERVICES.search(name)
    }


def test_every_action_is_on_the_page_with_its_type_and_both_ends(full: Graph) -> None:
    live = {}
    for name, (kind,) in get_action_names_and_types(full.node):
        given, taken = (
            frozenset(n for n in nodes_of(full) if name in dict(ask(full.node, n, '/')))
            for ask in (
                get_action_server_names_and_types_by_node,
                get_action_client_names_and_types_by_node,
            )
        )
        # Who reads the feedback passes for a client, as the recorder does.
        live[name.strip('/')] = Entry(kind, given, taken - {'recorder'})
    assert told(live) == told(documented('Actions'))


def test_requests_answers_and_progress_of_all_are_on_the_graph(full: Graph) -> None:
    hidden = {
        name: ends(full.node.get_publishers_info_by_topic(f'/{name}'))
        for name in topics(full)
        if not visible(name)
    }
    services, actions = documented('Services'), documented('Actions')
    expected = {f'{n}/_service_event': e.given | e.taken for n, e in services.items()}
    for part in ('feedback', 'status'):
        expected |= {f'{n}/_action/{part}': e.given for n, e in actions.items()}
    assert hidden == expected


def test_the_recorder_reads_every_topic(full: Graph) -> None:
    read = {
        name
        for name in topics(full)
        if 'recorder' in ends(full.node.get_subscriptions_info_by_topic(f'/{name}'))
    }
    assert read == set(topics(full))


def test_every_parameter_of_a_node_is_on_the_page(full: Graph) -> None:
    for name in ('learner', 'lesson', 'option_server', 'planner', 'simulated_teacher'):
        live = {*full.node_called(f'/{name}').get_parameters_by_prefix('')} - RCLPY_PARAMETERS
        page = {r[1] for r in rows('Parameters') if {'all', name} & {*r[0].split(', ')}}
        assert live == page, name
