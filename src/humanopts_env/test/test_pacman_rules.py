"""Pac-Man's rules by hand, on corridors where every outcome can be counted."""

from collections import Counter
from dataclasses import replace

from humanopts_env.domains.base import StateError
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.pacman.maze import parse_maze
from humanopts_env.domains.pacman.paths import STAY
from humanopts_env.domains.pacman.rules import DRAWS, PICKS, Rules
from humanopts_env.domains.pacman.state import Ghost, NO_CELL, PacManState
from humanopts_env.seeding import generator
import pytest

NORTH, WEST, EAST, SOUTH = range(4)


def rules_of(*rows: str, ghosts: str = 'random') -> Rules:
    """Return the rules of a maze without its border."""
    edge = '%' * (len(rows[0]) + 2)
    return Rules(parse_maze('\n'.join([edge, *(f'%{row}%' for row in rows), edge])), ghosts)


def run(rules: Rules, state: PacManState, *moves: int, draw: int = 0) -> PacManState:
    """Take steps in which every draw is the same."""
    for move in moves:
        state = rules.advance(state, move, [draw] * len(state.ghosts))
    return state


def test_food_is_worth_ten_points_and_a_wall_stops() -> None:
    """A move into a wall is a step in which nothing is eaten."""
    rules = rules_of('P..')
    state = run(rules, rules.start(), WEST)
    assert (state.pacman, state.score, state.ate) == (0, 0, 0)
    state = run(rules, state, EAST)
    assert (state.pacman, state.score, state.ate) == (1, 10, 1)
    assert not rules.is_over(state)
    state = run(rules, state, EAST)
    assert (state.score, state.food) == (20, 0)
    assert rules.is_over(state)


def test_a_pill_is_worth_50_and_scares_all_ghosts_for_40_steps() -> None:
    """They may then turn, and are dangerous again afterwards."""
    rules = rules_of('.Po' + ' ' * 57 + 'GG')
    state = run(rules, rules.start(), EAST)
    assert (state.score, state.ate) == (50, 2)
    assert [(ghost.heading, ghost.scared) for ghost in state.ghosts] == [(STAY, 40)] * 2
    first, *rest = [state := run(rules, state, WEST, EAST) for _ in range(20)]
    assert [ghost.scared for ghost in first.ghosts] == [38, 38]
    assert [ghost.scared for ghost in rest[-1].ghosts] == [0, 0]


def test_a_scared_ghost_moves_away_at_half_speed() -> None:
    """Twenty cells in forty steps; a dangerous one moves in every step."""
    rules = rules_of('.P' + ' ' * 45 + 'G')
    ghost = Ghost(cell=20, heading=WEST, scared=40)
    state = replace(rules.start(), ghosts=(replace(ghost, heading=STAY),))
    cells = []
    for _ in range(40):
        state = run(rules, state, EAST if state.pacman == 0 else WEST)
        state = replace(state, food=1)
        cells.append(state.ghosts[0].cell)
    assert cells == [21 + n // 2 for n in range(40)]
    assert state.ghosts[0].scared == 0
    assert run(rules, state, WEST).ghosts[0].cell == 41


def test_a_scared_ghost_that_is_met_is_worth_200_and_is_home_and_dangerous() -> None:
    rules = rules_of('.P  ' + ' ' * 10 + 'GG')
    ghosts = (Ghost(2, STAY, 11), Ghost(9, STAY, 11))
    state = run(rules, replace(rules.start(), ghosts=ghosts), EAST)
    assert (state.score, state.ate, state.lives) == (200, 8, 3)
    assert state.ghosts == (Ghost(14), Ghost(9, STAY, 10))


@pytest.mark.parametrize('gap', [0, 1])
def test_to_meet_in_a_cell_or_to_change_places_costs_a_life(gap: int) -> None:
    """Everyone goes back; what was eaten stays eaten."""
    rules = rules_of('.P.' + ' ' * 20 + '.G')
    state = run(rules, rules.start(), WEST, EAST)
    met = replace(state, ghosts=(Ghost(2 + gap, WEST, 0),), fruit=9, fruit_at=20)
    after = run(rules, met, EAST)
    assert (after.lives, after.pacman, after.ghosts) == (2, 1, rules.start().ghosts)
    assert (after.score, after.fruit, after.fruit_at) == (20, 8, 20)
    assert after.food.bit_count() == 1


def test_pac_man_can_follow_a_ghost() -> None:
    """They move at once, so he does not run into one that goes on."""
    rules = rules_of('.P.' + ' ' * 20 + '.G')
    state = replace(rules.start(), ghosts=(Ghost(2, EAST, 0),))
    assert run(rules, state, EAST, EAST).lives == 3


def test_a_pill_that_is_eaten_in_time_saves() -> None:
    """He eats before he meets: the ghost that comes into his cell is scared by then."""
    rules = rules_of('.Po   G')
    state = replace(rules.start(), ghosts=(Ghost(3, WEST, 0),))
    after = run(rules, state, EAST)
    assert (after.score, after.lives, after.ate) == (250, 3, 2 | 8)
    assert after.ghosts == (Ghost(rules.maze.homes[0]),)


def test_in_the_last_step_of_fear_a_ghost_can_still_be_eaten() -> None:
    """What the board shows before the move is what counts."""
    rules = rules_of('.P        G')
    last = replace(rules.start(), ghosts=(Ghost(2, WEST, 1),))
    assert run(rules, last, EAST).score == 200
    gone = replace(last, ghosts=(Ghost(2, WEST, 0),))
    assert run(rules, gone, EAST).lives == 2


def test_the_last_food_wins_even_beside_a_ghost() -> None:
    rules = rules_of('P.   G')
    won = run(rules, replace(rules.start(), ghosts=(Ghost(2, WEST, 0),)), EAST)
    assert rules.is_over(won)
    assert (won.lives, won.food) == (3, 0)


def test_fruit_comes_after_30_and_65_food_near_the_middle() -> None:
    """On the food that is left nearest to the middle; it is eaten together with that."""
    rules = rules_of('P' + '.' * 35, '.' * 36)
    state = run(rules, rules.start(), *[EAST] * 29)
    assert (state.fruit, state.fruit_at) == (0, NO_CELL)
    state = run(rules, state, EAST)
    assert (state.fruit, rules.maze.cells[state.fruit_at]) == (60, (1, 17))
    state = run(rules, state, *[EAST] * 5, SOUTH, *[WEST] * 18)
    assert (state.score, state.ate, state.fruit, state.fruit_at) == (640, 1 | 4, 0, NO_CELL)
    state = run(rules, state, *[WEST] * 11)
    assert (state.fruit, rules.maze.cells[state.fruit_at]) == (60, (1, 5))


def test_fruit_is_there_for_60_steps() -> None:
    """It can be eaten with the sixtieth and not with the next."""
    rules = rules_of('P' + '.' * 35, '.' * 36)
    state = run(rules, rules.start(), *[EAST] * 30, *[SOUTH] + [WEST] * 12)
    waited = run(rules, state, *[SOUTH] * 46)  # a wall
    assert run(rules, waited, WEST).ate == 1 | 4
    assert run(rules, waited, SOUTH, WEST).ate == 1


@pytest.mark.parametrize('mask', range(1, 16))
def test_a_draw_picks_equally_good_moves_alike(mask: int) -> None:
    """Among the draws that chase, among the others, and so among all."""
    moves = [move for move in range(4) if mask >> move & 1]
    for draws in (range(48), range(48, DRAWS)):
        picked = Counter(int(PICKS[mask, draw]) for draw in draws)
        assert picked == dict.fromkeys(moves, len(draws) // len(moves))


@pytest.mark.parametrize(('ghosts', 'west'), [('random', 30), ('chase', 54)])
def test_a_chasing_ghost_comes_with_probability_08_else_at_random(ghosts: str, west: int) -> None:
    """Of 60 draws, 48 and half of the others lead towards Pac-Man in the west."""
    rules = rules_of('.P     G  ', ghosts=ghosts)
    after = [rules.advance(rules.start(), WEST, [draw]) for draw in range(DRAWS)]
    headings = Counter(state.ghosts[0].heading for state in after)
    assert headings == {WEST: west, EAST: DRAWS - west}


@pytest.mark.parametrize('ghosts', ['random', 'chase'])
def test_a_ghost_does_not_turn_back_even_to_chase(ghosts: str) -> None:
    """Only where there is no other way."""
    rules = rules_of('.P     G  ', ghosts=ghosts)
    for cell, heading in ((7, EAST), (9, WEST)):
        state = replace(rules.start(), ghosts=(Ghost(cell, EAST),))
        for draw in range(DRAWS):
            assert rules.advance(state, WEST, [draw]).ghosts[0].heading == heading


def test_what_cannot_happen_cannot_follow() -> None:
    """A ghost that jumps or turns back, points that were not earned, food that comes back."""
    domain = PacMan()
    state = domain.reset(generator(0, 'follow'))
    after = domain.step(state, WEST, generator(1, 'follow')).state
    assert domain.can_follow(state, WEST, after)
    first, second = after.ghosts
    for wrong in (
        replace(after, score=after.score + 10),
        replace(after, food=state.food),
        replace(after, pacman=state.pacman),
        replace(after, ghosts=(replace(first, cell=0), second)),
        replace(after, ghosts=(replace(first, scared=40), second)),
        replace(after, lives=2),
    ):
        assert not domain.can_follow(state, WEST, wrong)
    assert not domain.can_follow(state, EAST, after)
    assert not domain.can_follow(state, 7, after)
    assert not domain.can_follow(replace(state, lives=0), WEST, after)


START = (
    'pacman 8,8 ghost 4,8 heading none scared 0 ghost 4,9 heading none scared 0 '
    'food 3ffffffffffffffffffffffff pills 11 fruit none lives 3 score 0 ate nothing'
)


def test_all_parts_of_a_state_are_in_its_text() -> None:
    """Fruit has a place, and what was eaten its names."""
    domain = PacMan()
    state = PacManState(0, (Ghost(5, NORTH, 40), Ghost(60, SOUTH, 0)), 2, 1, 60, 9, 1, 1230, 15)
    text = domain.encode(state)
    assert text.endswith(
        'food 0000000000000000000000002 pills 01 fruit 0,9 for 60 lives 1 score 1230 '
        'ate food+power-pill+fruit+ghost'
    )
    assert domain.decode(text) == state


@pytest.mark.parametrize(
    ('old', 'new'),
    [
        ('pacman 8,8', 'pacman 1,1'),  # a wall
        ('pacman 8,8', 'pacman 08,8'),
        ('pacman 8,8', 'pacman 8,٨'),
        ('pacman 8,8', f'pacman {"9" * 1000},8'),
        ('pacman 8,8', 'pacman 0,0'),  # where food is
        (' ghost 4,9 heading none scared 0', ''),
        ('ghost 4,8', 'ghost 1,1'),
        ('scared 0', 'scared 41'),
        ('heading none', 'heading up'),
        ('food 3', 'food 7'),  # a 99th food
        ('food 3', 'food 03'),
        ('pills 11', 'pills 111'),
        ('fruit none', 'fruit 0,0 for 0'),
        ('fruit none', 'fruit 1,1 for 5'),
        ('lives 3', 'lives 4'),
        ('score 0', 'score 12345678901'),
        ('ate nothing', 'ate ghost+food'),
    ],
)
def test_text_that_is_no_state_of_the_maze_is_refused(old: str, new: str) -> None:
    assert START.count(old) >= 1
    with pytest.raises(StateError):
        PacMan().decode(START.replace(old, new, 1))


def test_a_step_depends_on_the_state_alone_whatever_was_played_before() -> None:
    """Not on whether the state is the result of the latest step, or was built anew."""
    rules, rng = PacMan(ghosts='chase').rules, generator(0, 'branches')
    state = rules.start()
    for _ in range(60):
        draws = rules.draws(rng)
        after = [rules.advance(state, move, draws) for move in range(4)]
        new = Rules(rules.maze, 'chase')
        assert after == [new.advance(replace(state), move, draws) for move in range(4)]
        assert rules.game_at(after[-1]).states() == [after[-1]]
        state = after[int(rng.integers(4))]
        if rules.is_over(state):
            break
