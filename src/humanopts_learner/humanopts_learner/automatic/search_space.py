"""The search space of subgoals in any domain."""

from typing import Any

from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_env.domains.capabilities import HasSearchSpace
from humanopts_env.domains.search_space import SearchSpace, space_of_states
from humanopts_learner.planning.errors import NotEnumerableError


def search_space(domain: Domain[Any]) -> SearchSpace:
    """
    Return the search space that the domain defines, else all of its states.

    :raises NotEnumerableError: the domain defines none, and its states cannot all be listed.
    """
    if isinstance(domain, HasSearchSpace):
        return domain.search_space()
    if is_enumerable(domain):
        return space_of_states(domain)
    raise NotEnumerableError(
        f'the states of {domain.name} cannot all be listed, so no tasks can be set in it'
    )
