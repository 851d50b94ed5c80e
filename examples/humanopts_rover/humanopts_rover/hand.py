"""The hands of a person in the house: carry the rover, open and close doors."""

import argparse
import sys
from typing import Any

from geometry_msgs.msg import PoseStamped
from humanopts_rover import messages
from humanopts_rover.simulation import DOORS
import rclpy
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

PATIENCE = 5.0  # s


def call(node: Node, kind: Any, name: str, request: Any) -> Any:
    """
    Call a service of the rover, and return its answer.

    :raises SystemExit: the service does not exist.
    """
    client = node.create_client(kind, name)
    if not client.wait_for_service(timeout_sec=PATIENCE):
        raise SystemExit('the rover is not there: is it running, in this ROS_DOMAIN_ID?')
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=PATIENCE)
    return future.result()


def carry(node: Node, x: float, y: float, yaw: float) -> None:
    """Carry the rover to a pose; without enough room there, it stays where it is."""
    publisher = node.create_publisher(PoseStamped, 'carry_to', 1)
    pose = PoseStamped(header=messages.stamped(0.0, messages.FRAME))
    pose.pose.position.x, pose.pose.position.y = x, y
    pose.pose.orientation = messages.quaternion(yaw)
    while not publisher.get_subscription_count():
        rclpy.spin_once(node, timeout_sec=0.1)
    publisher.publish(pose)
    publisher.wait_for_all_acked()


def main(args: list[str] | None = None) -> int:
    """Run one command; return the exit status."""
    parser = argparse.ArgumentParser(prog='hand', description=__doc__)
    commands = parser.add_subparsers(dest='command', required=True)
    carried = commands.add_parser('carry', help='carry the rover to a pose, or somewhere')
    carried.add_argument('pose', nargs='*', type=float, help='x and y in m, and yaw in rad')
    for command in ('open', 'close'):
        commands.add_parser(command, help=f'{command} a door').add_argument('door', choices=DOORS)
    given = parser.parse_args(args)
    if given.command == 'carry' and len(given.pose) not in (0, 3):
        parser.error('give x, y and yaw, or nothing')
    rclpy.init()
    node = rclpy.create_node('hand')
    try:
        if given.command == 'carry' and given.pose:
            carry(node, *given.pose)
            return 0
        if given.command == 'carry':
            reply = call(node, Trigger, 'carry_somewhere', Trigger.Request())
        else:
            request = SetBool.Request(data=given.command == 'open')
            reply = call(node, SetBool, f'doors/{given.door}/set', request)
        if reply is None or not reply.success:
            raise SystemExit(reply.message if reply else 'the rover does not answer')
        print(reply.message or 'done')
        return 0
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == '__main__':
    sys.exit(main())
