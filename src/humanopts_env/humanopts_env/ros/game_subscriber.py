"""What a node reads of the game: one game in a namespace, and only what the game itself sends."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import parameters_json
from humanopts_env.game import (
    check_transition,
    LONGEST_PERIOD,
    Transition,
    transition_from_message,
)
from humanopts_env.ros.convert import domain_from_info
from humanopts_interfaces.msg import ControlState, DomainInfo, GameState
from humanopts_ros.limits import shown
from humanopts_ros.node_base import NodeBase
from humanopts_ros.polled import PolledValue
from humanopts_ros.qos import CURRENT, STREAM
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

GAME = 'game'  # name of the node


@dataclass(frozen=True, slots=True)
class Observed:
    """One state of the game that was checked against its rules."""

    publisher_id: str  # of the game; another one after it was started again
    transition: Transition
    state: Any  # decoded; None before the first episode


class GameSubscriber:
    """
    The game of a node's namespace, as it announces itself.

    A message is refused if another node than ``game`` of the namespace has published it, if it
    announces another game than the one that is known, or if it breaks the rules of the game.

    :ivar domain: the rules; None: the game has not announced itself.
    """

    def __init__(self, node: NodeBase, on_domain: Callable[[Domain[Any]], object]) -> None:
        """
        Subscribe to ``domain_info``.

        :param on_domain: called once, with the rules.
        """
        self.domain: Domain[Any] | None = None
        self._node, self._on_domain = node, on_domain
        self._early: dict[str, tuple[GameState, Callable[[Observed], object]]] = {}  # by topic
        self._domain_info = node.subscribe(
            DomainInfo, 'domain_info', self._read_domain, self._use_domain, CURRENT
        )

    def follow(
        self, topic: str, use: Callable[[Observed], object], qos: QoSProfile = STREAM
    ) -> Subscription:
        """
        Subscribe to the states of the game on a topic.

        :param use: called with each; where states come before the rules, with the last of these.
        """

        def read(message: GameState) -> Observed | None:
            if self.domain is None:
                self._early[topic] = message, use
                return None
            return self.observe(message)

        return self._node.subscribe(GameState, topic, read, use, qos)

    def newest(self) -> PolledValue[GameState, Observed]:
        """Return the newest state for polling; it can be read once the rules are known."""
        return PolledValue(self._node, GameState, 'current_state', self.observe)

    def observe(self, message: GameState) -> Observed:
        """
        Check a state of the game.

        :raises ValueError: it cannot be used.
        """
        self._node.check_sender(message.publisher_id, GAME)
        assert self.domain is not None, 'states are read once the rules are known'
        transition = transition_from_message(message)
        state = check_transition(transition, self.domain)
        return Observed(message.publisher_id, transition, state)

    def follow_control(self, use: Callable[[ControlState], object]) -> Subscription:
        """Subscribe to who holds control, and to the pace of the machine."""

        def read(message: ControlState) -> ControlState:
            self._node.check_sender(message.publisher_id, GAME)
            if not 0.0 <= message.step_period <= LONGEST_PERIOD:
                raise ValueError(f'its step_period is {message.step_period}')
            return message

        return self._node.subscribe(ControlState, 'control', read, use, CURRENT)

    def unsubscribe(self) -> None:
        """Stop following ``domain_info``."""
        self._node.destroy_subscription(self._domain_info)

    def _read_domain(self, info: DomainInfo) -> Domain[Any]:
        self._node.check_sender(info.publisher_id, GAME)
        domain = domain_from_info(info)
        known = self.domain
        if known is None:
            return domain
        played, announced = ((d.name, parameters_json(d)) for d in (known, domain))
        if played != announced:
            raise ValueError(
                f'it announces the game {shown(" ".join(announced))}, and this namespace plays '
                f'{" ".join(played)}: stop all its nodes first, or choose another namespace'
            )
        return known

    def _use_domain(self, domain: Domain[Any]) -> None:
        if self.domain is not None:
            return
        self.domain = domain
        self._on_domain(domain)
        early, self._early = self._early, {}
        for topic, (message, use) in early.items():
            observed = self._node.accepted(topic, self.observe, message)
            if observed is not None:
                use(observed)
