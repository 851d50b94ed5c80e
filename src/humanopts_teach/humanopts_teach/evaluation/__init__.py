"""Offline evaluation: the numbers of a lesson, from its demonstrations alone."""

from collections.abc import Callable

ProgressCallback = Callable[[float, float, str], object]  # done, total, current task
