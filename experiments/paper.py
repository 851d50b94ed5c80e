"""
What the paper reports, the only numbers of a reproduction that it does not compute itself.

Subramanian, Isbell and Thomaz (2011): Learning Options through Human Interaction. Figures are
drawings without tables of numbers: of them there is only what the text says.
"""

from dataclasses import dataclass

TITLE = 'Subramanian, Isbell and Thomaz (2011), Learning Options through Human Interaction'


@dataclass(frozen=True)
class Statement:
    """One thing that the paper says."""

    text: str
    where: str  # section, figure or table


STUDY = {
    'buttons': Statement(
        'Asked for buttons that make winning easier and faster, ten volunteers named ten, with '
        'the shares of table 1.',
        'section 4, table 1',
    ),
    'options': Statement(
        'People break tasks down in a way that fits the framework of options.', 'section 4'
    ),
    'taught': Statement('Six of the volunteers taught options of one domain each.', 'section 7'),
}
DEMONSTRATIONS = 40  # section 7.1, figure 2: trajectories for acceptable accuracy, both domains
FIGURE_2 = {
    'rises': Statement(
        'Accuracy increases with training data, and is acceptable with over 40 trajectories in '
        'both domains.',
        'section 7.1, figure 2',
    ),
    'imperfect': Statement(
        'Classification accuracy does not come to 100 % in either domain: errors of the trees, '
        'demonstrations that were not optimal, and options that were incomplete.',
        'section 7.1, figure 2',
    ),
    'forty': Statement(
        '95% policy accuracy takes about 40.',
        'section 7.1, figure 2: “acceptable levels with over 40 trajectories”',
    ),
    'minutes in taxi': Statement(
        'On average no more than 15 minutes to show the most trajectories.', 'section 7.1'
    ),
    'minutes in pacman': Statement(
        'On average no more than 20 minutes to show the most trajectories.', 'section 7.1'
    ),
}
FIGURE_3 = {
    'kinds': Statement(
        'Nine automatic options: four that go to a place and pick up, four that go to one and '
        'drop off, and one that goes to a cell.',
        'section 7.3, figure 3',
    ),
    'centre': Statement('That cell is in the centre of the grid.', 'section 7.3, figure 3'),
    'more': Statement('Three more automatic options than primitive actions.', 'section 7.3'),
    'general': Statement(
        'Human options are more general: the same one serves every place of passenger or '
        'destination.',
        'section 7.3',
    ),
}
FIGURE_4_FASTER = Statement(
    'Learning is faster with human options than with automatic ones.', 'section 7.3, figure 4'
)
EPISODES = 120  # figure 4
MOST_STEPS = 300  # figure 4: where its axis ends
CURVES = ('primitive', 'human', 'automatic')  # figure 4
AUTOMATIC = {'pickup': 4, 'dropoff': 4, '': 1}  # section 7.3: options by their last event
MINUTES = {'taxi': 15.0, 'pacman': 20.0}  # section 7.1: at most, on average
FIGURE_2_OPTIONS = {  # figure 2 (a) and (b)
    'taxi': 'go to destination and dropoff',
    'pacman': 'go to the closest food',
}
TAUGHT = {  # section 7: what each participant taught
    'taxi': ('go to passenger and pickup', 'go to destination and dropoff'),
    'pacman': ('go to the closest food', 'avoid ghost', 'go to the nearest power pellet'),
}
ALSO_NAMED = {  # table 1: a button that was named and, in section 7, not taught
    'pacman': ('eat the ghost',),
}
NOT_NAMED = {  # buttons that table 1 lacks
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
WHY_NO_RETURN = {  # by domain, why the numbers of the paper cannot be compared
    'taxi': 'the paper does not say how it discounts',
    'pacman': 'the paper gives neither maze nor points, nor how its ghosts move',
}
TABLE_2_SAID = {
    'efficient': Statement(
        'Human options are more efficient than automatic ones, in time and return.',
        'section 7.3, table 2',
    ),
    'human faster': Statement(
        'Planning with human options is faster than with primitive actions.',
        'section 7.3, table 2',
    ),
    'automatic faster': Statement(
        'Planning with automatic options is faster than with primitive actions.',
        'section 7.3, in words; table 2 has the opposite in Taxi',
    ),
    'never as good': Statement(
        'What options come to is never as good as what primitive actions do.',
        'section 7.3, table 2',
    ),
    'incomplete': Statement(
        'With human options alone it is not always possible to learn the best policy; it was not '
        'in Pac-Man.',
        'section 8',
    ),
    'interrupted': Statement(
        'Human options in Pac-Man rarely should run to their end, and might run as modules.',
        'section 8',
    ),
}
