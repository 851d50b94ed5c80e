"""
The node ``views``: the game for RViz, Foxglove and other ROS viewers.

``scene.py`` defines the drawing for all domains.
"""

from collections.abc import Iterator, Sequence
from functools import partial
import math
import sys
from typing import Any

from geometry_msgs.msg import Point, Quaternion, TransformStamped, Vector3
from humanopts_env.board import Board
from humanopts_env.domains.base import ActableDomain, BoardSlice, is_enumerable
from humanopts_env.domains.capabilities import board_of
from humanopts_env.domains.described import can_simulate
from humanopts_env.ros.game_subscriber import GameSubscriber, Observed
from humanopts_env.seeding import generator
from humanopts_interfaces.msg import OptionGoal, OptionResult, OptionValues
from humanopts_learner.planning.interruption import OptionValues as PlanValues
from humanopts_learner.ros.convert import option_values_from_message
from humanopts_ros.codec import uuid_from_message
from humanopts_ros.guarded_node import StartError
from humanopts_ros.node_base import NodeBase
from humanopts_ros.process import run_node
from humanopts_ros.qos import CURRENT, DISPLAY, LATCHED
from humanopts_teach.scene import (
    Kind,
    layout_of,
    occupied,
    RESOLUTION,
    scene,
    Shape,
    text_above,
    value_shapes,
)
from nav_msgs.msg import OccupancyGrid
import numpy as np
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

FRAME = 'humanopts'  # below the namespace, unless a parameter names another
_PERIOD = 0.05  # s, polling period of the game and minimum time between drawings
_OCCUPIED = 100  # value in OccupancyGrid
_ALONE = (Kind.BALL, Kind.BOX, Kind.TEXT)  # kinds placed at the pose of the marker
_HEIGHTS = {'values': -0.1, 'board': 0.0}  # z of layers, m; other layers are above the board
_THIN = 0.05  # m


class ViewsNode(NodeBase):
    """Publishes the board with its marks, the running option, and the values of a plan."""

    def __init__(self, **options: Any) -> None:
        super().__init__('views', **options)
        frame = self.setting('frame_id', '', 'frame of the board; empty: NAMESPACE/humanopts')
        self.frame = frame or self.full_name(FRAME).lstrip('/')
        self._parent = self.setting(
            'parent_frame', '', 'frame in which the board lies; empty: no transform is published'
        )
        self._pose = self.setting(
            'transform', [0.0] * 4, 'x, y, z (m) and yaw (rad) of the board in parent_frame'
        )
        if len(self._pose) != 4:
            raise StartError('parameter transform: give four numbers, x, y, z and yaw')
        self._board = self.create_publisher(OccupancyGrid, '~/board', LATCHED)
        self._markers = self.create_publisher(MarkerArray, '~/markers', LATCHED)
        self._game = GameSubscriber(self, self._begin)
        self._newest = self._game.newest()
        self._state: Observed | None = None
        self._run = '', ''  # id and name of the active option run
        self._plan: PlanValues | None = None  # latest plan over the states of the game
        self._layouts: Sequence[BoardSlice] = ()
        self._changed = False
        self.create_subscription(OptionGoal, 'option_goals', self._on_goal, DISPLAY)
        self.create_subscription(OptionResult, 'option_results', self._on_result, DISPLAY)
        read, use = option_values_from_message, self._on_values
        self.subscribe(OptionValues, 'option_values', read, use, CURRENT)
        self._timer = self.create_timer(_PERIOD, self._draw_newest, autostart=False)
        self._place_board()

    def waits_for(self) -> str | None:
        """Wait for the domain of the game."""
        return None if self._game.domain else 'domain_info'

    def _place_board(self) -> None:
        """Publish the transform of the board, if configured and possible."""
        if not self._parent:
            return
        try:
            from tf2_msgs.msg import TFMessage  # not available as a wheel
        except ImportError:
            self.get_logger().warning(
                'no transform is published: install tf2_msgs (ros-jazzy-tf2-msgs)'
            )
            return
        x, y, z, yaw = self._pose
        placed = TransformStamped(child_frame_id=self.frame)
        placed.header.frame_id = self._parent
        placed.header.stamp = self.get_clock().now().to_msg()
        placed.transform.translation = Vector3(x=x, y=y, z=z)
        placed.transform.rotation = Quaternion(z=math.sin(yaw / 2), w=math.cos(yaw / 2))
        self._transforms = self.create_publisher(TFMessage, '/tf_static', LATCHED)
        self._transforms.publish(TFMessage(transforms=[placed]))

    def _begin(self, domain: ActableDomain) -> None:
        self._layouts = domain.board_slices() if is_enumerable(domain) else ()
        if can_simulate(domain):
            first = domain.reset(
                generator(0, 'views')
            )  # blocks and walls are the same in all states
            self._board.publish(self._grid(board_of(domain, first)))
        self._timer.reset()

    def _on_goal(self, goal: OptionGoal) -> None:
        self._run = uuid_from_message(goal.run_id), goal.option_name or goal.execution
        self._changed = True

    def _on_result(self, result: OptionResult) -> None:
        if uuid_from_message(result.run_id) == self._run[0]:
            self._run = '', ''
            self._changed = True

    def _on_values(self, plan: PlanValues) -> None:
        self._plan = None if plan.sampled else plan
        self._changed = True

    def _draw_newest(self) -> None:
        """Draw the latest state if anything has changed."""
        if (newest := self._newest.take()) is not None:
            self._state = newest
        elif not self._changed:
            return
        self._changed = False
        self._markers.publish(MarkerArray(markers=list(self._drawn())))

    def _drawn(self) -> Iterator[Marker]:
        """Yield markers that replace all previous ones."""
        yield self._marker(action=Marker.DELETEALL)
        for number, shape in enumerate(self._shapes()):
            yield self._encoded(number, shape)

    def _shapes(self) -> Iterator[Shape]:
        domain, observed = self._game.domain, self._state
        if domain is None or observed is None or observed.state is None:
            return
        board = board_of(domain, observed.state)
        yield from scene(board)
        if self._run[1]:
            yield text_above(board, self._run[1], 'option', 0.6, 0.6)
        if (plan := self._plan) is not None and is_enumerable(domain) and self._layouts:
            layout = layout_of(self._layouts, domain.index(observed.state))
            best = plan.option_values.max(axis=1, initial=-np.inf)
            yield from value_shapes(board, layout, plan.states, best, plan.action_set)

    def _grid(self, board: Board) -> OccupancyGrid:
        cells = occupied(board)
        grid = OccupancyGrid(data=(cells * _OCCUPIED).astype('int8').ravel().tolist())
        grid.header.frame_id = self.frame
        grid.header.stamp = grid.info.map_load_time = self.get_clock().now().to_msg()
        grid.info.resolution = RESOLUTION
        grid.info.height, grid.info.width = cells.shape
        # walls lie on the edges of the board's cells
        grid.info.origin.position.x = grid.info.origin.position.y = -RESOLUTION / 2
        grid.info.origin.position.z = 2 * _HEIGHTS['values']  # below everything
        return grid

    def _marker(self, **fields: Any) -> Marker:
        marker = Marker(**fields)
        marker.header.frame_id = self.frame
        marker.header.stamp = self.get_clock().now().to_msg()
        marker.pose.orientation.w = 1.0
        return marker

    def _encoded(self, number: int, shape: Shape) -> Marker:
        """Encode a shape as a marker; the number is unique within a drawing."""
        z = _HEIGHTS.get(shape.layer, 0.2)
        points = [Point(x=x, y=y, z=z) for x, y in shape.points]
        colours = [ColorRGBA(r=r, g=g, b=b, a=1.0) for r, g, b in shape.colours]
        kind = getattr(Marker, shape.kind.value)
        marker = self._marker(ns=shape.layer, id=number, type=kind, text=shape.text)
        marker.color = colours[0]
        width, height = shape.size
        marker.scale = Vector3(x=width, y=height, z=_THIN)
        if shape.kind in _ALONE:
            marker.pose.position = points[0]
            marker.scale.z = height
        else:
            marker.points = points
            marker.colors = colours if len(colours) > 1 else []
        if shape.kind is Kind.LINES:
            marker.scale = Vector3(x=width)  # other components are unused
        return marker


main = partial(run_node, ViewsNode)

if __name__ == '__main__':
    sys.exit(main())
