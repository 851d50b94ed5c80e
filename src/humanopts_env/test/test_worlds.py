"""World files: what they may say, and what is read from the messages of a robot."""

import copy
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from humanopts_env.domains.base import DomainError, FeatureKind
from humanopts_env.domains.described import NeedsRulesError
from humanopts_env.domains.names import robot_file
from humanopts_env.domains.registry import make_domain, open_domain
from humanopts_env.worlds.sensors import SensorError, Sensors
from humanopts_env.worlds.world import load_world, World
from humanopts_env.worlds.world_file import checked_world, read_world_file, WorldFileError
import pytest
import yaml

TEXT = """
name: scout
step: 0.2
topics:
  odom: {topic: /odom, type: nav_msgs/msg/Odometry, stale: 0.5}
  scan: {topic: /scan, type: sensor_msgs/msg/LaserScan, stale: 0.5}
  gripper: {topic: /gripper/holds, type: std_msgs/msg/Bool, latched: yes}
  mode: {topic: /mode, type: std_msgs/msg/String}
  arm: {topic: /joints, type: sensor_msgs/msg/JointState}
  tf: {topic: /tf, type: tf2_msgs/msg/TFMessage, stale: 0.5}
  fixed: {topic: /tf_static, type: tf2_msgs/msg/TFMessage, latched: yes}
  plan: {topic: /plan, type: nav_msgs/msg/Path}
places:
  charger: {x: 7.0, y: 1.0, yaw: 0.0}
features:
  x: {field: odom.pose.pose.position.x, question: how far east it is, unit: m, range: [0, 8]}
  distance: {distance_to: charger, pose: odom, question: how far it is, range: [0, 12]}
  bearing: {bearing_to: charger, pose: odom, question: in which direction it is}
  heading: {heading: odom, question: where it looks}
  turn: {heading_to: charger, pose: odom, question: how far it is turned from the charger}
  waypoint: {bearing_to: "plan.poses[1]", pose: odom, question: where the path leads}
  ahead: {scan_min: scan, sector: [-15, 15], question: what is ahead, range: [0, 5], clip: yes}
  behind: {scan_min: scan, sector: [165, 195], question: what is behind, range: [0, 10]}
  carrying: {field: gripper.data, values: [no, yes], question: whether it carries something}
  mode: {field: mode.data, values: [idle, driving], kind: ordinal, question: what it does}
  joint: {field: "arm.position[1]", question: where the elbow is, unit: rad, range: [-2, 2]}
  age: {age: scan, question: how old the scan is, range: [0, 1]}
  tip_x: {tf: [base, tip], part: x, question: how far the tip reaches, range: [-5, 5]}
  tip_yaw: {tf: [base, tip], part: yaw, question: how the tip is turned}
actions:
  forward: {key: up, twist: {linear: 0.3}}
  arc: {key: right, twist: {linear: [0.1, 0, 0], angular: -0.5}, seconds: 0.4}
  wait: {key: ., idle: yes, twist: {}}
  home: {key: h, action: /go, type: nav2_msgs/action/NavigateToPose, goal: {a: 1}, seconds: 60}
  close: {key: 1, service: /close, type: std_srvs/srv/Trigger, seconds: 3, settle: 0.5}
  beep: {key: b, topic: /beep, type: std_msgs/msg/Empty, seconds: 0}
reward: {step: -1, field: arm.effort}
ends:
  - {when: distance < 0.5, reward: 10}
  - {when: carrying == 'yes' and x > 7.9, success: no}
safety: {emergency: /stop}
"""


def quaternion(yaw: float) -> SimpleNamespace:
    return SimpleNamespace(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))


def point(x: float, y: float, z: float = 0.0) -> SimpleNamespace:
    return SimpleNamespace(x=x, y=y, z=z)


def posed(x: float, y: float, yaw: float) -> SimpleNamespace:
    return SimpleNamespace(pose=SimpleNamespace(position=point(x, y), orientation=quaternion(yaw)))


def odometry(x: float, y: float, yaw: float) -> SimpleNamespace:
    return SimpleNamespace(pose=posed(x, y, yaw))


def scan(*ranges: float) -> SimpleNamespace:
    """Return a scan whose first beam looks back, and whose beams run left."""
    return SimpleNamespace(
        ranges=list(ranges),
        angle_min=-math.pi,
        angle_increment=math.tau / len(ranges),
        range_min=0.1,
        range_max=10.0,
    )


def transforms(*edges: tuple[str, str, float, float, float]) -> SimpleNamespace:
    return SimpleNamespace(
        transforms=[
            SimpleNamespace(
                header=SimpleNamespace(frame_id=parent),
                child_frame_id=child,
                transform=SimpleNamespace(translation=point(x, y), rotation=quaternion(yaw)),
            )
            for parent, child, x, y, yaw in edges
        ]
    )


MESSAGES: dict[str, Any] = {
    'odom': odometry(4.0, 1.0, math.pi / 2),
    'scan': scan(4.0, 9.0, math.inf, 2.5),
    'gripper': SimpleNamespace(data=True),
    'mode': SimpleNamespace(data='driving'),
    'arm': SimpleNamespace(position=[0.5, -1.5], effort=0.25),
    'tf': transforms(('map', '/base', 4.0, 1.0, math.pi / 2), ('arm', 'tip', 1.0, 0.0, 0.5)),
    'fixed': transforms(('/map', 'arm', 4.0, 2.0, 0.0)),
    'plan': SimpleNamespace(poses=[posed(9, 9, 0), posed(4.0, 3.0, 0)]),
}


def world(text: str = TEXT) -> World:
    return World(checked_world(yaml.safe_load(text), 'scout.yaml'), 'scout.yaml')


def sensed(**changed: Any) -> Sensors:
    sensors = Sensors(world().file.topics)
    for name, message in (MESSAGES | changed).items():
        sensors.note(name, message, 10.0)
    sensors.check(10.25)
    return sensors


def features(**changed: Any) -> dict[str, float]:
    scout = world()
    return dict(zip(scout.file.features, scout.sense(sensed(**changed)).features))


def test_a_file_describes_a_domain() -> None:
    domain = world().domain
    assert (domain.name, domain.gamma, domain.max_steps) == ('scout', 0.99, 0)
    kinds = {f.name: f.kind for f in domain.features}
    assert kinds['carrying'] is FeatureKind.NOMINAL
    assert kinds['mode'] is FeatureKind.ORDINAL
    assert kinds['x'] is FeatureKind.CONTINUOUS
    described = {f.name: (f.low, f.high, f.unit) for f in domain.features}
    assert described['bearing'] == (-math.pi, math.pi, 'rad')
    assert described['ahead'] == (0, 5, 'm')
    assert described['carrying'] == (0, 0, '')
    seconds = {a.name: (a.key, a.seconds, a.idle) for a in domain.actions}
    assert seconds == {
        'forward': ('up', 0.2, False),
        'arc': ('right', 0.4, False),
        'wait': ('.', 0.2, True),
        'home': ('h', 60.0, False),
        'close': ('1', 3.5, False),
        'beep': ('b', 0.0, False),
    }


def test_every_kind_of_feature_is_read_from_messages() -> None:
    """The robot is 3 m west of the charger, looks north, and its arm is 1 m before it."""
    found = features()
    assert found == pytest.approx(
        {
            'x': 4.0,
            'distance': 3.0,
            'bearing': -math.pi / 2,
            'heading': math.pi / 2,
            'turn': -math.pi / 2,
            'waypoint': 0.0,
            'ahead': 5.0,  # no echo, clipped
            'behind': 4.0,
            'carrying': 1.0,
            'mode': 1.0,
            'joint': -1.5,
            'age': 0.25,
            'tip_x': 1.0,
            'tip_yaw': 0.5 - math.pi / 2,
        },
        abs=1e-9,
    )


def test_the_state_is_a_text_of_all_features() -> None:
    scout = world()
    text = scout.text(scout.sense(sensed()).features)
    assert text.startswith('x 4 m, distance 3 m, bearing -1.571 rad')
    assert 'carrying yes, mode driving' in text


UNREADABLE = {
    'nan': ({'odom': odometry(math.nan, 1, 0)}, 'the feature x cannot be read: it is nan'),
    'nan in a scan': (
        {'scan': scan(4.0, 9.0, math.nan, 2.5)},
        'the feature ahead cannot be read: a range of the scan is nan',
    ),
    'empty scan': (
        {'scan': scan(1.0)},
        'the feature ahead cannot be read: the scan has no beam in its sector',
    ),
    'another value': (
        {'mode': SimpleNamespace(data='lost')},
        "the feature mode cannot be read: it is 'lost', but can only be idle, driving",
    ),
    'no such value': (
        {'gripper': SimpleNamespace(data=2)},
        'the feature carrying cannot be read: it is 2, and has 2 values',
    ),
    'too few joints': (
        {'arm': SimpleNamespace(position=[0.5], effort=0.0)},
        'the feature joint cannot be read: arm.position[1]: there is no element 1 now',
    ),
    'no such field': (
        {'arm': SimpleNamespace(effort=0.0)},
        'the feature joint cannot be read: arm.position[1]: sensor_msgs/msg/JointState has no '
        "field 'position' there",
    ),
    'no number': (
        {'arm': SimpleNamespace(position=[0.5, 'open'], effort=0.0)},
        'the feature joint cannot be read: it is str, not a number',
    ),
    'no rotation': (
        {'odom': SimpleNamespace(pose=SimpleNamespace(pose=SimpleNamespace(
            position=point(1, 1), orientation=SimpleNamespace(x=0, y=0, z=0, w=0))))},
        'the feature distance cannot be read: its orientation is not a rotation',
    ),
    'no frames': (
        {'fixed': transforms()},
        'the feature tip_x cannot be read: no transforms connect base and tip',
    ),
}  # fmt: skip


@pytest.mark.parametrize('case', UNREADABLE)
def test_what_cannot_be_sensed_is_one_sentence(case: str) -> None:
    changed, sentence = UNREADABLE[case]
    with pytest.raises(SensorError) as refused:
        features(**changed)
    assert str(refused.value) == sentence


def test_a_number_out_of_its_range_is_clipped_and_named() -> None:
    found = world().sense(sensed(odom=odometry(9.5, 1, 0)))
    assert found.features[0] == 8.0
    assert found.outside == (
        'the feature x is out of its range 0 to 8: it is 9.5; only a person can drive it back (or '
        'widen the range, or add clip: yes)'
    )
    assert not world().sense(sensed()).outside


def test_missing_and_stale_topics_are_named() -> None:
    sensors = Sensors(world().file.topics)
    sensors.note('odom', MESSAGES['odom'], 1.0)
    with pytest.raises(SensorError, match=r'no message has arrived on /scan \(sensor_msgs/msg/L'):
        sensors.check(1.0)
    sensors = sensed()
    sensors.note('scan', MESSAGES['scan'], 11.0)
    with pytest.raises(SensorError, match=r'/odom is stale: its last message is 1.0 s old'):
        sensors.check(11.0)


def test_a_transform_of_a_silent_node_is_stale_though_others_are_published() -> None:
    sensors = sensed()
    sensors.note('tf', transforms(('arm', 'tip', 1.0, 0.0, 0.5)), 10.7)
    for name in ('odom', 'scan'):
        sensors.note(name, MESSAGES[name], 10.7)
    sensors.check(10.8)
    with pytest.raises(SensorError, match=r'the transform from map to base is stale: it is 0.8 s'):
        world().sense(sensors)


def test_an_end_is_a_condition_that_becomes_true() -> None:
    scout, sensors = world(), sensed()
    far, near = list(scout.sense(sensors).features), list(scout.sense(sensors).features)
    near[1] = 0.4
    reached = scout.ending(far, 'forward', near, sensors)
    assert (reached.reward, reached.terminated, reached.truncated) == (9.25, True, False)
    again = scout.ending(near, 'wait', near, sensors)
    assert (again.reward, again.terminated, again.truncated) == (-0.75, False, False)
    lost = [7.95, *far[1:]]
    assert scout.ending(far, 'forward', lost, sensors).truncated
    sensors.note('arm', SimpleNamespace(position=[0.0, 0.0], effort=math.nan), 10.0)
    with pytest.raises(SensorError, match='the reward of wait is nan'):
        scout.ending(near, 'wait', near, sensors)


MISTAKES = {
    'unknown key': ({'velocty': {}}, 'velocty: unknown key; use name, step, gamma, max_steps'),
    'unknown key of a feature': (
        {'features.x.filed': 'odom.x'},
        'features x filed: unknown key; use question, kind, values',
    ),
    'unknown key of a twist': (
        {'actions.forward.twist': {'liner': 1}},
        'actions forward twist liner: unknown key; use linear, angular',
    ),
    'no source': ({'features.x': {'question': 'why'}}, 'features x: give one of field, distance'),
    'two sources': (
        {'features.x.age': 'scan'},
        'computed, not field and age',
    ),
    'no range': (
        {'features.x': {'question': 'where', 'field': 'odom.x'}},
        'features x: a number needs its range, such as range: [0, 8]',
    ),
    'empty range': ({'features.x.range': [3, 3]}, 'features x: the range [3.0, 3.0] is empty'),
    'no values': (
        {'features.mode.values': []},
        'features mode: ordinal values are missing, such as values: [no, yes]',
    ),
    'values of a number': (
        {'features.x.kind': 'continuous', 'features.x.values': ['a']},
        'features x: a continuous feature has a range, not values',
    ),
    'no pose': (
        {'features.bearing': {'question': 'where', 'bearing_to': 'charger'}},
        'features bearing: bearing_to needs pose',
    ),
    'unknown topic': (
        {'features.x.field': 'odmo.pose'},
        "features x: unknown topic 'odmo'; the file has odom, scan",
    ),
    'unknown topic of an age': (
        {'features.age.age': 'scam'},
        "features age: unknown topic 'scam'",
    ),
    'no path': ({'features.x.field': 'odom..x'}, "features x: 'odom..x' is not a field"),
    'unknown place': (
        {'features.distance.distance_to': 'charter'},
        "features distance: unknown place 'charter'; choose from charger, odom",
    ),
    'no frames': (
        {'topics.tf.type': 'a/msg/B', 'topics.fixed.type': 'a/msg/B'},
        'features tip_x: the frames base and tip need a topic of type tf2_msgs/msg/TFMessage',
    ),
    'two actions with one key': (
        {'actions.wait.key': 'up'},
        "'scout' cannot be used: two actions have one key: up, right, up",
    ),
    'no key': ({'actions.wait.key': 'space'}, "'scout' cannot be used: 'space' is not a key"),
    'two ways': (
        {'actions.wait.topic': '/beep'},
        'actions wait: give one of twist, action, service, topic, not twist and topic',
    ),
    'no type': ({'actions.close.type': ''}, 'actions close: service needs its type'),
    'other type': (
        {'actions.home.type': 'nav2_msgs/msg/Pose'},
        'actions home: action needs its type, such as type: package/action/Type',
    ),
    'no deadline': (
        {'actions.home.seconds': None},
        'actions home: action needs seconds: the longest time that it may take',
    ),
    'goal of a topic': (
        {'actions.beep.goal': {'a': 1}},
        'actions beep: goal is for action, not for topic',
    ),
    'wrong type of value': ({'step': 'fast'}, 'step: it should be a valid number, not "fast"'),
    'type of a topic': ({'topics.odom.type': 'Odometry'}, 'topics odom type: String should match'),
    'two types of a topic': (
        {'topics.scan.topic': '/odom'},
        'topics: /odom has two types, nav_msgs/msg/Odometry and sensor_msgs/msg/LaserScan',
    ),
    'unknown feature of an end': (
        {'ends': [{'when': 'distanze < 1'}]},
        'ends 1 when: ',
    ),
    'end without a comparison': (
        {'ends': [{'when': 'distance - x'}]},
        "ends 1 when: 'distance - x' is a number; compare it, as in distance - x < 0.2",
    ),
    'class needed': (
        {'features.x': {'question': 'q', 'computed': True, 'range': [0, 8]}},
        'features x: computed is for a class, ros:FILE.py:CLASS',
    ),
    'name of a game': ({'name': 'taxi'}, 'name: taxi is a game of humanopts; choose another'),
    'no features': ({'features': {}}, "'scout' cannot be used: it has no feature"),
    'nothing': ({'features': None}, 'features: it should be'),
}


@pytest.mark.parametrize('case', MISTAKES)
def test_a_mistake_is_one_line_with_file_and_key(case: str) -> None:
    changes, sentence = MISTAKES[case]
    values = copy.deepcopy(yaml.safe_load(TEXT))
    for path, value in changes.items():
        *parents, last = path.split('.')
        place = values
        for key in parents:
            place = place[key]
        place[last] = value
    with pytest.raises(WorldFileError) as refused:
        World(checked_world(values, 'scout.yaml'), 'scout.yaml')
    said = str(refused.value)
    assert said.startswith('scout.yaml: ')
    assert sentence in said
    assert '\n' not in said


def test_a_key_that_is_misspelled_is_named_and_not_only_what_is_missing() -> None:
    values = yaml.safe_load(TEXT)
    values['actoins'] = values.pop('actions')
    with pytest.raises(WorldFileError, match=r'^scout.yaml: actoins: unknown key; use name, '):
        checked_world(values, 'scout.yaml')


def test_files_that_are_missing_or_no_yaml_are_refused(tmp_path: Path) -> None:
    with pytest.raises(WorldFileError, match=r'cannot read .*rover.yaml: No such file'):
        load_world(f'ros:{tmp_path}/rover.yaml')
    (tmp_path / 'a.yaml').write_text('name: [')
    with pytest.raises(WorldFileError, match=r'a.yaml: it is not YAML: .*line'):
        read_world_file(tmp_path / 'a.yaml')
    (tmp_path / 'b.yaml').write_text('- 1')
    with pytest.raises(WorldFileError, match=r'b.yaml: it must have the keys name, topics'):
        read_world_file(tmp_path / 'b.yaml')


def test_a_file_is_read_with_its_yes_and_no(tmp_path: Path) -> None:
    (tmp_path / 'scout.yaml').write_text(TEXT)
    found = load_world(f'ros:{tmp_path}/scout.yaml')
    assert found.domain == world().domain
    assert found.file.features['carrying'].values == ('no', 'yes')


def test_fields_that_a_type_lacks_are_found_before_a_message_arrives() -> None:
    with pytest.raises(WorldFileError, match=r'features x: .* nav_msgs/msg/Odometry has no '):
        world().check_types(MESSAGES | {'odom': SimpleNamespace(pose=SimpleNamespace(twist=1))})
    world().check_types(MESSAGES | {'arm': SimpleNamespace(position=[], effort=0.0)})


CLASS = """
from itertools import count

class Rover:
    world = {
        'name': 'rover',
        'topics': {'odom': {'topic': '/odom', 'type': 'nav_msgs/msg/Odometry'}},
        'features': {
            'half': {'computed': True, 'question': 'where', 'range': [0, 4]},
            'x': {'field': 'odom.pose.pose.position.x', 'question': 'where', 'range': [0, 8]},
        },
        'actions': {'forward': {'key': 'up', 'twist': {'linear': 0.3}}},
    }

    def features(self, messages):
        return {'half': messages['odom'].pose.pose.position.x / 2}

    def reward(self, before, action, after):
        return after['x'] - before['x']

    def success(self, before, after):
        return True if after['half'] > 3 else None
"""


def test_a_class_computes_features_rewards_and_ends(tmp_path: Path) -> None:
    (tmp_path / 'rover.py').write_text(CLASS)
    rover = load_world(f'ros:{tmp_path}/rover.py:Rover')
    sensors = Sensors(rover.file.topics)
    sensors.note('odom', odometry(3.0, 0, 0), 0.0)
    assert rover.sense(sensors).features == (1.5, 3.0)
    ending = rover.ending((1.5, 3.0), 'forward', (3.5, 7.0), sensors)
    assert (ending.reward, ending.terminated, ending.truncated) == (4.0, True, False)
    sensors.note('odom', SimpleNamespace(), 0.0)
    with pytest.raises(SensorError, match='the features of Rover cannot be computed: Attribute'):
        rover.sense(sensors)
    assert robot_file(f'ros:{tmp_path}/rover.py:Rover') == (tmp_path / 'rover.py', 'Rover')


@pytest.mark.parametrize(
    ('text', 'name', 'sentence'),
    [
        (CLASS, '', 'name its class, such as ros:rover.py:Rover'),
        (CLASS, ':Robot', 'it has no class Robot with the method features'),
        ('raise SystemExit(3)', ':Rover', 'rover.py cannot be loaded: SystemExit: 3'),
        ('class Rover:\n def features(self, m): ...', ':Rover', 'it must have the keys name'),
    ],
)
def test_a_class_that_cannot_be_used_is_one_line(
    text: str, name: str, sentence: str, tmp_path: Path
) -> None:
    (tmp_path / 'rover.py').write_text(text)
    with pytest.raises(WorldFileError) as refused:
        load_world(f'ros:{tmp_path}/rover.py{name}')
    assert sentence in str(refused.value)


def test_a_robot_is_opened_to_act_in_and_cannot_be_simulated(tmp_path: Path) -> None:
    (tmp_path / 'scout.yaml').write_text(TEXT)
    name = f'ros:{tmp_path}/scout.yaml'
    assert open_domain(name, {}) == world().domain
    with pytest.raises(DomainError, match='takes no parameters: change its file'):
        open_domain(name, {'rows': 5})
    with pytest.raises(NeedsRulesError, match=r'scout.yaml is a robot; this operation needs'):
        make_domain(name)
