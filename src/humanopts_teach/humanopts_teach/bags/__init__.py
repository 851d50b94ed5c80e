"""
Reading and writing of bags without ROS, and their errors.

An error message describes the problem and, if possible, a solution.
"""


class BagError(ValueError):
    """A bag cannot be read, or lacks the requested contents."""


class BagWriteError(OSError):
    """A bag cannot be created or continued; data already written stays readable."""


class SchemaError(LookupError):
    """The definition of a type is not installed."""
