"""Times to draw the screen after a step, in a terminal and on a page."""

from itertools import cycle
from typing import Any

from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Command, Game, Source
from humanopts_teach.browser.markup import parts
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.driving import PlayScreen
from humanopts_teach.dialogue.view import view
from humanopts_teach.terminal.drawing import frame
import pytest

DOMAINS = ('taxi', 'gymnasium:MiniGrid-DoorKey-8x8-v0', 'gymnasium:LunarLander-v3')
STEPS = 50  # of the episode, which is drawn repeatedly
WINDOW = 120, 40  # columns, rows


@pytest.mark.parametrize('domain', DOMAINS)
@pytest.mark.parametrize('place', ['terminal', 'page'])
def bench_screen(benchmark: Any, domain: str, place: str) -> None:
    """Draw the screen after each step; Taxi, which is drawn from its cells, is the yardstick."""
    benchmark.group, benchmark.name = f'a step, to its screen in a {place}', domain
    game = Game(make_domain(domain))
    seen = [game.reset('', 1, Source.PERSON).transition]
    for step in range(STEPS):
        action = game.domain.actions[step % 2].name
        game.command(Command('bench', step + 1, Source.PERSON, 1, step, action))
        seen.append(game.transition)
    app = App(PlayScreen(App.end))
    app.world.domain = make_domain(domain)  # separate from the game's domain
    states = cycle(seen)

    def draw() -> None:
        app.world.game = next(states)  # type: ignore[assignment]
        if place == 'terminal':
            frame(app, *WINDOW, 'truecolor')
        else:
            parts(view(app))

    benchmark.pedantic(draw, rounds=4 * STEPS, warmup_rounds=STEPS)
