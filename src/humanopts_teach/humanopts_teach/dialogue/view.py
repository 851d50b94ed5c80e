"""The view of a dialogue: the current screen and the elements common to all screens."""

from humanopts_env.board import Board
from humanopts_env.domains.capabilities import board_of
from humanopts_env.domains.described import can_simulate, published_state
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.keys import key_table, label
from humanopts_teach.dialogue.panel import Key, Line, Panel, ScreenView, Tone
from humanopts_teach.lesson.requests import Phase

_ALL_FEATURES = {Phase.NO_SESSION, Phase.NO_OPTION, Phase.ASKING}  # phases that hide no features


def view(app: App) -> ScreenView:
    """Return the current view."""
    screen, world = app.screen, app.world
    known = world.domain is not None
    return ScreenView(
        _head(app),
        screen.panel(app) if known else Panel((Line('Waiting for the game ...'),)),
        _said(app),
        [
            Key(key, label(key) if each.label is None else each.label, each.words)
            for key, each in key_table(screen.commands(app)).items()
            if each.do is not None
        ],
        world.lesson.paused,
        _board(app) if known and screen.shows_board else None,
        screen.plays(app),
    )


def _head(app: App) -> list[str]:
    world, parts = app.world, ['humanopts']
    if world.domain is not None:
        parts.append(world.domain.name)
    if app.participant:
        parts.append(app.participant)
        if world.lesson.session:
            parts.append(f'session {world.lesson.session}')
    if world.holder:
        parts.append('you drive' if world.i_drive else 'another person drives')
    return parts


def _said(app: App) -> Line:
    """Return the latest message to the person."""
    if app.world.missing:
        names = ', '.join(app.world.missing)
        return Line(f'Missing: {names}. Everything taught is saved; {app.way_out}.', Tone.BAD)
    if app.message.text:
        return app.message
    return Line(app.world.lesson.text if app.screen.answers_lesson else '', Tone.GOOD)


def _board(app: App) -> Board:
    """Return the board; without rules, only the current state of a domain can be drawn."""
    domain, game, lesson = app.domain, app.world.game, app.world.lesson
    state = app.screen.state or game.state
    if not state or not (can_simulate(domain) or state == game.state):
        return Board()
    hides = app.screen.hides_features and lesson.phase not in _ALL_FEATURES
    shown = published_state(domain, state, game.features)
    return board_of(domain, shown, lesson.chosen_features if hides else None)
