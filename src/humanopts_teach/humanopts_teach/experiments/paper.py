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


PARTICIPANTS = 6  # section 7: who taught
DEMONSTRATIONS = 40  # section 7.1, figure 2: trajectories for acceptable accuracy, both domains
FIGURE_2 = (
    Statement('Data are an average over 6 participants.', 'section 7.1'),
    Statement(
        'Accuracy increases with training data, and is acceptable with over 40 trajectories in '
        'both domains.',
        'section 7.1, figure 2',
    ),
    Statement(
        'Classification accuracy does not come to 100 % in either domain: errors of the trees, '
        'demonstrations that were not optimal, and options that were incomplete.',
        'section 7.1, figure 2',
    ),
    Statement(
        'To show the most trajectories, participants took no more than 15 minutes in Taxi and 20 '
        'in Pac-Man.',
        'section 7.1',
    ),
)
FIGURE_3 = (
    Statement(
        'Nine automatic options: four that go to a place and pick up, four that go to one and '
        'drop off, and one that goes to a cell.',
        'section 7.3, figure 3',
    ),
    Statement('That cell is in the centre of the grid.', 'section 7.3, figure 3'),
    Statement('Three more automatic options than primitive actions.', 'section 7.3'),
    Statement(
        'Human options are more general: the same one serves every place of passenger or '
        'destination.',
        'section 7.3',
    ),
)
FIGURE_4 = (
    Statement(
        'Learning is faster with human options than with automatic ones.', 'section 7.3, figure 4'
    ),
    Statement('Steps per episode: the axis goes to 300, for 120 episodes.', 'figure 4'),
)
EPISODES = 120  # figure 4
MOST_STEPS = 300  # figure 4: where its axis ends
CURVES = ('primitive', 'human', 'automatic')  # figure 4
AUTOMATIC = {'pickup': 4, 'dropoff': 4, '': 1}  # section 7.3: options by what they end with
MINUTES = {'taxi': 15.0, 'pacman': 20.0}  # section 7.1: at most, on average
FIGURE_2_OPTIONS = {  # figure 2 (a) and (b)
    'taxi': 'go to destination and dropoff',
    'pacman': 'go to the closest food',
}
TAUGHT = {  # section 7: what each participant taught
    'taxi': ('go to passenger and pickup', 'go to destination and dropoff'),
    'pacman': ('go to the closest food', 'avoid ghost', 'go to the nearest power pellet'),
}
