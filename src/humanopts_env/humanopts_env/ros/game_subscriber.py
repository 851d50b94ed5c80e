"""A node's view of the game in its namespace: only messages from the game are accepted."""

from collections.abc import Callable
from dataclasses import dataclass
import math
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
from humanopts_ros.peers import stated_ids
from humanopts_ros.polled import PolledValue
from humanopts_ros.qos import CURRENT, STREAM
from humanopts_ros.senders import is_next_game, signer
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

_LOOK_PERIOD = 0.1  # s between checks of the graph while messages wait for their game
_LATE = 5.0  # s until a publisher not listed as a game is reported
_MAX_EARLY = 100  # waiting messages, and reported publishers
_UNLISTED = 'no game on the graph has this publisher_id'
T = TypeVar('T')
V = TypeVar('V')


@dataclass(frozen=True, slots=True)
class Observed:
    """One state of the game, checked against its rules."""

    publisher_id: str  # of the game; changes when the game is restarted
    transition: Transition
    state: Any  # decoded; None before the first episode


class GameSubscriber:
    """
    The game in a node's namespace, identified by its announcement.

    A game publishes its id in the graph, whatever its node name; a message belongs to the game if
    it carries this id. The game may be restarted with another id. A node with another name may
    replace it once it is gone. Messages from a publisher that the graph does not list yet are kept
    for a while. A message is refused if it comes from another publisher, announces another game
    than the known one, or breaks the rules of the game.

    :ivar domain: the rules; None: the game is not announced yet.
    :ivar publisher_id: publisher id of the game; empty: not found yet.
    """

    def __init__(self, node: NodeBase, on_domain: Callable[[ActableDomain], object]) -> None:
        """
        Subscribe to ``domain_info``.

        :param on_domain: called once, with the rules.
        """
        self.domain: ActableDomain | None = None
        self.publisher_id = ''
        self._node, self._on_domain = node, on_domain
        # The newest early message per topic and publisher, and the function that reads it again
        # once the game and its rules are known.
        self._early: dict[tuple[str, str], tuple[Any, Callable[[Any], object]]] = {}
        # Start time of waiting for a publisher to be listed as a game, s; -inf: already reported.
        self._unlisted: dict[str, float] = {}
        self._look_timer = node.create_timer(_LOOK_PERIOD, self._look, autostart=False)
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

        def again(message: T) -> None:
            value = self._node.accepted(topic, read_of_game, message)
            if value is not None:
                use(value)

        def read_of_game(message: Any) -> V | None:
            if not self._is_game(message.publisher_id):
                self._keep(topic, message, again)
                return None
            return read(message)

        return self._node.subscribe(kind, topic, read_of_game, use, qos)

    def follow(
        self, topic: str, use: Callable[[Observed], object], qos: QoSProfile = STREAM
    ) -> Subscription:
        """
        Subscribe to the states of the game on a topic.

        :param use: called with each state; of the states before the rules, with the last one.
        """

        def again(message: GameState) -> None:
            observed = self._node.accepted(topic, self.observe, message)
            if observed is not None:
                use(observed)

        def read(message: GameState) -> Observed | None:
            if self.domain is None:
                self._keep(topic, message, again)
                return None
            return self.observe(message)

        return self.subscribe(GameState, topic, read, use, qos)

    def newest(self) -> PolledValue[GameState, Observed]:
        """Return the newest state for polling, readable once the rules are known."""
        return PolledValue(self._node, GameState, 'current_state', self.observe)

    def observe(self, message: GameState) -> Observed:
        """
        Check a state of the game.

        :raises ValueError: it cannot be used.
        """
        if not self._is_game(message.publisher_id):
            raise ValueError(_UNLISTED)
        assert self.domain is not None, 'states are read once the rules are known'
        transition = transition_from_message(message)
        state = check_transition(transition, self.domain)
        return Observed(message.publisher_id, transition, state)

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
        """Name of the game's node without its namespace; empty: not found yet."""
        return signer(self.publisher_id).rpartition('/')[2]

    def _is_game(self, publisher_id: str) -> bool:
        """
        Return whether a message comes from the game; False: the graph may list it later.

        :raises ValueError: it comes from another publisher.
        """
        if publisher_id and publisher_id == self.publisher_id:
            return True
        stated = stated_ids(self._node, 'game')
        if is_next_game(publisher_id, self.publisher_id, stated):
            self._unlisted.pop(publisher_id, None)
            self.publisher_id = publisher_id
            return True
        other_node = signer(publisher_id) != signer(self.publisher_id)
        stranger = other_node or self._unlisted.get(publisher_id) == -math.inf
        if stranger and self.publisher_id in stated:
            raise ValueError(f'it is not from {self.publisher_id}')
        if len(self._unlisted) < _MAX_EARLY:
            self._unlisted.setdefault(publisher_id, self._node.monotonic())
        return False

    def _keep(self, topic: str, message: Any, use: Callable[[Any], object]) -> None:
        """Keep a message until the game and its rules are known."""
        if len(self._early) >= _MAX_EARLY:
            self._early.pop(next(iter(self._early)))
        self._early.pop((topic, message.publisher_id), None)
        self._early[topic, message.publisher_id] = message, use
        if self._look_timer.is_canceled():
            self._look_timer.reset()

    def _look(self) -> None:
        """Read early messages again; report publishers that stay unlisted."""
        early, self._early = self._early, {}
        self._look_timer.cancel()
        now = self._node.monotonic()
        for (topic, publisher_id), (message, use) in early.items():
            use(message)
            waited = now - self._unlisted.get(publisher_id, math.inf)
            if (topic, publisher_id) in self._early and _LATE < waited < math.inf:
                self._unlisted[publisher_id] = -math.inf
                if self.publisher_id:
                    del self._early[topic, publisher_id]
                self._node.refuse(topic, message, _UNLISTED)

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
        return known

    def _use_domain(self, domain: ActableDomain) -> None:
        if self.domain is not None:
            return
        self.domain = domain
        if not can_simulate(domain):
            self._node.get_logger().info(
                f'{domain.name} is not installed here, so it can only be acted in'
            )
        self._on_domain(domain)
        self._look()
