"""
The whole graph, where ROS 2 is installed: ``ros2 launch humanopts_teach humanopts.launch.py``.

``--show-args`` lists the arguments, which are those of ``humanopts up``. A person teaches from a
second terminal:
``ros2 run humanopts_teach keyboard_teleop``.
"""

from collections.abc import Callable

from humanopts_teach.commands.ros_launch import (
    ARGUMENTS,
    launched,
    setup_from_launch,
    stop_seconds,
)
from humanopts_teach.launching.processes import ProcessSpec
from humanopts_teach.launching.restarts import CANNOT_START, MAX_RESTARTS
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

_RESPAWN_DELAY = 0.5  # s


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and nodes of the launch."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    texts = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    return [_node(spec) for spec in launched(setup_from_launch(texts))]


def _node(spec: ProcessSpec) -> Node:
    parameters = {  # launch_ros would read texts as YAML
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
    """Return a handler that ends the launch when a node cannot start or has ended too often."""
    ends = 0

    def on_exit(event: ProcessExited, context: LaunchContext) -> list[Shutdown] | None:
        nonlocal ends
        ends += 1
        if event.returncode != CANNOT_START and ends <= MAX_RESTARTS:
            return None
        return [Shutdown(reason=f'the node {name} ended')]

    return on_exit
