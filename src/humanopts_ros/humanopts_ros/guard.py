"""Guards the callbacks of a node: bad messages and errors are counted, logged, and survived."""

from collections.abc import Callable
import functools
import inspect
import traceback
from typing import Any

from humanopts_ros.limits import shown
from humanopts_ros.publisher import PublishError
from rclpy.impl.rcutils_logger import RcutilsLogger

_LOG_PERIOD = 1.0  # s between two lines in the log about the same topic or callback


class Guard:
    """
    Counts and logs what a node refuses and what fails in its callbacks.

    :ivar refused: messages that could not be used and were dropped.
    :ivar failed: unexpected errors in callbacks.
    """

    def __init__(
        self,
        logger: Callable[[], RcutilsLogger],
        monotonic: Callable[[], float],
        changed: Callable[[], object],
        ends: tuple[type[Exception], ...] = (),
    ) -> None:
        """
        Start with nothing refused.

        :param monotonic: the clock of the limit of the log's rate, s.
        :param changed: called after ``remark`` has changed.
        :param ends: errors that must end the node; they are re-raised.
        """
        self._logger, self._monotonic, self._changed = logger, monotonic, changed
        self._ends = ends
        self._next_line: dict[str, float] = {}  # when one may be logged, s, by topic or callback
        self._last_refusal = self._last_failure = ''
        self.refused = self.failed = 0

    @property
    def remark(self) -> str:
        """Summary of what was refused and what failed; empty: nothing."""
        return '; '.join(
            f'{count} {what}{"s" if count > 1 else ""}{last}'
            for count, what, last in (
                (self.refused, 'message', f' refused, the last {self._last_refusal}'),
                (self.failed, 'error', f', the last in {self._last_failure}'),
            )
            if count
        )

    def refuse(self, topic: str, sender: str, reason: object) -> None:
        """
        Count and log that a message was dropped.

        :param sender: its publisher_id; empty: it has none.
        """
        self.refused += 1
        by = f' from {shown(sender, 80)}' if sender else ''
        self._last_refusal = f'on {topic}{by}: {shown(str(reason))}'
        self._log(topic, f'refused a message {self._last_refusal}')
        self._changed()

    def caught(self, where: str, error: Exception) -> str:
        """
        Count and log an error of a callback with its traceback, and return its text.

        An error that must end the node is re-raised.
        """
        if isinstance(error, self._ends):
            raise error
        self.failed += 1
        expected = isinstance(error, PublishError)
        text = shown(str(error) if expected else f'{type(error).__name__}: {error}')
        self._last_failure = f'{where}: {text}'
        whole = text if expected else ''.join(traceback.format_exception(error))
        self._log(where, f'an error in {where}: {whole}')
        self._changed()
        return text

    def guarded(
        self, callback: Callable[..., Any], failed: Callable[..., Any] | None = None
    ) -> Callable[..., Any]:
        """
        Return a callback that raises only errors that must end the node.

        :param callback: a function or a coroutine function; its result is returned.
        :param failed: called with the text of the error and the arguments; returns the result
            after an error. None: the result is None.
        """
        where = getattr(callback, '__name__', None) or repr(callback)

        def on_error(error: Exception, arguments: tuple[Any, ...]) -> Any:
            text = self.caught(where, error)
            return failed(text, *arguments) if failed is not None else None

        if inspect.iscoroutinefunction(callback):

            @functools.wraps(callback)
            async def guarded_coroutine(*arguments: Any) -> Any:
                try:
                    return await callback(*arguments)
                except Exception as error:
                    return on_error(error, arguments)

            return guarded_coroutine

        @functools.wraps(callback)
        def guarded_function(*arguments: Any) -> Any:
            try:
                return callback(*arguments)
            except Exception as error:
                return on_error(error, arguments)

        return guarded_function

    def _log(self, what: str, text: str) -> None:
        """Log a line, at a limited rate for each topic or callback."""
        now = self._monotonic()
        if now >= self._next_line.get(what, now):
            self._next_line[what] = now + _LOG_PERIOD
            self._logger().error(text)
