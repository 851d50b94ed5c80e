"""Starting and stopping the processes of a graph."""


class LaunchError(RuntimeError):
    """The graph cannot be started, or a node of it died; the text says which and why."""
