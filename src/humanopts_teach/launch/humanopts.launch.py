"""
The whole graph, where ROS 2 is installed: ``ros2 launch humanopts_teach humanopts.launch.py``.

``--show-args`` lists the arguments. A person teaches from a terminal of their own:
``ros2 run humanopts_teach keyboard_teleop``.
"""

from humanopts_teach.launching.processes import processes, ProcessSpec
from humanopts_teach.launching.ros_launch import ARGUMENTS, setup_from_launch
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


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
    return [_node(spec) for spec in processes(setup_from_launch(values))]


def _node(spec: ProcessSpec) -> Node:
    parameters = {  # texts stay texts, where launch_ros would read them as YAML
        name: ParameterValue(value, value_type=str) if isinstance(value, str) else value
        for name, value in spec.parameters.items()
    }
    return Node(
        package=spec.package,
        executable=spec.name,
        namespace=LaunchConfiguration('namespace'),
        parameters=[parameters],
        output='screen',
        on_exit=Shutdown(reason=f'the node {spec.name} ended'),
    )
