"""The consent to a study: pages that are shown before any game runs or anything is recorded."""

from collections.abc import Callable, Sequence

from humanopts_teach.dialogue.app import App, EARLIEST, Screen
from humanopts_teach.dialogue.entry import Notice
from humanopts_teach.dialogue.keys import Command, ENTER
from humanopts_teach.dialogue.panel import Block, Page
from humanopts_teach.language import N_
from humanopts_teach.study.plan import Part


class ConsentApp(App):
    """
    The pages of the consent.

    :ivar agreed: whether the person takes part; None: not decided.
    :ivar seconds: time in s from the first ``advance`` to the latest.
    """

    needs_game = False

    def __init__(
        self, pages: Sequence[Part], declined: Callable[[], object] = lambda: None
    ) -> None:
        """
        Show the first page; there is at least one.

        :param declined: called when the person does not agree.
        """
        super().__init__(Screen())
        self._pages, self._declined = pages, declined
        self._began: float | None = None  # s
        self.agreed: bool | None = None
        self._turn_to(0)

    @property
    def seconds(self) -> float:
        """Return the time in s from the first ``advance`` to the latest."""
        return 0.0 if self._began is None else self.now - self._began

    def advance(self, now: float) -> None:
        """Process queued keys."""
        self._began = now if self._began is None else self._began
        super().advance(now)

    def _turn_to(self, index: int) -> None:
        """Show a page; the last one asks for the decision."""
        choices = [Command([ENTER], N_('continue'), lambda app: self._turn_to(index + 1))]
        if index == len(self._pages) - 1:
            choices = [
                Command('y', N_('I agree to take part'), lambda app: self._decide(True)),
                Command('n', N_('I do not want to take part'), lambda app: self._decide(False)),
            ]
        part = self._pages[index]
        self.show(page(Page(part.text), choices, part.reading))

    def _decide(self, agreed: bool) -> None:
        self.agreed = agreed
        if not agreed:
            self._declined()
        self.end()


def page(text: Block, choices: Sequence[Command], earliest: float = 0.0) -> Notice:
    """Return a screen without a board; keys count once it was displayed for ``earliest`` s."""
    earliest = max(earliest, EARLIEST)
    return Notice([text], choices, shows_board=False, earliest=earliest, scroll=0)
