"""Which topics are recorded."""

from humanopts_ros.recording import is_own, Selection
import pytest


@pytest.mark.parametrize(
    ('pattern', 'topic'),
    [
        ('/camera/image', '/camera/image'),
        ('camera/*', '/camera/image'),
        ('camera/*', '/camera/left/image'),
        ('*/_action/feedback', '/dock/_action/feedback'),
        ('odo[lm]', '/odom'),
        ('rosout', '/rosout'),
    ],
)
def test_a_pattern_is_for_the_whole_name_or_what_follows_the_namespace(
    pattern: str, topic: str
) -> None:
    assert Selection('/', record=[pattern]).wants(topic, own=False)
    assert not Selection('/', exclude=[pattern]).wants(topic, own=True)
    assert not Selection('/', record=[pattern]).wants('/another', own=False)
    assert Selection('/', exclude=[pattern]).wants('/another', own=True)


@pytest.mark.parametrize('pattern', ['camera/*', 'room_1/camera/*', '/room_1/camera/*'])
def test_in_a_namespace_it_may_be_named_or_left_out(pattern: str) -> None:
    selection = Selection('/room_1', record=[pattern])
    assert selection.wants('/room_1/camera/image', own=False)
    assert not selection.wants('/room_2/camera/image', own=False)


def test_what_is_excluded_is_not_recorded_though_a_pattern_asks_for_it() -> None:
    selection = Selection('/', record=['camera/*'], exclude=['*/raw'])
    assert selection.wants('/camera/image', own=False)
    assert not selection.wants('/camera/raw', own=False)


OURS = 'humanopts_interfaces/'
STATUS = 'action_msgs/msg/GoalStatusArray'
NODES = {'/a/game', '/a/lesson', '/a/planner', '/a/views'}  # publish /a/node_status


@pytest.mark.parametrize(
    ('topic', 'kind', 'publisher', 'own'),
    [
        ('/a/game_state', f'{OURS}msg/GameState', '/a/game', True),
        ('/a/action', f'{OURS}msg/ActionCommand', '/users/program', True),
        ('/a/run_option/_service_event', f'{OURS}srv/RunOption_Event', '/users/program', True),
        ('/a/lesson/open_session/_service_event', f'{OURS}srv/OpenSession_Event', '/a/game', True),
        ('/a/plan/_action/feedback', f'{OURS}action/Plan_FeedbackMessage', '/a/planner', True),
        ('/a/plan/_action/status', STATUS, '/a/planner', True),
        ('/a/views/board', 'nav_msgs/msg/OccupancyGrid', '/a/views', True),
        ('/a/dock/_action/status', STATUS, '/a/driver', False),
        ('/a/odom', 'nav_msgs/msg/Odometry', '/a/game', False),
        ('/tf', 'tf2_msgs/msg/TFMessage', '/a/views', False),
        ('/game_state', f'{OURS}msg/GameState', '/game', False),
        ('/a/b/game_state', f'{OURS}msg/GameState', '/a/b/game', False),
        ('/a/b/game_state', f'{OURS}msg/GameState', '/stranger', False),
        ('/a/lesson/open_session/_service_event', f'{OURS}srv/OpenSession_Event', '/x/y', False),
    ],
)
def test_a_graph_is_what_its_nodes_publish_in_its_namespace(
    topic: str, kind: str, publisher: str, own: bool
) -> None:
    assert is_own(topic, kind, '/a', NODES, lambda: [publisher]) is own


@pytest.mark.parametrize(
    ('selection', 'lacking'),
    [
        (Selection('/a'), ''),
        (Selection('/a', record=['/odom']), ''),
        (Selection('/a', exclude=['domain*']), 'domain_info will not'),
        (Selection('/a', exclude=['d*']), 'demonstrations and domain_info will not'),
    ],
)
def test_a_selection_says_what_an_evaluation_would_lack(
    selection: Selection, lacking: str
) -> None:
    assert selection.missing_for_evaluation.startswith(lacking)
    assert bool(selection.missing_for_evaluation) == bool(lacking)
