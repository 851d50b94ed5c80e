"""
Bags, written and read without ROS, and their errors.

The text of an error says what is wrong and, if possible, what to do.
"""


class BagError(ValueError):
    """A bag cannot be read, or does not hold what was asked for."""


class BagWriteError(OSError):
    """A bag cannot be created or continued; what was written before stays readable."""


class SchemaError(LookupError):
    """No definition of a type is installed."""
