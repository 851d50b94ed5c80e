"""Offline evaluation: the results of a lesson, computed only from its demonstrations."""

from collections.abc import Callable

ProgressCallback = Callable[[float, float, str], object]  # arguments: done, total, current task
