"""
Reference options of Gymnasium environments: known rules, and the missions of MiniGrid.

The options read the environment itself. Other environments have no options and thus no simulated
teacher; a package can add options under a domain name, such as ``gymnasium:package/Maze-v0``.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.formulas import feature_columns, FormulaError
from humanopts_env.domains.gymnasium_replayed import EnvironmentWorld, ReplayedEnvironment
from humanopts_env.domains.minigrid_reference import MISSIONS
from humanopts_env.domains.reference import ReferenceOption, Rule
from humanopts_env.domains.replayed_domain import History


@dataclass(frozen=True)
class WatchedOption:
    """A ``ReferenceOption`` that reads the environment."""

    domain: ReplayedEnvironment
    rule: Rule

    @property
    def name(self) -> str:
        """The name shown to people."""
        return self.rule.name

    @property
    def definition(self) -> str:
        """The initiation set, policy and termination condition in words."""
        return self.rule.definition

    @property
    def features(self) -> tuple[str, ...]:
        """The relevant features; all features if the extractor lacks those of the rule."""
        names = [feature.name for feature in self.domain.features]
        used = [each for each in self.rule.features if each in names or not each.isidentifier()]
        try:
            columns = feature_columns(self.domain, used)
        except FormulaError:
            columns = []
        return tuple(column.feature.name for column in columns) or tuple(names)

    def can_start(self, state: History) -> bool:
        """Return whether the rule has an action in a state."""
        return bool(self.optimal_actions(state))

    def ends(self, state: History) -> bool:
        """Return whether the option has reached its end or left its initiation set."""
        return self.reached(state) if state.over else not self.can_start(state)

    def reached(self, state: History) -> bool:
        """Return whether the option has reached its end; the task may be over without it."""
        return bool(self.rule.done(*self._seen(state)))

    def optimal_actions(self, state: History) -> tuple[int, ...]:
        """Return the best actions, the usual one first."""
        if state.over or self.reached(state):
            return ()
        return tuple(self.rule.best(*self._seen(state)))

    def _seen(self, state: History) -> tuple[Any, Any]:
        world = self.domain.world(state)
        assert isinstance(world, EnvironmentWorld)
        return world.env.unwrapped, world.observation


def reference_options(domain: Domain) -> Mapping[str, ReferenceOption]:
    """Return the reference options of an environment by name; empty if it has none."""
    if not isinstance(domain, ReplayedEnvironment):
        return {}
    env, known = domain.make_world().env.unwrapped, RULES | MISSIONS
    kinds = (f'{kind.__module__.partition(".")[0]}.{kind.__name__}' for kind in type(env).__mro__)
    rules = next((known[kind] for kind in kinds if kind in known), ())
    return {rule.name: WatchedOption(domain, rule) for rule in rules}


# Known rules, in terms of the observation ``seen``.


def _fly_to_the_pad(seen: Any) -> int:
    """
    Return the action of a rule of the same form as the environment's heuristic.

    The heuristic lands from 277 of 300 starts; this rule, with other constants, from all 300.
    """
    x, y, x_speed, y_speed, angle, angular_speed, *legs = seen
    tilt = sink = 0.0
    if not any(legs):
        tilt = min(max(0.6 * x + x_speed, -0.3), 0.3) - angle - 2 * angular_speed
        sink = 0.14 * abs(x) - 0.7 * y
    if (sink := sink - y_speed) > max(abs(tilt), 0.1):
        return 2  # main engine
    return 0 if abs(tilt) <= 0.1 else 1 if tilt > 0 else 3  # left or right engine


# The lander's deviations from a target angle and a target speed of descent, as in its rule. On the
# ground, only the speed counts. The main engine is on if the second deviation is larger.
_FLIES = '(not (left_leg or right_leg))'
_TILT = f'(clip(0.6 * x + x_speed, -0.3, 0.3) - angle - 2 * angular_speed) * {_FLIES}'
_SINK = f'(0.14 * abs(x) - 0.7 * y) * {_FLIES} - y_speed'

RULES: dict[str, tuple[Rule, ...]] = {  # by package and class of the environment
    'gymnasium.LunarLander': (
        Rule(
            'land',
            'Starts in the air; flies to the pad; ends at rest on the ground.',
            (_TILT, f'{_SINK} - abs({_TILT})'),
            lambda env, seen: [_fly_to_the_pad(seen)],
            lambda env, seen: not env.lander.awake and not env.game_over,
        ),
    ),
    'gymnasium.MountainCarEnv': (
        Rule(
            'drive to the flag',
            'Starts anywhere; pushes in the direction of motion; ends at the flag.',
            ('position', 'speed'),
            lambda env, seen: [2 if seen[1] >= 0 else 0],
            lambda env, seen: seen[0] >= env.goal_position,
        ),
    ),
    'gymnasium.AcrobotEnv': (
        Rule(
            'swing up',
            'Starts anywhere; pushes against the motion of the first link; ends with the tip '
            'above the line.',
            ('cos_1', 'sin_1', 'cos_2', 'sin_2', 'speed_1', 'speed_2'),
            lambda env, seen: [0 if seen[4] > 0 else 2],
            lambda env, seen: env._terminal(),
        ),
    ),
    'gymnasium.CartPoleEnv': (
        Rule(
            'straighten the pole',
            'Starts where the pole leans or turns; pushes the cart under it; ends with the pole '
            'upright and nearly still.',
            ('pole_angle', 'pole_speed'),
            lambda env, seen: [int(seen[2] + 0.5 * seen[3] > 0)],
            lambda env, seen: abs(seen[2]) < 0.02 and abs(seen[3]) < 0.2,
        ),
    ),
}
