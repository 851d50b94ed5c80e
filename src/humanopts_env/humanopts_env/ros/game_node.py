"""The node ``game``, which owns the game and takes one step per accepted command."""

from functools import partial
import json
import sys
from typing import Any

from humanopts_env.domains.base import DomainError
from humanopts_env.domains.registry import domain_from_json
from humanopts_env.game import Game
from humanopts_env.ros.lock_step_node import LockStepNode
from humanopts_ros.guarded_node import SEEDS, StartError
from humanopts_ros.process import run_node


class GameNode(LockStepNode):
    """The game of a domain."""

    def __init__(self, **options: Any) -> None:
        super().__init__('game', **options)
        self._seed = self.setting('seed', 0, 'of the first episode', SEEDS)

    def make_game(self) -> Game:
        """Return the game of the domain in the parameters."""
        name = self.setting('domain', 'taxi', 'registered name of the domain')
        parameters = self.setting('domain_parameters', '{}', 'JSON object of its parameters')
        try:
            return Game(domain_from_json(name, parameters))
        except (DomainError, json.JSONDecodeError) as error:
            raise StartError(str(error)) from error


main = partial(run_node, GameNode, by_events=True)  # for a high step rate

if __name__ == '__main__':
    sys.exit(main())
