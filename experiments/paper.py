"""
Statements and numbers of the paper; a reproduction computes all other numbers.

Subramanian, Isbell and Thomaz (2011): Learning Options through Human Interaction. The paper gives
no tables for its figures, so only the statements in its text are listed.
"""

from dataclasses import dataclass

TITLE = 'Subramanian, Isbell and Thomaz (2011), Learning Options through Human Interaction'


@dataclass(frozen=True)
class Statement:
    """One statement of the paper."""

    text: str
    where: str  # section, figure or table


def _said(where: str, **texts: str) -> dict[str, Statement]:
    return {name: Statement(text, where) for name, text in texts.items()}


SAID = {
    **_said(
        'section 4, table 1',
        buttons='Asked for buttons that make winning easier and faster, ten volunteers named ten, '
        'with the shares of table 1.',
    ),
    **_said(
        'section 4',
        options='People break tasks down in a way that fits the framework of options.',
    ),
    **_said('section 7', taught='Six of the volunteers taught options of one domain each.'),
    **_said(
        'section 7.1, figure 2',
        rises='Accuracy increases with training data in both domains.',
        forty='Accuracy reaches acceptable levels with over 40 trajectories in both domains.',
        imperfect='Classification accuracy does not reach 100 % in either domain: errors of the '
        'trees, demonstrations that were not optimal, and options that were incomplete.',
    ),
    **_said(
        'section 7.1',
        minutes_in_taxi='On average no more than 15 minutes to show the most trajectories.',
        minutes_in_pacman='On average no more than 20 minutes to show the most trajectories.',
    ),
    **_said(
        'section 7.3, figure 3',
        kinds='Nine automatic options: four that go to a place and pick up, four that go to one '
        'and drop off, and one that goes to a cell.',
        centre='That cell is in the centre of the grid.',
    ),
    **_said(
        'section 7.3',
        more='Three more automatic options than primitive actions.',
        general='Human options are more general: the same one serves every place of passenger or '
        'destination.',
    ),
    **_said(
        'section 7.3, figure 4',
        learning='Learning is faster with human options than with automatic ones.',
    ),
    **_said(
        'section 7.3, table 2',
        efficient='Human options are more efficient than automatic ones, in time and return.',
        human_faster='Planning with human options is faster than with primitive actions.',
        never_as_good='Options never do as well as primitive actions.',
    ),
    **_said(
        'section 7.3, in words; table 2 has the opposite in Taxi',
        automatic_faster='Planning with automatic options is faster than with primitive actions.',
    ),
    **_said(
        'section 8',
        incomplete='With human options alone it is not always possible to learn the best policy; '
        'it was not in Pac-Man.',
        interrupted='Human options in Pac-Man rarely should run to their end, and might run as '
        'modules.',
    ),
}
NO_LEVEL = 'the paper does not say which accuracy is acceptable'
EPISODES = 120  # figure 4
MAX_STEPS = 300  # figure 4: upper end of the axis
CURVES = ('primitive', 'human', 'automatic')  # figure 4
AUTOMATIC = (4, 4, 1)  # section 7.3: options that end with a pickup, a dropoff, in a cell
FIGURE_2_OPTIONS = {  # figure 2 (a) and (b)
    'taxi': 'go to destination and dropoff',
    'pacman': 'go to the closest food',
}
TAUGHT = {  # section 7: options taught by each participant
    'taxi': ('go to passenger and pickup', 'go to destination and dropoff'),
    'pacman': ('go to the closest food', 'avoid ghost', 'go to the nearest power pellet'),
}
ALSO_NAMED = {  # table 1: buttons named, but not taught in section 7
    'pacman': ('eat the ghost',),
}
NOT_NAMED = {  # buttons missing from table 1
    'pacman': ('go to the fruit',),
}
TABLE_2 = {  # seconds and average reward by domain and action set
    'taxi': {
        'primitive': (17.45, -2.294),
        'human': (10.45, -4.294),
        'automatic': (25.75, -4.311),
    },
    'pacman': {
        'primitive': (600.0, 1890.0),
        'human': (60.45, 1790.0),
        'automatic': (120.47, 1442.0),
    },
}
NO_BEST_KNOWN = 'the best policy of Pac-Man is not known: too many states, and models are sampled'
WHY_NO_SECONDS = 'seconds of another computer, and the paper does not say of which work'
WHY_NO_RETURN = {  # reason why the paper's numbers cannot be compared, by domain
    'taxi': 'the paper does not say how it discounts',
    'pacman': 'the paper gives neither maze nor points, nor how its ghosts move',
}
