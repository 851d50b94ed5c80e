"""Automatic options of Pac-Man, which see nothing but his cell."""

from dataclasses import dataclass

from humanopts_learner.options.option import OptionTables
from humanopts_learner.planning.sampled.games import Flags, Ints, View
import numpy as np


@dataclass(frozen=True)
class CellOption:
    """A ``BatchOption`` by tables over the C cells of the maze."""

    name: str
    max_steps: int
    tables: OptionTables  # (C,) each

    def can_start(self, view: View) -> Flags:
        """Return (N,): whether each game is in the initiation set."""
        can: Flags = self.tables.initiation[view.batch.pacman] & ~view.batch.over
        return can

    def action(self, view: View) -> Ints:
        """Return (N,): what it does."""
        action: Ints = self.tables.action[view.batch.pacman]
        return action

    def ends(self, view: View) -> Flags:
        """Return (N,): whether Pac-Man has come to the target, or left the initiation set."""
        ends: Flags = np.logical_not(self.can_start(view))
        return ends
