"""
The whole graph, where ROS 2 is installed: ``ros2 launch humanopts_teach humanopts.launch.py``.

``--show-args`` lists the arguments. A person teaches from a terminal of their own:
``ros2 run humanopts_teach keyboard_teleop``.
"""

from collections.abc import Callable

from humanopts_teach.launching.processes import ProcessSpec
from humanopts_teach.launching.restarts import CANNOT_START, MOST
from humanopts_teach.launching.ros_launch import (
    ARGUMENTS,
    launched,
    setup_from_launch,
    stop_seconds,
)
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

_RESPAWN_DELAY = 0.5  # s


def generate_launch_description() -> LaunchDescription:
    """Return what ``ros2 launch`` is to do."""
    declared = [
        DeclareLaunchArgument(a.name, default_value=a.default, description=a.description)
        for a in ARGUMENTS
    ]
    namespace = DeclareLaunchArgument(
        'namespace', default_value='', description='of all nodes, so that several games can run'
    )
    return LaunchDescription([*declared, namespace, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    values = {a.name: LaunchConfiguration(a.name).perform(context) for a in ARGUMENTS}
    setup = setup_from_launch(values)
    namespace = LaunchConfiguration('namespace').perform(context)
    return [_node(spec) for spec in launched(setup, namespace)]


def _node(spec: ProcessSpec) -> Node:
    parameters = {  # texts stay texts, where launch_ros would read them as YAML
        name: ParameterValue(value, value_type=str) if isinstance(value, str) else value
        for name, value in spec.parameters.items()
    }
    sigterm, sigkill = map(str, stop_seconds(spec.name))
    return Node(
        package=spec.package,
        executable=spec.name,
        namespace=LaunchConfiguration('namespace'),
        parameters=[parameters],
        output='screen',
        respawn=True,
        respawn_delay=_RESPAWN_DELAY,
        sigterm_timeout=sigterm,
        sigkill_timeout=sigkill,
        on_exit=_give_up(spec.name),
    )


def _give_up(name: str) -> Callable[[ProcessExited, LaunchContext], list[Shutdown] | None]:
    """Return what ends the launch when a node cannot start, or has been started often enough."""
    ends = 0

    def on_exit(event: ProcessExited, context: LaunchContext) -> list[Shutdown] | None:
        nonlocal ends
        ends += 1
        if event.returncode != CANNOT_START and ends <= MOST:
            return None
        return [Shutdown(reason=f'the node {name} ended')]

    return on_exit
