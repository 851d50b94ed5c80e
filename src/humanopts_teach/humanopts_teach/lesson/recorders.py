"""Monitoring of recorders, by their status messages and their presence on the graph."""

from dataclasses import dataclass

PATIENCE = 50  # maximum number of checks without a new status of a recorder
_ADVICE = 'Everything taught so far is on disk: quit, and the same command continues it.'
SILENT = (
    'the recorder is no longer responding, and the bag may lack the last few seconds. ' + _ADVICE
)
AGAIN = 'another recorder is subscribing to the topics'


@dataclass(slots=True)
class _Recorder:
    complete: bool
    stopped: bool
    text: str
    checks: int = 0  # since the last status


class Recorders:
    """
    The last status of every recorder; a new recorder may start while a stopped one is present.

    Timeouts are measured in checks, not in seconds, so that a busy lesson does not mistake its own
    delay for one of the recorder.
    """

    def __init__(self, *, expected: bool) -> None:
        """
        Start without a fault.

        :param expected: whether running without a recorder is a fault.
        """
        self._expected = expected
        self._known: dict[str, _Recorder] = {}  # by publisher_id
        self._published: set[str] = set()  # recorders that have published a status
        self._again = False  # a new recorder has appeared since the last check
        self._fault = ''

    def update(self, recorder: str, *, complete: bool, stopped: bool, text: str) -> None:
        """
        Store the status that a recorder publishes every second.

        :param recorder: publisher_id of the recorder; other parameters are as in RecorderStatus.
        """
        self._again |= bool(self._published) and recorder not in self._published and not stopped
        self._published.add(recorder)
        self._known[recorder] = _Recorder(complete, stopped, text)

    def check(self, present: bool, checks: int = 1) -> str:
        """
        Return why nothing is recorded and what to do; empty: recording works.

        A fault ends once a recorder has every topic. If there is no fault, a new recorder causes
        one for a single check, so that the lesson republishes everything for it.

        :param present: whether a recorder is on the graph; a killed one remains for a while.
        :param checks: number of checks that this call counts as.
        """
        for recorder in self._known.values():
            recorder.checks += checks
        self._known = {
            who: recorder
            for who, recorder in self._known.items()
            if present and recorder.checks <= PATIENCE
        }
        known = self._known.values()
        again, self._again = self._again, False
        if again:
            self._fault = self._fault or AGAIN
        elif any(recorder.complete and not recorder.stopped for recorder in known):
            self._fault = ''
        elif known and all(recorder.stopped for recorder in known):
            self._fault = f'{next(iter(known)).text}. {_ADVICE}'
        elif not known and self._expected and (self._published or not present):
            self._fault = self._fault or SILENT
        return self._fault
