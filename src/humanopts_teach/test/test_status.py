"""What status makes of a graph, and when a node that ended is started again."""

from dataclasses import replace
import json

from humanopts_teach.launching.restarts import NodeExit, RestartPolicy, STEADY
from humanopts_teach.launching.status import (
    GraphReport,
    LITTLE_DISK,
    NodeReport,
    RecorderReport,
)
import pytest

GAME = NodeReport('game', 'ready', 0.004, pid=4711, memory=93_000_000, threads=13)
CONDUCTOR = NodeReport('conductor', 'ready', served=False)
BAG = RecorderReport(
    '/lab/bag', 120, 5_000, 0.01, 0, complete=True, behind=False, stopped=False, text='',
    rate=20.0, disk_left=10**10,
)  # fmt: skip
GRAPH = GraphReport(3, '/room', [CONDUCTOR, GAME], BAG, 'taxi', 2, 14, 12.34)


def test_a_graph_in_which_all_is_well() -> None:
    assert (GRAPH.status, GRAPH.faults) == (0, [])
    lines = GRAPH.to_text().splitlines()
    assert lines[2].split() == ['game', 'ready', '4', 'ms', '0', '4711', '93.0', 'MB', '13']
    assert lines[4] == 'taxi: episode 2, step 14, 12.3 steps/s; control: nobody'
    assert lines[5] == (
        '/lab/bag: 120 messages (20/s), 5.0 kB, lag 0.010 s, 0 missing, 10.0 GB left on the disk'
    )
    assert lines[-1] == 'all is well'
    assert json.loads(json.dumps(GRAPH.to_dict()))['nodes'][1]['answer'] == 0.004


@pytest.mark.parametrize(
    ('changes', 'fault'),
    [
        ({'answer': None}, 'game does not answer'),
        ({'stopped': True}, 'game is stopped; kill -CONT 4711 resumes it'),
        ({'state': 'paused', 'text': 'no room'}, 'game is paused: no room'),
        ({'state': 'starting'}, 'game is starting'),
        ({'state': ''}, 'game is silent'),
    ],
)
def test_a_node_that_does_not_work_is_a_fault(changes: dict[str, object], fault: str) -> None:
    graph = replace(GRAPH, nodes=[CONDUCTOR, replace(GAME, **changes)])
    assert (graph.status, graph.faults) == (1, [fault])
    assert graph.to_text().endswith(f'\nfault: {fault}')


@pytest.mark.parametrize(
    ('changes', 'fault'),
    [
        ({'stopped': True, 'text': 'recording stopped: full'}, 'recording stopped: full'),
        ({'behind': True, 'text': 'it does not keep up'}, 'it does not keep up'),
        ({'missing': 3}, '3 messages are missing from the bag'),
        ({'complete': False}, 'the recorder still lacks some topics'),
        ({'disk_left': LITTLE_DISK - 1}, '1,000.0 MB are left on the disk'),
    ],
)
def test_a_recording_that_is_not_whole_is_a_fault(changes: dict[str, object], fault: str) -> None:
    graph = replace(GRAPH, recorder=replace(BAG, **changes))
    assert (graph.status, graph.faults) == (1, [fault])


def test_a_place_without_nodes_has_a_status_of_its_own() -> None:
    empty = GraphReport(3, '/room', [])
    assert empty.status == 2
    assert empty.to_text() == 'no node of humanopts is in ROS_DOMAIN_ID 3, namespace /room'


KILLED = -9


def pauses(policy: RestartPolicy, ran: float, count: int) -> list[float | None]:
    """Return the pauses before each life of a node whose policy are so long, s."""
    now, found = 100.0, []
    for _ in range(count):
        policy.begin(now)
        now += ran
        due = policy.end(now, KILLED)
        found.append(None if due is None else round(due - now, 6))
        now = due or now
    return found


def test_pauses_double_until_it_is_given_up() -> None:
    assert pauses(RestartPolicy(4), 1.0, 5) == [0.1, 0.2, 0.4, 0.8, None]
    assert pauses(RestartPolicy(0), 1.0, 1) == [None]


def test_a_node_that_ran_long_enough_is_started_again_for_ever() -> None:
    assert pauses(RestartPolicy(2), STEADY + 1.0, 50) == [0.1] * 50


def test_a_node_that_cannot_start_is_not_started_again() -> None:
    policy = RestartPolicy(5)
    policy.begin(0.0)
    assert policy.end(100.0, 2) is None


@pytest.mark.parametrize(
    ('restarts', 'again', 'said'),
    [
        (1, True, 'the node game ended (exit status 1), and is started again'),
        (0, False, 'the node game ended (exit status 1) while it was needed'),
        (5, False, 'the node game ended (exit status 1) after 5 restarts in a row while it was '
         'needed'),
    ],
)  # fmt: skip
def test_an_end_is_told_in_words(restarts: int, again: bool, said: str) -> None:
    assert NodeExit('game', 'exit status 1', '', restarts, again).sentence == said


@pytest.mark.parametrize('end', ['\n', '\r', '\u2028', '\x1b[1A', '\u202e'])
def test_no_text_of_another_node_ends_its_line(end: str) -> None:
    fake = f'x{end}all is well'
    node = replace(GAME, name=fake, state='paused', text=fake)
    bag = replace(BAG, path=fake, stopped=True, text=fake)
    text = replace(GRAPH, nodes=[node], recorder=bag, game=fake, holder=fake).to_text()
    assert 'all is well' not in text.splitlines()
    assert [c for c in text if not c.isprintable() and c != '\n'] == []
    assert text.count('\n') == 6
