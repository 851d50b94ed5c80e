"""A player: sends commands, and sees what the game does with them."""

import itertools
from typing import Any

from humanopts_interfaces.msg import (
    ActionCommand,
    ActionRefusal,
    ControlState,
    GameState,
    NodeStatus,
)
from humanopts_interfaces.srv import ResetGame, SetControl
from humanopts_ros.qos import CURRENT, LATCHED, STREAM

from graph_support.live import Graph

_RENEWAL = 0.4  # s
PERSON, MACHINE = ActionCommand.SOURCE_PERSON, ActionCommand.SOURCE_MACHINE
ME = '/person#1'  # the test's node is called person, so game takes it for a terminal that is there


class Player:
    """A client of one game."""

    def __init__(self, graph: Graph, namespace: str = '') -> None:
        self._graph, self._namespace = graph, namespace
        self._sequence = itertools.count(1)
        self.states: list[GameState] = graph.listen(GameState, f'{namespace}/game_state')
        self.refusals: list[ActionRefusal] = graph.listen(
            ActionRefusal, f'{namespace}/action_refused'
        )
        self.controls: list[ControlState] = graph.listen(
            ControlState, f'{namespace}/control', CURRENT
        )
        self.renewals = 0  # of this player's control
        self._status = graph.node.create_publisher(NodeStatus, f'{namespace}/node_status', LATCHED)
        graph.node.create_timer(_RENEWAL, self._renew)
        self._keys = graph.node.create_publisher(ActionCommand, f'{namespace}/action', STREAM)
        graph.until(self._keys.get_subscription_count, 'game to listen')
        graph.until(lambda: self.controls and self._hears(), 'game to be heard')

    @property
    def state(self) -> GameState:
        """The newest state."""
        return self.states[-1]

    def reset(self, start_state: str = '', seed: int = 0, source: int = PERSON) -> Any:
        """Begin an episode; return the answer, once the first state is here if there is one."""
        reply = self._graph.ask(
            ResetGame,
            f'{self._namespace}/reset_game',
            source=source,
            start_state=start_state,
            seed=seed,
        )
        if reply.status == ResetGame.Response.STATUS_OK:
            self._graph.until(
                lambda: self.states and self.state.episode >= reply.episode, 'the first state'
            )
        return reply

    def fresh(self, start_state: str = '') -> GameState:
        """Begin an episode with control free; return its first state."""
        if self.controls[-1].holder:
            self.hold(False, self.controls[-1].holder_id)
        self.reset(start_state)
        return self.state

    def hold(self, hold: bool, holder_id: str = ME) -> Any:
        """Take control or give it back; return the answer, once the change is here."""
        before = len(self.controls)
        reply = self._graph.ask(
            SetControl, f'{self._namespace}/set_control', hold=hold, holder_id=holder_id
        )
        if reply.status == reply.STATUS_OK and reply.detail != 'nothing changed':
            self._graph.until(lambda: len(self.controls) > before, 'the change of control')
        return reply

    def command(self, action: str, source: int = MACHINE, **fields: Any) -> ActionCommand:
        """Return a command that answers the newest state, unless ``fields`` say otherwise."""
        own = {'episode': self.state.episode, 'step': self.state.step, 'publisher_id': ME}
        sequence = next(self._sequence)
        return ActionCommand(
            **{'sequence': sequence, **own, **fields}, source=source, action=action
        )

    def send(self, command: ActionCommand) -> None:
        """Publish a command."""
        self._keys.publish(command)

    def do(self, action: str, source: int = MACHINE, **fields: Any) -> Any:
        """Send a command; return what came of it, a GameState or an ActionRefusal."""
        command = self.command(action, source, **fields)
        known = len(self.states), len(self.refusals)
        self.send(command)
        answers: list[Any] = []

        def answered() -> bool:
            moved = [s for s in self.states[known[0] :] if _led_by(s, command)]
            refused = [r for r in self.refusals[known[1] :] if _of(r, command)]
            answers[:] = moved + refused
            return bool(answers)

        self._graph.until(answered, f'an answer to {action}')
        if source == PERSON and isinstance(answers[0], GameState):
            self._graph.until(lambda: self.controls[-1].holder, 'control, which comes apart')
        return answers[0]

    def _renew(self) -> None:
        """Renew control, as a terminal does, where this player holds it or supervises."""
        control = self.controls[-1] if self.controls else ControlState()
        if ME in (control.holder_id, control.supervisor_id):
            self.renewals += 1
            self._status.publish(
                NodeStatus(publisher_id=ME, node='/person', state=NodeStatus.STATE_READY)
            )

    def _hears(self) -> bool:
        """Make the game publish, and return whether it was received."""
        self._graph.ask(ResetGame, f'{self._namespace}/reset_game', source=PERSON)
        return bool(self.states)


def _led_by(state: GameState, command: ActionCommand) -> bool:
    made = (state.action_publisher_id, state.action_sequence)
    return made == (command.publisher_id, command.sequence)


def _of(refusal: ActionRefusal, command: ActionCommand) -> bool:
    about = (refusal.command_publisher_id, refusal.command_sequence)
    return about == (command.publisher_id, command.sequence)
