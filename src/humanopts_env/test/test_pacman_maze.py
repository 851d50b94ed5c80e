"""Mazes in Berkeley's notation: what is read, what is refused, and shortest paths."""

from pathlib import Path

from humanopts_env.domains.base import DomainError
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.pacman.maze import load_maze, maze_names, MazeError, parse_maze
from humanopts_env.domains.pacman.paths import maze_paths, STAY
import numpy as np
import pytest

# Everything that Berkeley's layouts hold: blank floor, a den, capsules, numbered ghosts.
LAYOUT = """\
%%%%%%%%%%%%%
%o...%.....o%
%.%%.%.%%%%.%
%.%..  ..%..%
%...%1 2%..%%
%.%.%%%%%.%.%
%...  P ....%
%%%%%%%%%%%%%
"""


def surrounded(*rows: str) -> str:
    """Put a wall around some rows."""
    edge = '%' * (len(rows[0]) + 2)
    return '\n'.join([edge, *(f'%{row}%' for row in rows), edge])


def test_a_layout_with_berkeleys_conventions_is_read() -> None:
    maze = parse_maze(LAYOUT)
    assert (maze.rows, maze.cols) == (6, 11)
    assert maze.cells[maze.start] == (5, 5)
    assert [maze.cells[home] for home in maze.homes] == [(3, 4), (3, 6)]
    assert [maze.cells[pill] for pill in maze.pills] == [(0, 0), (0, 10)]
    assert len(maze.food) == LAYOUT.count('.')
    assert len(maze.cells) == len(LAYOUT) - LAYOUT.count('%') - LAYOUT.count('\n')


def test_numbered_ghosts_come_in_order_and_g_is_the_first() -> None:
    """As the Berkeley projects sort their agents."""
    maze = parse_maze(surrounded('P.32G4'))
    assert [maze.cells[home][1] for home in maze.homes] == [4, 3, 2, 5]


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('', 'empty'),
        (surrounded('....'), 'no Pac-Man'),
        (surrounded('P..P'), '2 Pac-Man'),
        (surrounded('P  G'), 'no food'),
        (surrounded('P.%.'), 'food in line 2, column 5 cannot be reached'),
        (surrounded('P.%o'), 'a power pill in line 2, column 5 cannot be reached'),
        (surrounded('P.%G'), 'a ghost in line 2, column 5 cannot be reached'),
        (surrounded('P.', '...'), 'line 3 of the maze has 5 characters, but line 1 has 4'),
        (surrounded('P.x'), "line 2, column 4 of the maze is 'x'"),
        (surrounded('P.5'), "is '5'"),
        ('%%%%\n%P..\n%%%%', 'the border is open in line 2'),
        ('%%.%\n%P.%\n%%%%', 'the border is open in line 1'),
        ('P.', 'the border is open'),
        (surrounded('P.GGGGG'), '5 ghosts, but may have at most 4'),
        (surrounded('P' + '.' * 65), '3 x 68 characters, but may have at most 66 x 66'),
        (surrounded('P' + '.' * 63, *['.' * 64] * 30), '1984 open cells'),
    ],
)
def test_what_is_no_maze_is_refused_with_the_reason(text: str, reason: str) -> None:
    """Each by a MazeError, which is a DomainError."""
    with pytest.raises(MazeError, match=reason):
        parse_maze(text)


def test_a_maze_is_read_from_a_file_and_named_in_errors(tmp_path: Path) -> None:
    """The text is among the parameters, so that others play the same maze."""
    path = tmp_path / 'own.lay'
    path.write_text(LAYOUT)
    domain = PacMan(str(path))
    assert domain.parameters['maze'] == LAYOUT.strip()
    assert PacMan(str(domain.parameters['maze'])).rules.maze == domain.rules.maze
    path.write_text(surrounded('P  '))
    with pytest.raises(MazeError, match=r'own\.lay: the maze has no food'):
        load_maze(str(path))
    path.write_bytes(b'\xff\xfe')
    with pytest.raises(MazeError, match='is not UTF-8 text'):
        load_maze(str(path))


@pytest.mark.parametrize('bad', ['nowhere', '', '.', 'no\0file'])
def test_a_maze_that_is_not_there_is_refused(bad: str) -> None:
    with pytest.raises(MazeError, match='gardens'):
        load_maze(bad)


@pytest.mark.parametrize(
    ('parameters', 'reason'),
    [
        ({'maze': 3}, 'maze is 3'),
        ({'ghosts': 'slow'}, 'random or chase'),
        ({'ghosts': None}, 'ghosts is None'),
        ({'features': 'all'}, "features is 'all', but must be directions or paper"),
        ({'lives': 0}, 'from 1 to 9'),
        ({'lives': True}, 'lives is True'),
        ({'max_steps': 0}, 'max_steps is 0'),
        ({'max_steps': 2.5}, r'max_steps is 2\.5'),
    ],
)
def test_parameters_out_of_range_are_refused(parameters: dict[str, object], reason: str) -> None:
    with pytest.raises(DomainError, match=reason):
        PacMan(**parameters)  # type: ignore[arg-type]


@pytest.mark.parametrize('name', maze_names())
def test_our_mazes_are_symmetric_and_without_dead_ends(name: str) -> None:
    """Left and right are alike but for Pac-Man; food is never in a dead end."""
    maze = load_maze(name)
    assert all(line == line[::-1] or 'P' in line for line in maze.text.split('\n'))
    ways = (maze_paths(maze).step[:, :STAY] != np.arange(len(maze.cells))[:, None]).sum(axis=1)
    assert (ways[list(maze.food)] >= 2).all()


def test_every_first_move_comes_one_step_nearer_and_no_other_does() -> None:
    paths = maze_paths(load_maze('gardens'))
    for move in range(STAY):
        nearer = paths.distance[paths.step[:, move]] < paths.distance
        assert np.array_equal(nearer, paths.shortest >> move & 1 == 1)


def test_a_ghost_turns_back_only_in_a_dead_end() -> None:
    maze = parse_maze(surrounded('P..', '%.%'))
    paths, number = maze_paths(maze), maze.cells.index
    north, west, east, south = 1, 2, 4, 8
    fork, end = number((0, 1)), number((1, 1))
    assert paths.allowed[fork].tolist() == [
        west | east,  # came north, out of the south
        west | south,
        east | south,
        west | east | south,
        west | east | south,
    ]
    assert paths.allowed[end].tolist() == [north] * 5
