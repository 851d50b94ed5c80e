"""The study's data in a bag: its domain and the demonstrations."""

from typing import Any

from humanopts_env.domains.base import Domain, DomainError
from humanopts_env.domains.registry import domain_from_json
from humanopts_learner.demonstrations import (
    Demonstration,
    demonstration_from_message,
    DemonstrationError,
)
from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.reader import Bag

DEMONSTRATION = 'humanopts_interfaces/msg/Demonstration'
DOMAIN_INFO = 'humanopts_interfaces/msg/DomainInfo'


def read_demonstrations(bag: Bag) -> list[Demonstration]:
    """
    Return the demonstrations in a bag as they were published, repetitions included.

    One that is none (its kind is unknown) is left out and noted in ``bag.damage``. Whether the
    others can be used is for ``check_demonstration`` to say, as it is live.

    :raises BagError: the bag has no topic of demonstrations.
    """
    topics = bag.of_type(DEMONSTRATION)
    if not topics:
        raise BagError(f'{bag.path} has no topic of demonstrations')
    found = []
    for recorded in bag.messages(topics):
        if recorded.message is not None:
            with bag.taking(recorded.topic):
                try:
                    found.append(demonstration_from_message(recorded.message))
                except DemonstrationError as error:
                    bag.note(f'a message on {recorded.topic} is left out: {error}')
    return found


def read_domain(bag: Bag) -> Domain[Any]:
    """
    Return the domain that was played.

    :raises BagError: the bag does not say, or says several, or it is not installed here.
    """
    found = set()
    for recorded in bag.messages(bag.of_type(DOMAIN_INFO)):
        if (info := recorded.message) is not None:
            with bag.taking(recorded.topic):
                found.add((info.domain, info.parameters))
    played = sorted(found)
    if not played:
        reasons = '; '.join(['no domain_info', *bag.damage.splitlines()])
        raise BagError(f'{bag.path} does not say which domain was played ({reasons})')
    if len(played) > 1:
        names = ', '.join(f'{name} {parameters}' for name, parameters in played)
        raise BagError(f'{bag.path} holds games of several domains: {names}')
    try:
        return domain_from_json(*played[0])
    except DomainError as error:
        raise BagError(f'{bag.path}: {error}') from error
