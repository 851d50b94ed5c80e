"""The names of domains, found through Python entry points; nothing of a domain is imported."""

from importlib.metadata import entry_points

DOMAINS = 'humanopts.domains'
GYMNASIUM = 'gymnasium:'  # before the id of a Gymnasium environment


def domain_names() -> list[str]:
    """Return the registered names, sorted."""
    return sorted({point.name for point in entry_points(group=DOMAINS)})
