"""A person who teaches options of Taxi at a terminal, from what is on the screen."""

from collections.abc import Callable
import re

from humanopts_env.domains.reference import ReferenceOption
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.domains.taxi import ABOARD, landmark_cells, TaxiState
from humanopts_env.seeding import generator

from graph_support.terminal import ENTER, Terminal

TAXI = make_domain('taxi')
OPTIONS = reference_options(TAXI)
CELLS = [*landmark_cells(5, 5).values()]


def name_and_answer(
    terminal: Terminal, name: str, look: Callable[[str], None] = lambda what: None
) -> None:
    """
    Name an option in the menu and answer every question, up to the first start.

    :param look: called with "name" and "question" when such a screen is there.
    """
    terminal.see('1 Teach a new option')
    terminal.press('1', *name)
    terminal.see(f'> {name}')
    look('name')
    terminal.press(ENTER)
    for feature in TAXI.features:
        terminal.see(f"Does the '{name}' option depend on {feature.question}?")
        look('question')
        terminal.press('y' if feature.name in OPTIONS[name].features else 'n')
    terminal.see('Enter shows start 1.')
    terminal.press(ENTER)


def demonstrate(terminal: Terminal, option: ReferenceOption) -> None:
    """Demonstrate from what is on the screen, or say not here, without looking up."""
    state, keys = state_shown(terminal.words()), list[str]()
    while option.can_start(state) and not option.ends(state):
        action = option.optimal_actions(state)[0]
        keys.append(TAXI.actions[action].key)
        state = TAXI.step(state, action, generator(0)).state
    terminal.press(*([*keys, ENTER] if keys else ['n']))


def state_shown(words: str) -> TaxiState:
    """Read the state from the features beside the board; what is hidden does not matter."""
    found = dict(re.findall(r'(\w+ (?:row|col|in taxi)) (\w+)', words))

    def place(who: str, hidden: int) -> int:
        if f'{who} row' not in found:
            return hidden
        return CELLS.index((int(found[f'{who} row']), int(found[f'{who} col'])))

    aboard = found['passenger in taxi'] == 'yes'
    passenger = ABOARD if aboard else place('passenger', 0)
    destination = place('destination', 1 if passenger == 0 else 0)
    return TaxiState(int(found['taxi row']), int(found['taxi col']), passenger, destination)
