"""Who acted in the episodes of a bag, and how each episode was begun."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from humanopts_env.game import Moment, Source
from humanopts_teach.bags.reader import Bag, Recorded

ACTION_COMMAND = 'humanopts_interfaces/msg/ActionCommand'
RESET_EVENT = 'humanopts_interfaces/srv/ResetGame_Event'
_REQUEST, _RESPONSE = 1, 2  # ServiceEventInfo: REQUEST_RECEIVED, RESPONSE_SENT; of the server
_EVENTS = '/reset_game/_service_event'

Actors = dict[tuple[str, int], str]  # by publisher and number of the command


@dataclass(frozen=True)
class Beginning:
    """What reset_game was asked when an episode was begun."""

    seed: int  # of the start state, where it is drawn, and of the chance in the episode
    start_state: str  # empty: it was drawn by the seed


def namespace(topic: str) -> str:
    """Return what stands before the last part of a name."""
    return topic.rpartition('/')[0]


def read_actors(bag: Bag) -> Actors:
    """Return whose each command was: an option, or action:NAME; empty: a person's."""
    return {
        (command.publisher_id, command.sequence): getattr(command, 'option_name', '')
        for recorded in _of_type(bag, ACTION_COMMAND)
        if (command := recorded.message) is not None
    }


def actor_of(moment: Moment, actors: Actors) -> str:
    """Return the option or action:NAME whose action led to a moment; empty: a person's."""
    return actors.get((moment.action_publisher_id, moment.action_sequence), '')


def source_of(moment: Moment) -> str:
    """Return who chose the action that led to a moment, in a word; empty: nobody."""
    return '' if moment.action_source is Source.NONE else moment.action_source.name.lower()


def read_beginnings(bag: Bag) -> dict[tuple[str, int, str], Beginning]:
    """Return how episodes were begun, by namespace, number and first state, where it is known."""
    asked: dict[tuple[Any, ...], Any] = {}
    found = {}
    for recorded in _of_type(bag, RESET_EVENT):
        if (event := recorded.message) is None:
            continue
        call = (recorded.topic, tuple(event.info.client_gid), event.info.sequence_number)
        if event.info.event_type == _REQUEST and event.request:
            asked[call] = event.request[0]
        elif event.info.event_type == _RESPONSE and event.response and call in asked:
            request, answer = asked.pop(call), event.response[0]
            key = (recorded.topic.removesuffix(_EVENTS), answer.episode, answer.state)
            found[key] = Beginning(int(request.seed), request.start_state)
    return found


def _of_type(bag: Bag, type_name: str) -> Iterable[Recorded]:
    topics = bag.of_type(type_name)
    return bag.messages(topics) if topics else ()
