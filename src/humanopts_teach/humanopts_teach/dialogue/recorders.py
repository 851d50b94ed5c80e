"""Whether a lesson is recorded, by what the recorders say and how many there are."""

from dataclasses import dataclass

_ADVICE = 'Everything taught is on disk: quit, and the same command takes it up again.'
GONE = f'the recorder is gone. {_ADVICE}'


@dataclass(frozen=True, slots=True)
class RecorderWord:
    """The last that one recorder said, as in RecorderStatus."""

    complete: bool
    stopped: bool
    text: str


class Recorders:
    """
    What all recorders said last; a new one may come beside one that has stopped.

    A new recorder ends a fault once it has every topic.
    """

    def __init__(self, *, expected: bool) -> None:
        """
        Begin without a fault.

        :param expected: a lesson without any recorder is a fault, too.
        """
        self._expected = expected
        self._words: dict[str, RecorderWord] = {}  # by publisher_id, who spoke last at the end
        self._fault = ''

    def heard(self, recorder: str, word: RecorderWord) -> None:
        """Take in what a recorder says, by its publisher_id."""
        self._words.pop(recorder, None)
        self._words[recorder] = word

    def fault(self, there: int) -> str:
        """
        Say why nothing is recorded and what to do; empty: all is well.

        :param there: recorders on the graph; who has been silent longest is taken to be gone.
        """
        for gone in list(self._words)[: max(0, len(self._words) - there)]:
            del self._words[gone]
        words = list(self._words.values())
        if any(word.complete and not word.stopped for word in words):
            self._fault = ''
        elif words and all(word.stopped for word in words):
            self._fault = f'{words[-1].text}. {_ADVICE}'
        elif not there and self._expected:
            self._fault = self._fault or GONE
        return self._fault
