"""How a command ends early."""


class CommandError(Exception):
    """Bad input: the command ends with status 2 and this one line."""
