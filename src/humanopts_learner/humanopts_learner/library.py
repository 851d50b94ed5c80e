"""Everything that can be run in a domain: learned options and primitive actions."""

from collections.abc import Iterable

from humanopts_env.domains.base import ActableDomain
from humanopts_learner.demonstrations import PRIMITIVE_PREFIX
from humanopts_learner.option import PrimitiveOption
from humanopts_learner.options.learned_option import LearnedOption, OptionError
from humanopts_ros.limits import composed


class UnknownOptionError(ValueError):
    """No option, or none of this participant, has this name; the text lists the options."""


class AmbiguousOptionError(UnknownOptionError):
    """Several participants taught an option of this name, and none of them was named."""


def taught_nothing(participant: str, others: Iterable[str]) -> str:
    """
    Say that a participant has no options, and list the participants that have some.

    :param others: the participants of all options that there are.
    """
    known = ', '.join(sorted(set(others))) or 'none'
    return f'{participant!r} taught no option; those who did: {known}'


RunnableOption = LearnedOption | PrimitiveOption


class OptionLibrary:
    """
    The learned options of one domain by participant and name, beside its primitive actions.

    :ivar domain: in which the options act.
    """

    def __init__(self, domain: ActableDomain) -> None:
        self.domain = domain
        names = [PRIMITIVE_PREFIX + action.name for action in domain.actions]
        self._primitives = {
            name: PrimitiveOption(name, index, len(names)) for index, name in enumerate(names)
        }
        self._options: dict[tuple[str, str], LearnedOption] = {}

    @property
    def primitive_names(self) -> list[str]:
        """``action:NAME`` of every primitive action, in the domain's order."""
        return list(self._primitives)

    def options(self, participant: str = '') -> list[LearnedOption]:
        """Return the learned options of a participant, or of all participants, by name."""
        found = [o for o in self._options.values() if participant in ('', o.participant)]
        return sorted(found, key=lambda option: (option.name, option.participant))

    def replace(self, options: Iterable[LearnedOption]) -> list[str]:
        """
        Replace the options by those of the given ones that can be run here.

        :return: why others cannot: they were learned in another domain, or are named like actions.
        """
        self._options, faults = {}, []
        for option in options:
            try:
                option.check_domain(self.domain)
            except OptionError as error:
                faults.append(str(error))
                continue
            if option.name.startswith(PRIMITIVE_PREFIX):
                faults.append(f'{option.name!r} is the name of a primitive action')
            else:
                self._options[option.participant, option.name] = option
        return faults

    def resolve(self, name: str, participant: str = '') -> RunnableOption:
        """
        Return the option of a name.

        :param name: of a learned option, or ``action:NAME`` of a primitive action.
        :param participant: who taught it; empty: the only one who did.
        :raises UnknownOptionError: no option has this name.
        :raises AmbiguousOptionError: several participants taught it and none is given.
        """
        name = composed(name)
        if name in self._primitives:
            return self._primitives[name]
        found = [option for option in self.options(participant) if option.name == name]
        if len(found) == 1:
            return found[0]
        if found:
            who = ', '.join(option.participant for option in found)
            raise AmbiguousOptionError(
                f'option {name!r} was taught by {who}: name the participant'
            )
        owner = f' of participant {participant!r}' if participant else ''
        there = [f'{option.name!r} ({option.participant})' for option in self.options()]
        known = ', '.join([*there, *self._primitives])
        raise UnknownOptionError(f'unknown option {name!r}{owner}; choose from {known}')
