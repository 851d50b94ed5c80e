"""
Bags, written and read with no ROS installed, and what can go wrong with them.

Every text of an error says what is wrong and, where possible, what to do.
"""


class BagError(ValueError):
    """A bag cannot be read, or does not hold what was asked for."""


class BagWriteError(OSError):
    """A bag cannot be begun or go on; what was written before stays readable."""


class SchemaError(LookupError):
    """No definition of a type is installed."""
