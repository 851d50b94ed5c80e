"""The four rooms: their layout, and as text that reveals only the features that may be shown."""

from collections.abc import Mapping

# Interior of the gridworld in figure 2 of the paper, row 0 in the north. a b c d: cells of the
# four rooms; N W E S: doorways; #: walls. Outer walls surround it.
LAYOUT = (
    'aaaaa#bbbbb',
    'aaaaa#bbbbb',
    'aaaaaNbbbbb',
    'aaaaa#bbbbb',
    'aaaaa#bbbbb',
    '#W####bbbbb',
    'ccccc###E##',
    'ccccc#ddddd',
    'ccccc#ddddd',
    'cccccSddddd',
    'ccccc#ddddd',
)
ROOMS = {'a': 'north-west', 'b': 'north-east', 'c': 'south-west', 'd': 'south-east'}
DOORWAYS = {'N': 'north', 'W': 'west', 'E': 'east', 'S': 'south'}
GOALS = {'G1': (6, 8), 'G2': (8, 8)}  # the east doorway; a cell of the south-east room
WALL, FLOOR, AGENT, GOAL = '█', '·', '☻', '⚑'
GLYPH_STYLES = {
    WALL: 'grey50',
    FLOOR: 'dim',
    AGENT: 'bold bright_yellow',
    GOAL: 'bold bright_cyan',
}
Place = tuple[int, int]  # row, 0 = north; column, 0 = west


def places() -> list[Place]:
    """Return the 104 cells that the agent can be in, by row and column."""
    return [
        (row, col)
        for row, line in enumerate(LAYOUT)
        for col, sign in enumerate(line)
        if sign != '#'
    ]


def draw_rooms(goal: Place, agent: Place | None, facts: Mapping[str, str]) -> str:
    """
    Draw the rooms, a legend, and facts in words.

    :param agent: where it is; None: that may not be seen.
    :param facts: names and values of features that the drawing does not express.
    """
    open_places = set(places())

    def cell(place: Place) -> str:
        if place not in open_places:
            return WALL * 2
        left = AGENT if place == agent else ' '
        return left + (GOAL if place == goal else FLOOR)

    edge = WALL * 2 * (len(LAYOUT[0]) + 2)
    rows = [
        WALL * 2 + ''.join(cell((row, col)) for col in range(len(line))) + WALL * 2
        for row, line in enumerate(LAYOUT)
    ]
    legend = [f'{AGENT} agent'] * (agent is not None) + [f'{GOAL} goal']
    lines = [edge, *rows, edge, '   '.join(legend)]
    texts = [f'{name.replace("_", " ")}: {value}' for name, value in facts.items()]
    return '\n'.join([*lines, '   '.join(texts)] if texts else lines)
