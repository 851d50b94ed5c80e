"""
The mechanics of the gripper, without ROS. Lengths are in metres, times in seconds.

The gripper travels along a rail above a table, is lowered and raised, and opens and closes. It
holds the object if it was closed around it.
"""

import random

RAIL = 1.0  # length of the rail
STRIDE, SLIP = 0.1, 0.01  # length of one motion along the rail, and its standard deviation
LOW = 0.2  # distance by which the gripper is lowered
WIDE = 0.08  # gap between the open fingers
REACH = 0.05  # maximum distance from the middle of the object for a grasp
BIN = 0.9, 0.08  # middle and half width of the bin
SPEED = {'slider': 0.4, 'lift': 0.5, 'fingers': 0.2}  # m/s
MOTIONS = ('left', 'right', 'lower', 'raise', 'open', 'close')


class Gripper:
    """
    A gripper over its table.

    :ivar joints: the position of ``slider`` along the rail, of ``lift`` below the rail, and the
        gap between the ``fingers``.
    :ivar object: position of the object along the rail.
    :ivar holding: whether the gripper holds the object.
    """

    def __init__(self, seed: int = 0) -> None:
        """:param seed: seed of the places of objects and the slip of the slider."""
        self._chance = random.Random(seed)
        self.joints = {'slider': 0.5, 'lift': 0.0, 'fingers': WIDE}
        self._goals = dict(self.joints)
        self.object, self.holding = 0.0, False
        self.put_object()

    def put_object(self) -> None:
        """Put the object at a random place outside of the bin, as a hand would."""
        self.holding = False
        self.object = self._chance.uniform(0.05, BIN[0] - 2 * BIN[1])

    def begin(self, motion: str) -> None:
        """
        Begin a motion.

        :raises KeyError: there is no such motion.
        :raises ValueError: the motion is impossible now; the text gives the reason.
        """
        if motion in ('left', 'right'):
            if self.joints['lift'] > 0.01:
                raise ValueError('raise the gripper before it travels')
            way = (-STRIDE if motion == 'left' else STRIDE) + self._chance.gauss(0.0, SLIP)
            self._goals['slider'] = min(max(self.joints['slider'] + way, 0.0), RAIL)
            return
        joint, goal = {
            'lower': ('lift', LOW),
            'raise': ('lift', 0.0),
            'open': ('fingers', WIDE),
            'close': ('fingers', 0.0),
        }[motion]
        self._goals[joint] = goal

    def is_moving(self) -> bool:
        """Return whether a motion has not ended."""
        return self.joints != self._goals

    def stop(self) -> None:
        """Stop all motions."""
        self._goals = dict(self.joints)

    def step(self, seconds: float) -> None:
        """Advance the time."""
        before = self.joints['fingers']
        for joint, goal in self._goals.items():
            way = SPEED[joint] * seconds
            self.joints[joint] = min(max(goal, self.joints[joint] - way), self.joints[joint] + way)
        fingers, slider = self.joints['fingers'], self.joints['slider']
        if self.holding and fingers > before:
            self.holding = False
        elif fingers < before and self.joints['lift'] > LOW - 0.01:
            self.holding = self.holding or abs(self.object - slider) < REACH
        if self.holding:
            self.object = slider

    def is_in_bin(self) -> bool:
        """Return whether the object is in the bin and released."""
        return not self.holding and abs(self.object - BIN[0]) < BIN[1]
