"""Automatic options for planning from samples, by tables over their search space."""

from dataclasses import dataclass

from humanopts_env.domains.search_space import SearchSpace
from humanopts_learner.options.option import OptionTables
from humanopts_learner.planning.sampled.action_set import Flags, Rows
from humanopts_learner.planning.sampled.state_abstraction import Ints


@dataclass(frozen=True)
class BatchTabledOption:
    """A ``BatchOption`` by tables over the S states of a search space."""

    name: str
    max_steps: int
    tables: OptionTables  # (S,) each
    space: SearchSpace

    def can_start(self, rows: Rows) -> Flags:
        """Return (N,): whether each game is in the initiation set."""
        inside: Flags = self.tables.initiation[self.space.states_of(rows)]
        return inside

    def greedy_action(self, rows: Rows) -> Ints:
        """Return (N,): the action that the option takes."""
        action: Ints = self.tables.action[self.space.states_of(rows)]
        return action

    def ends(self, rows: Rows) -> Flags:
        """Return (N,): whether the game has come to the target, or left the initiation set."""
        return ~self.can_start(rows)
