"""The runnable options of a domain: learned options and primitive actions."""

from collections.abc import Iterable

from humanopts_env.domains.base import ActableDomain
from humanopts_learner.demonstrations import PRIMITIVE_PREFIX
from humanopts_learner.option import PrimitiveOption
from humanopts_learner.options.learned_option import LearnedOption, OptionError
from humanopts_ros.limits import composed


class UnknownOptionError(ValueError):
    """Option name unknown, in general or for this participant; the message lists the options."""


class AmbiguousOptionError(UnknownOptionError):
    """Several participants taught an option of this name, and no participant is given."""


def no_options_text(participant: str, others: Iterable[str]) -> str:
    """
    Return a message that a participant has no options; it lists the participants that do.

    :param others: participants of all existing options.
    """
    known = ', '.join(sorted(set(others))) or 'none'
    return f'{participant!r} taught no option; those who did: {known}'


RunnableOption = LearnedOption | PrimitiveOption


class OptionLibrary:
    """
    The primitive actions of a domain, and its learned options by participant and name.

    :ivar domain: domain of the options.
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
        """Return the learned options of a participant, or of all participants, sorted by name."""
        found = [o for o in self._options.values() if participant in ('', o.participant)]
        return sorted(found, key=lambda option: (option.name, option.participant))

    def replace(self, options: Iterable[LearnedOption]) -> list[str]:
        """
        Replace the options with the given ones that can run in this domain.

        :return: faults of the others: learned in another domain, or named like a primitive action.
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
        Return the option with a name.

        :param name: name of a learned option, or ``action:NAME`` for a primitive action.
        :param participant: participant who taught the option; empty: the only one who did.
        :raises UnknownOptionError: no option has this name.
        :raises AmbiguousOptionError: several participants taught it, and no participant is given.
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
        listed = [f'{option.name!r} ({option.participant})' for option in self.options()]
        known = ', '.join([*listed, *self._primitives])
        what = f'unknown option {name!r}{owner}' if name else 'option_name is empty'
        raise UnknownOptionError(f'{what}; choose from {known}')
