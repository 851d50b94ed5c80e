"""What a node reads of the game: one game in a namespace, and only what the game itself sends."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import parameters_json
from humanopts_env.game import (
    check_transition,
    LONGEST_PERIOD,
    Transition,
    transition_from_message,
)
from humanopts_env.ros.convert import domain_from_info
from humanopts_interfaces.msg import ActionRefusal, ControlState, DomainInfo, GameState
from humanopts_ros.graph import node_names, serves
from humanopts_ros.limits import shown
from humanopts_ros.node_base import NodeBase
from humanopts_ros.polled import PolledValue
from humanopts_ros.qos import CURRENT, STREAM
from humanopts_ros.senders import check_sender, GAME_SERVICE, signer
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

_LOOK_PERIOD = 0.1  # s between looks which node serves the game, while none is known
_LATE = 5.0  # s after which a node is named that announces a game and does not serve it
_MAX_EARLY = 100  # messages that are kept until the game is known
T = TypeVar('T')
V = TypeVar('V')


@dataclass(frozen=True, slots=True)
class Observed:
    """One state of the game that was checked against its rules."""

    publisher_id: str  # of the game; another one after it was started again
    transition: Transition
    state: Any  # decoded; None before the first episode


class GameSubscriber:
    """
    The game of a node's namespace, as it announces itself.

    The game is the node that serves ``reset_game`` in the namespace, whatever its name. It stays
    the game as long as it is on the graph; a node of another name may take its place after that.
    Messages that come before it is found are kept until then. A message is refused if another
    node has published it, if it announces another game than the one that is known, or if it breaks
    the rules of the game.

    :ivar domain: the rules; None: the game has not announced itself.
    :ivar node: full name of the game's node; empty: it is not found yet.
    """

    def __init__(self, node: NodeBase, on_domain: Callable[[Domain[Any]], object]) -> None:
        """
        Subscribe to ``domain_info``.

        :param on_domain: called once, with the rules.
        """
        self.domain: Domain[Any] | None = None
        self.node = ''
        self._node, self._on_domain = node, on_domain
        # Messages that came too early, each with what is called with it: the newest by topic and
        # publisher. Before the rules are known, states are of no use.
        self._early: dict[tuple[str, str], tuple[Any, Callable[[Any], object]]] = {}
        self._named: set[str] = set()  # nodes that were refused for not serving the game
        self._begun = node.monotonic()
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
        """Subscribe to a topic of the game; ``read`` and ``use`` are as of ``NodeBase``."""

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

        :param use: called with each; where states come before the rules, with the last of these.
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
        """Return the newest state for polling; it can be read once the rules are known."""
        return PolledValue(self._node, GameState, 'current_state', self.observe)

    def observe(self, message: GameState) -> Observed:
        """
        Check a state of the game.

        :raises ValueError: it cannot be used.
        """
        if not self._is_game(message.publisher_id):
            raise ValueError('no game is known yet')
        assert self.domain is not None, 'states are read once the rules are known'
        transition = transition_from_message(message)
        state = check_transition(transition, self.domain)
        return Observed(message.publisher_id, transition, state)

    def follow_control(self, use: Callable[[ControlState], object]) -> Subscription:
        """Subscribe to who holds control, and to the pace of the machine."""

        def read(message: ControlState) -> ControlState:
            if not 0.0 <= message.step_period <= LONGEST_PERIOD:
                raise ValueError(f'its step_period is {message.step_period}')
            return message

        return self.subscribe(ControlState, 'control', read, use, CURRENT)

    def follow_refusals(
        self, use: Callable[[ActionRefusal], object], qos: QoSProfile = STREAM
    ) -> Subscription:
        """Subscribe to the commands that the game refuses."""
        return self.subscribe(ActionRefusal, 'action_refused', lambda message: message, use, qos)

    def unsubscribe(self) -> None:
        """Stop following ``domain_info``."""
        self._node.destroy_subscription(self._domain_info)

    @property
    def name(self) -> str:
        """Name of the game's node, without its namespace; empty: it is not found yet."""
        return self.node.rpartition('/')[2]

    def is_there(self) -> bool:
        """Return whether the node of the game is on the graph."""
        return self.node in node_names(self._node)

    def _is_game(self, publisher_id: str) -> bool:
        """
        Return whether a message is from the game; False: the game is not found yet.

        :raises ValueError: it is from another node.
        """
        sender = signer(publisher_id)
        if sender and sender == self.node:
            return True
        if self.node and self.is_there():
            check_sender(publisher_id, self.node)
        elif serves(self._node, sender, GAME_SERVICE):
            self.node = sender
            return True
        return False  # its service may be found later

    def _keep(self, topic: str, message: Any, use: Callable[[Any], object]) -> None:
        """Keep a message until the game and its rules are known."""
        if len(self._early) >= _MAX_EARLY:
            self._early.pop(next(iter(self._early)))
        self._early.pop((topic, message.publisher_id), None)
        self._early[topic, message.publisher_id] = message, use
        if self._look_timer.is_canceled():
            self._look_timer.reset()

    def _look(self) -> None:
        """Find the game among the nodes that have announced one, and use what came early."""
        early, self._early = self._early, {}
        self._look_timer.cancel()
        for (topic, publisher_id), (message, use) in early.items():
            use(message)
            waits = (topic, publisher_id) in self._early
            late = self._node.monotonic() - self._begun > _LATE
            if waits and not self.node and late and self._is_news(publisher_id):
                reason = f'{shown(signer(publisher_id), 80)} does not serve {GAME_SERVICE}'
                self._node.refuse(topic, message, f'{reason}, so it is not the game')

    def _is_news(self, publisher_id: str) -> bool:
        """Return whether a publisher was not named yet; of very many, only the first are."""
        before = len(self._named)
        if before < _MAX_EARLY:
            self._named.add(publisher_id)
        return len(self._named) > before

    def _read_domain(self, info: DomainInfo) -> Domain[Any]:
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
        self._look()
