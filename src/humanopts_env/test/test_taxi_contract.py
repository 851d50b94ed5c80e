"""Taxi keeps the contract of every domain, at its own size and another."""

from typing import Any

from humanopts_env.contract import DomainContract
from humanopts_env.domains.base import Domain
from humanopts_env.domains.taxi import Taxi


class TestTaxi(DomainContract):
    """The 5 x 5 grid."""

    def make(self) -> Domain[Any]:
        """Return the original grid."""
        return Taxi()


class TestWiderTaxi(DomainContract):
    """A grid of another shape."""

    def make(self) -> Domain[Any]:
        """Return a grid of 6 rows and 7 columns."""
        return Taxi(6, 7)
