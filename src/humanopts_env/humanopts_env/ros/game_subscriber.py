"""A node's view of the game in its namespace: only messages from the game are accepted."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from humanopts_env.domains.base import ActableDomain
from humanopts_env.domains.described import can_simulate
from humanopts_env.domains.registry import parameters_json
from humanopts_env.game import (
    check_transition,
    MAX_PERIOD,
    Transition,
    transition_from_message,
)
from humanopts_env.ros.convert import domain_from_info
from humanopts_interfaces.msg import ActionRefusal, ControlState, DomainInfo, GameState
from humanopts_ros.limits import shown
from humanopts_ros.node_base import NodeBase
from humanopts_ros.peers import GameIdentity
from humanopts_ros.polled import PolledValue
from humanopts_ros.qos import CURRENT, STREAM
from humanopts_ros.senders import signer
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

T = TypeVar('T')
V = TypeVar('V')


@dataclass(frozen=True, slots=True)
class Observed:
    """One state of the game, checked against its rules."""

    publisher_id: str  # of the game; changes when the game is restarted
    transition: Transition
    state: Any  # decoded; None before the first episode
    stamp: tuple[int, int]  # time of publication, s and ns


class GameSubscriber:
    """
    The game in a node's namespace, identified by its announcement.

    A message is refused if it comes from another publisher, announces a game other than the known
    one, or breaks the rules of the game.

    :ivar domain: domain of the game; None if not announced yet.
    :ivar game: identity of the game.
    """

    def __init__(self, node: NodeBase, on_domain: Callable[[ActableDomain], object]) -> None:
        """
        Subscribe to ``domain_info``.

        :param on_domain: callback for the domain, called once.
        """
        self.domain: ActableDomain | None = None
        self.game = GameIdentity(node)
        self._node, self._on_domain = node, on_domain
        self._early: dict[str, Callable[[], object]] = {}  # use of the newest message, by topic
        self._domain_info = self.subscribe(
            DomainInfo, 'domain_info', self._read_domain, self._use_domain, CURRENT
        )

    def subscribe(
        self,
        kind: type[T],
        topic: str,
        read: Callable[[T], V | None],
        use: Callable[[V], object],
        qos: QoSProfile = STREAM,
    ) -> Subscription:
        """Subscribe to a topic of the game; see ``NodeBase`` for ``read`` and ``use``."""

        def read_of_game(message: Any) -> V | None:
            self._check_sender(message)
            return read(message)

        return self._node.subscribe(kind, topic, read_of_game, use, qos)

    def follow(
        self, topic: str, use: Callable[[Observed], object], qos: QoSProfile = STREAM
    ) -> Subscription:
        """
        Subscribe to the states of the game on a topic.

        :param use: callback for each state; before the domain is known, only the last is kept.
        """

        def read(message: GameState) -> Observed | None:
            if self.domain is None:
                self._early[topic] = partial(use_early, message)
                return None
            return self.observe(message)

        def use_early(message: GameState) -> None:
            observed = self._node.accepted(topic, self.observe, message)
            if observed is not None:
                use(observed)

        return self.subscribe(GameState, topic, read, use, qos)

    def newest(self) -> PolledValue[GameState, Observed]:
        """Return the newest state for polling; it can be read once the domain is known."""
        return PolledValue(self._node, GameState, 'current_state', self.observe)

    def observe(self, message: GameState) -> Observed:
        """
        Check a state of the game.

        :raises ValueError: the state is invalid.
        """
        self._check_sender(message)
        assert self.domain is not None, 'states are read once the rules are known'
        transition = transition_from_message(message)
        state = check_transition(transition, self.domain)
        stamp = message.header.stamp
        return Observed(message.publisher_id, transition, state, (stamp.sec, stamp.nanosec))

    def follow_control(self, use: Callable[[ControlState], object]) -> Subscription:
        """Subscribe to the control of the game and the pace of the machine."""

        def read(message: ControlState) -> ControlState:
            if not 0.0 <= message.step_period <= MAX_PERIOD:
                raise ValueError(f'its step_period is {message.step_period}')
            return message

        return self.subscribe(ControlState, 'control', read, use, CURRENT)

    def follow_refusals(
        self, use: Callable[[ActionRefusal], object], qos: QoSProfile = STREAM
    ) -> Subscription:
        """Subscribe to the refusals of the game."""
        return self.subscribe(ActionRefusal, 'action_refused', lambda message: message, use, qos)

    def unsubscribe(self) -> None:
        """Unsubscribe from ``domain_info``."""
        self._node.destroy_subscription(self._domain_info)

    @property
    def name(self) -> str:
        """Name of the game's node without its namespace; empty if not found yet."""
        return signer(self.game.publisher_id).rpartition('/')[2]

    def _check_sender(self, message: Any) -> None:
        """
        Check that a message comes from the game.

        :raises ValueError: the message comes from another publisher.
        """
        if not self.game.accepts(message.publisher_id):
            game = self.game.publisher_id
            unknown = 'no game on the graph has this publisher_id'
            raise ValueError(f'it is not from {game}' if game else unknown)

    def _read_domain(self, info: DomainInfo) -> ActableDomain:
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
        if not can_simulate(known) and domain != known:  # its file was changed
            raise ValueError(
                f'the features or actions of {known.name} have changed: start its nodes again'
            )
        return known

    def _use_domain(self, domain: ActableDomain) -> None:
        if self.domain is not None:
            return
        self.domain = domain
        if not can_simulate(domain):
            self._node.get_logger().info(
                f'{domain.name} is not installed here, so it cannot be simulated'
            )
        self._on_domain(domain)
        for use_early in self._early.values():
            use_early()
