"""Pac-Man keeps the contract of every domain, in mazes of several kinds."""

from pathlib import Path
from typing import Any

from humanopts_env.contract import DomainContract
from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_env.domains.pacman.domain import PacMan

FOUR_GHOSTS = str(Path(__file__).with_name('four_ghosts.lay'))
NO_GHOST = '%%%%%\n%P..%\n%%%%%'


class TestPacMan(DomainContract):
    """Our own maze."""

    def make(self) -> Domain[Any]:
        """Return the default."""
        domain: Domain[Any] = PacMan()
        assert not is_enumerable(domain)
        return domain


class TestChasedPacMan(DomainContract):
    """A small maze with one ghost that chases."""

    def make(self) -> Domain[Any]:
        """Return a game with one life."""
        return PacMan('yard', ghosts='chase', lives=1, max_steps=100)


class TestCrowdedPacMan(DomainContract):
    """Numbered ghosts and three pills, from a file."""

    def make(self) -> Domain[Any]:
        """Return four ghosts."""
        return PacMan(FOUR_GHOSTS)


class TestLonelyPacMan(DomainContract):
    """No ghost and no pill."""

    def make(self) -> Domain[Any]:
        """Return a corridor."""
        return PacMan(NO_GHOST)
