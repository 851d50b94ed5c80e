"""Automatic options for planning from samples, by tables over their search space."""

from dataclasses import dataclass

from humanopts_env.domains.search_space import SearchSpace
from humanopts_learner.options.option import OptionTables
from humanopts_learner.planning.sampled.games import Flags, Ints, View


@dataclass(frozen=True)
class BatchTabledOption:
    """A ``BatchOption`` by tables over the S states of a search space."""

    name: str
    max_steps: int
    tables: OptionTables  # (S,) each
    space: SearchSpace

    def can_start(self, view: View) -> Flags:
        """Return (N,): whether each game is in the initiation set."""
        inside: Flags = self.tables.initiation[self.space.states_of(view.rows)]
        return inside & ~view.games.batch_over(view.batch)

    def action(self, view: View) -> Ints:
        """Return (N,): what it does."""
        action: Ints = self.tables.action[self.space.states_of(view.rows)]
        return action

    def ends(self, view: View) -> Flags:
        """Return (N,): whether the game has come to the target, or left the initiation set."""
        return ~self.can_start(view)
