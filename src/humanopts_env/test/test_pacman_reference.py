"""Pac-Man's reference options by hand, and ways to play with them."""

from collections.abc import Callable

from humanopts_env.arrays import Ints
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.pacman.games import PacManGames
from humanopts_env.domains.pacman.reference import reference_options
from humanopts_env.seeding import generator
import pytest

FOOD, AVOID = 'go to the closest food', 'avoid ghost'
PILL, EAT = 'go to the nearest power pellet', 'eat the ghost'
FRUIT = 'go to the fruit'
DOMAIN = PacMan(
    """\
%%%%%%%%%%%%
%...P....o.%
%.%%.%%.%%.%
%........G.%
%%%%%%%%%%%%"""
)
OPTIONS = reference_options(DOMAIN)


def state_text(
    pacman: str,
    ghost: str,
    scared: int = 0,
    food: str = '000001',
    ate: str = 'nothing',
    fruit: str = 'none',
) -> str:
    """Return a state; by default the food in the north-west corner is left."""
    pills = '1' if ate != 'power-pill' else '0'
    return (
        f'pacman {pacman} ghost {ghost} heading none scared {scared} food {food} pills {pills} '
        f'fruit {fruit} lives 3 score 0 ate {ate}'
    )


def test_they_are_the_buttons_of_table_1_and_one_for_the_fruit() -> None:
    assert list(OPTIONS) == [FOOD, AVOID, PILL, EAT, FRUIT]


@pytest.mark.parametrize(
    ('name', 'state', 'moves'),
    [
        (FOOD, state_text('0,3', '2,8', food='000005'), ['west']),  # in columns 0 and 2
        (FOOD, state_text('0,3', '2,8', food='00000c'), ['west', 'east']),  # both beside him
        (FOOD, state_text('0,3', '2,8', food='000200'), ['south']),
        (PILL, state_text('0,3', '2,8'), ['east']),
        (PILL, state_text('2,7', '0,0'), ['west', 'east']),
        (AVOID, state_text('0,3', '0,5'), ['west', 'south']),
        (AVOID, state_text('0,3', '2,3'), ['west', 'east']),  # one step to either side
        (AVOID, state_text('2,9', '2,7'), ['north']),
        (EAT, state_text('0,3', '0,5', scared=9), ['east']),
        (EAT, state_text('0,6', '2,3', scared=1), ['west', 'south']),
        (FRUIT, state_text('0,3', '2,8', fruit='0,6 for 9'), ['east']),
    ],
)
def test_optimal_moves_on_the_board(name: str, state: str, moves: list[str]) -> None:
    """All first moves of shortest ways, and for avoiding those that lead farthest."""
    option, start = OPTIONS[name], DOMAIN.decode(state)
    assert option.can_start(start)
    assert not option.ends(start)
    found = [DOMAIN.actions[action].name for action in option.optimal_actions(start)]
    assert found == moves


@pytest.mark.parametrize(
    ('name', 'state', 'again'),
    [
        (FOOD, state_text('0,3', '2,8', ate='food'), True),
        (PILL, state_text('0,8', '2,8', ate='power-pill'), False),
        (AVOID, state_text('0,3', '2,8'), False),  # 7 steps away
        (AVOID, state_text('0,3', '0,5', scared=9), False),
        (EAT, state_text('0,3', '0,5', ate='ghost'), False),
        (EAT, state_text('0,3', '0,5'), False),
        (FRUIT, state_text('0,3', '2,8'), False),
        (FRUIT, state_text('0,3', '2,8', ate='fruit'), False),
        (FOOD, state_text('0,3', '0,5', food='000000'), False),  # the game is over
        (AVOID, state_text('0,3', '0,5', food='000000'), False),
    ],
)
def test_where_options_end_and_whether_they_can_start_again(
    name: str, state: str, again: bool
) -> None:
    """Outside the initiation set there is no best move."""
    option, end = OPTIONS[name], DOMAIN.decode(state)
    assert option.ends(end)
    assert option.can_start(end) == again
    assert bool(option.optimal_actions(end)) == again


def test_closest_food_is_eaten_in_as_many_steps_as_it_is_away() -> None:
    """Where no ghost comes in between."""
    domain = PacMan('%%%%%%%\n%P   .%\n%   % %\n%.    %\n%%%%%%%')
    option, rng = reference_options(domain)[FOOD], generator(0, 'food')
    state = domain.reset(rng)
    for steps in (2, 6):
        for step in range(steps):
            assert step == 0 or not option.ends(state)
            state = domain.step(state, option.optimal_actions(state)[-1], rng).state
        assert option.ends(state)
    assert domain.is_over(state)


@pytest.mark.heavy
@pytest.mark.parametrize(('ghosts', 'least'), [('random', 1930), ('chase', 1300)])
def test_the_rule_scores_more_than_random_moves(ghosts: str, least: float) -> None:
    """It scored about 1,905 while it ate fruit only where it was the closest food."""
    domain, rng = PacMan(ghosts=ghosts), generator(1, 'players')
    rule = domain.baselines().heuristic
    assert rule is not None

    def played(choose: Callable[[PacManGames], Ints]) -> PacManGames:
        games = domain.games([domain.rules.start()] * 200)
        for _ in range(domain.max_steps):
            games.step(choose(games), rng)
        return games

    by_rule, by_chance = played(rule), played(lambda games: rng.integers(4, size=len(games)))
    assert by_chance.batch.score.mean() < least < by_rule.batch.score.mean()
    assert by_rule.batch.score.max() <= 2080
    outcomes = by_rule.outcomes()
    assert (outcomes['lives left'][outcomes['cleared']] > 0).all()
