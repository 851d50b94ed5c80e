"""A world that moves continuously: a boat on a lake; its states cannot be listed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import re

from humanopts_env.domains.base import (
    Action,
    Domain,
    DomainError,
    Feature,
    Outcome,
    Parameter,
    StateError,
)
import numpy as np
from numpy.typing import NDArray

LENGTH, WIDTH = 10.0, 6.0  # m
LEAST, MOST = 0.8, 1.2  # m, that a stroke of the oars moves the boat
SHORE, JETTY = 2.0, 1.5  # m from the west; m from the west and from the south
STEPS = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
STATE = re.compile(r'boat (\S+),(\S+) (calm|windy)')
WIND = ('calm', 'windy')


@dataclass(frozen=True, slots=True)
class LakeState:
    """Where the boat is, in m from the south-west corner."""

    x: float
    y: float
    wind: str = 'calm'


class Lake:
    """Row to the jetty in the south-west corner; a stroke moves the boat by about 1 m."""

    name = 'lake'
    features: Sequence[Feature] = (
        Feature.continuous('x', 'how far east the boat is', 0.0, LENGTH, 'm'),
        Feature.continuous('y', 'how far north the boat is', 0.0, WIDTH, 'm'),
        Feature.nominal('wind', 'whether it is windy', WIND),
    )
    actions = (
        Action('east', 'right', 'row east'),
        Action('west', 'left', 'row west'),
        Action('north', 'up', 'row north'),
        Action('south', 'down', 'row south'),
    )
    gamma = 0.95
    max_steps = 200

    def __init__(self) -> None:
        """Have no parameters."""
        self.parameters: dict[str, Parameter] = {}

    def reset(self, rng: np.random.Generator) -> LakeState:
        return self.sample_states(rng, 1)[0]

    def step(self, state: LakeState, action: int, rng: np.random.Generator) -> Outcome[LakeState]:
        if not 0 <= action < len(STEPS):
            raise DomainError(f'lake has no action {action}')
        if self.is_over(state):
            raise DomainError('the boat is at the jetty')
        after = _moved(state, action, rng.uniform(LEAST, MOST))
        return Outcome(after, -1.0, self.is_over(after))

    def is_over(self, state: LakeState) -> bool:
        return state.x <= JETTY and state.y <= JETTY

    def can_follow(self, state: LakeState, action: int, successor: LakeState) -> bool:
        if self.is_over(state) or not 0 <= action < len(STEPS):
            return False
        near, far = (_moved(state, action, stroke) for stroke in (LEAST, MOST))
        return state.wind == successor.wind and all(
            min(ends) - 1e-9 <= at <= max(ends) + 1e-9
            for at, *ends in ((successor.x, near.x, far.x), (successor.y, near.y, far.y))
        )

    def feature_values(self, state: LakeState) -> NDArray[np.float64]:
        return np.array([state.x, state.y, WIND.index(state.wind)], dtype=np.float64)

    def encode(self, state: LakeState) -> str:
        return f'boat {state.x!r},{state.y!r} {state.wind}'

    def decode(self, text: str) -> LakeState:
        try:
            x, y, wind = STATE.fullmatch(text).groups()  # type: ignore[union-attr]
            state = LakeState(float(x), float(y), wind)
        except (AttributeError, ValueError):
            raise StateError(f'{text!r} is not a state of lake') from None
        inside = 0 <= state.x <= LENGTH and 0 <= state.y <= WIDTH
        if not inside or self.encode(state) != text:
            raise StateError(f'{text!r} is not a state of lake')
        return state

    def sample_states(self, rng: np.random.Generator, count: int) -> list[LakeState]:
        found: list[LakeState] = []
        while len(found) < count:
            x, y = (float(value) for value in rng.uniform((0, 0), (LENGTH, WIDTH)))
            state = LakeState(x, y, WIND[rng.integers(2)])
            if not self.is_over(state):
                found.append(state)
        return found


def _moved(state: LakeState, action: int, stroke: float) -> LakeState:
    dx, dy = STEPS[action]
    return replace(
        state,
        x=min(max(state.x + dx * stroke, 0.0), LENGTH),
        y=min(max(state.y + dy * stroke, 0.0), WIDTH),
    )


class ToTheWestShore:
    """An option that depends on one continuous feature."""

    name = 'row to the west shore'
    features = ('x',)
    definition = 'Starts away from the west shore; rows west; ends within 2 m of it.'

    def can_start(self, state: LakeState) -> bool:
        return state.x > SHORE

    def ends(self, state: LakeState) -> bool:
        return not self.can_start(state)

    def optimal_actions(self, state: LakeState) -> tuple[int, ...]:
        return (1,) if self.can_start(state) else ()


def reference_options(domain: Domain[LakeState]) -> dict[str, ToTheWestShore]:
    """Return the options by name."""
    return {ToTheWestShore.name: ToTheWestShore()}
