"""Guarded callbacks: a node counts and logs invalid messages and errors, and continues."""

from collections.abc import Callable
import functools
import inspect
import traceback
from typing import Any

from humanopts_ros.limits import shown
from humanopts_ros.publisher import PublishError
from rclpy.impl.rcutils_logger import RcutilsLogger

_LOG_PERIOD = 1.0  # s between log lines about the same topic or callback


class Guard:
    """
    Counts and logs refused messages and failed callbacks of a node.

    :ivar refused: number of invalid messages dropped.
    :ivar failed: number of unexpected errors in callbacks.
    """

    def __init__(
        self,
        logger: Callable[[], RcutilsLogger],
        monotonic: Callable[[], float],
        changed: Callable[[], object],
        ends: tuple[type[Exception], ...] = (),
    ) -> None:
        """
        Start with zero counts.

        :param monotonic: clock for limiting the log rate, s.
        :param changed: callback for changes of ``remark``.
        :param ends: exception types that must end the node; they are re-raised.
        """
        self._logger, self._monotonic, self._changed = logger, monotonic, changed
        self._ends = ends
        self._next_line: dict[str, float] = {}  # s, earliest next log time by topic or callback
        self._last_refusal = self._last_failure = ''
        self.refused = self.failed = 0

    @property
    def remark(self) -> str:
        """A summary of refusals and errors; empty if there are none."""
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

        :param sender: publisher_id of the message; empty if it has none.
        """
        self.refused += 1
        by = f' from {shown(sender, 80)}' if sender else ''
        self._last_refusal = f'on {topic}{by}: {shown(str(reason))}'
        self._log(topic, f'refused a message {self._last_refusal}')
        self._changed()

    def caught(self, where: str, error: Exception) -> str:
        """
        Count and log a callback's error with its traceback, and return its message.

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
        Wrap a callback so that it raises only errors that must end the node.

        :param callback: function or coroutine function; its result is passed through.
        :param failed: function that returns the result after an error, given the error message and
            the arguments; if None, the result is None.
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
        """Log a line, rate-limited for each topic or callback."""
        now = self._monotonic()
        if now >= self._next_line.get(what, now):
            self._next_line[what] = now + _LOG_PERIOD
            self._logger().error(text)
