"""Where the next demonstration starts, or the next run in the exam."""

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

MAX_PASSED = 1000  # newest states between demonstrations that are remembered


class NextStart:
    """
    Chooses the next start; in a domain that can only be acted in, says which one would help.

    :ivar missing: in such a domain, what no demonstration has shown yet; empty: nothing is known.
    """

    def __init__(self, domain: ActableDomain, starts: SeededStarts, feedback: Feedback) -> None:
        self._domain, self._starts, self._feedback = domain, starts, feedback
        self._passed = deque[tuple[float, ...]](maxlen=MAX_PASSED)
        self.missing = ''
        self.forget()

    def forget(self) -> None:
        """Forget a discarded demonstration: it was repeated, or is of another option."""
        self._again, self._repeated = '', 0

    def repeat(self, start_state: str) -> None:
        """Start the next demonstration where one was discarded; chance will differ."""
        self._again, self._repeated = start_state, self._repeated + 1

    def drive_past(self, transition: Transition) -> None:
        """Remember a state between demonstrations; before the first episode there is none."""
        if transition.episode:
            self._passed.append(transition.features)

    def look(self, option: OptionHistory | None) -> None:
        """Find out what is missing, after the learner has counted everything."""
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
        :return: an empty state: the current one, in a domain that can only be acted in.
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
