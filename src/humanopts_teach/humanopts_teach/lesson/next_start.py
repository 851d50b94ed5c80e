"""Choice of the start state of the next demonstration or exam run."""

from collections import deque
from collections.abc import Collection

from humanopts_env.domains.base import ActableDomain, DomainError
from humanopts_env.domains.described import can_simulate
from humanopts_env.game import Transition
from humanopts_teach.lesson.feedback import Feedback
from humanopts_teach.lesson.history import OptionHistory
from humanopts_teach.lesson.requests import BeginDemonstration, RefusalError, RequestStatus
from humanopts_teach.lesson.seeded_starts import SeededStarts
import numpy as np

MAX_PASSED = 1000  # maximum number of remembered states between demonstrations


class NextStart:
    """
    Chooses the next start state, or describes a useful one if the domain cannot be simulated.

    :ivar missing: description of a situation not demonstrated yet, in such a domain; empty: none.
    """

    def __init__(self, domain: ActableDomain, starts: SeededStarts, feedback: Feedback) -> None:
        self._domain, self._starts, self._feedback = domain, starts, feedback
        self._passed = deque[tuple[float, ...]](maxlen=MAX_PASSED)
        self.missing = ''
        self.forget()

    def forget(self) -> None:
        """Forget the start state of a discarded demonstration."""
        self._again, self._repeated = '', 0

    def repeat(self, start_state: str) -> None:
        """Repeat the start state of a discarded demonstration, with a different episode seed."""
        self._again, self._repeated = start_state, self._repeated + 1

    def drive_past(self, transition: Transition) -> None:
        """Remember a state between demonstrations, if an episode has begun."""
        if transition.episode:
            self._passed.append(transition.features)

    def look(self, option: OptionHistory | None) -> None:
        """Update ``missing`` when the learner is up to date."""
        self.missing = ''
        if option is not None and not can_simulate(self._domain):
            rows = np.array(self._passed).reshape(-1, len(self._domain.features))
            self.missing = self._starts.missing(option, rows)

    def choose(
        self, option: OptionHistory, names: Collection[str], request: BeginDemonstration
    ) -> tuple[str, int]:
        """
        Return the start state, in the domain's notation, and the seed of the episode.

        :param names: as in ``SeededStarts.draw``.
        :return: an empty state: the current one, in a domain that cannot be simulated.
        :raises RefusalError: nothing can be shown in the requested state.
        """
        seed = self._starts.episode_seed(option, self._repeated, exam=request.exam)
        if request.exam:
            return self._starts.draw_for_exam(option, names), seed
        if not can_simulate(self._domain):
            return request.start_state, seed  # checked by the world
        if request.start_state:
            try:
                decoded = self._domain.decode(request.start_state)
            except DomainError as error:
                raise RefusalError(RequestStatus.BAD_STATE, str(error)) from error
            if self._domain.is_over(decoded):
                detail = f'the task is over in {request.start_state}: nothing can be shown there'
                raise RefusalError(RequestStatus.BAD_STATE, detail)
            return self._domain.encode(decoded), seed
        state = self._again or option.correction or next(reversed(option.start_states), '')
        if not state and option.name in self._feedback.offers:
            state = self._domain.encode(self._feedback.offers[option.name][0])
        return state or self._starts.draw(option, names), seed
