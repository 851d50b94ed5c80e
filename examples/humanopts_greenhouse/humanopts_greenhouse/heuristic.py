"""A rule written by hand for the greenhouse: fill an empty can, water with a full one."""

from humanopts_env.domains.base import EnumerableDomain
from humanopts_env.domains.capabilities import Scores
from humanopts_env.games import TableGames
from humanopts_env.seeding import generator
import numpy as np

from humanopts_greenhouse.greenhouse import GreenhouseState
from humanopts_greenhouse.reference import reference_options


def play_heuristic(domain: EnumerableDomain[GreenhouseState], games: int, seed: int) -> Scores:
    """Play games by the option that can start; there is never more than one."""
    options = reference_options(domain).values()
    optimal = np.any([option.optimal for option in options], axis=0)
    rng = generator(seed, 'greenhouse', 'heuristic')
    played = TableGames(domain, rng.choice(domain.start_states().astype(np.intp), games))
    total = np.zeros(games)
    for _ in range(domain.max_steps):
        total += played.step(optimal[played.state].argmax(axis=1), rng).reward
    return Scores(total, played.outcomes())
