"""The view of a dialogue: the current screen and the elements common to all screens."""

from dataclasses import replace

from humanopts_env.board import Board
from humanopts_env.colours import GREY
from humanopts_env.domains.capabilities import board_of, caption_of, pictured_board_of
from humanopts_env.domains.described import can_simulate, published_state
from humanopts_env.domains.formulas import feature_columns, plain_name
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.driving import robot_lines
from humanopts_teach.dialogue.keys import key_table, label, SPACE
from humanopts_teach.dialogue.panel import Features, GAP, Key, Line, Panel, ScreenView, Tone
from humanopts_teach.language import _, in_its_language, N_, translated
from humanopts_teach.lesson.requests import Phase

_SEEN = N_('the picture shows more than the option sees')
_NO_PICTURE = N_('No picture: it needs a terminal with colours.')
EMPTY = N_('nothing that you chose appears on the board')
_ALL_FEATURES = {Phase.NO_SESSION, Phase.NO_OPTION, Phase.ASKING}  # phases that show all features


@in_its_language
def view(app: App, *, images: bool = True) -> ScreenView:
    """
    Return the current view.

    :param images: whether images can be shown; False: show a note instead.
    """
    screen, world = app.screen, app.world
    keys = [
        Key(key, label(key) if each.label is None else each.label, _(each.words))
        for key, each in key_table(screen.commands(app)).items()
        if each.do is not None and not (world.robot and key == SPACE)
    ]
    if world.robot:
        keys.insert(0, Key(SPACE, label(SPACE), _('stop the robot')))
    board, panel = Board(), Panel((Line(_('Waiting for the game ...')),))
    if world.domain is not None or not app.needs_game:
        panel = screen.panel(app)
        panel = replace(panel, beside=(*robot_lines(app), *panel.beside))
        # New values of features would replace a text field of the page while a person types.
        if screen.shows_board and not (world.robot and screen.takes_text):
            board, panel = _drawn(app, panel, images)
    return ScreenView(
        _head(app),
        panel,
        _message_line(app),
        keys,
        translated(world.lesson.paused),
        board if board.drawn else None,
        screen.plays(app),
        app.language,
        app.task,
    )


def _head(app: App) -> list[str]:
    world, parts = app.world, ['humanopts']
    if world.domain is not None:
        parts.append(translated(world.domain.name))
    if app.participant:
        parts.append(app.participant)
    if world.holder:
        parts.append(_('you drive') if world.in_control else _('another person drives'))
    # Last: a narrow screen cuts off the end.
    if app.participant and world.lesson.session and not app.in_study:
        parts.append(_('session {session}').format(session=world.lesson.session))
    return [*parts, app.clock] if app.clock else parts


def _message_line(app: App) -> Line:
    """Return the latest message to the person."""
    if app.world.missing:
        names = ', '.join(app.world.missing)
        return Line(
            _('Missing: {names}. Everything taught is saved; {hint}.').format(
                names=names, hint=_(app.leave_hint)
            ),
            Tone.BAD,
        )
    if app.message.text:
        return app.message
    lesson = app.world.lesson
    if app.run is not None and app.world.robot and lesson.phase is Phase.DEMONSTRATING:
        verdict = _('say wrong') if lesson.exam else _('take over')
        return Line(
            _('Watch the option, and {verdict} as soon as it goes wrong.').format(verdict=verdict),
            Tone.GOOD,
        )
    return Line(translated(app.world.lesson.text) if app.screen.answers_lesson else '', Tone.GOOD)


def _drawn(app: App, panel: Panel, images: bool) -> tuple[Board, Panel]:
    """
    Return the board, and the panel with a table of features if the board has no cells.

    Without rules, only the current state of a domain can be drawn.
    """
    domain, game, lesson = app.domain, app.world.game, app.world.lesson
    state = app.screen.state or game.state
    if not state or not (can_simulate(domain) or state == game.state):
        return Board(), panel
    hides = app.screen.hides_features and lesson.phase not in _ALL_FEATURES
    here = published_state(domain, state, game.features)
    shown = lesson.chosen_features if hides else None
    if can_simulate(domain) and (mission := caption_of(domain, here)):
        panel = replace(
            panel,
            below=(
                Line(_('Mission: {mission}.').format(mission=translated(mission))),
                *panel.below,
            ),
        )
    board = _in_words(pictured_board_of(domain, here, shown)) if app.pictures else Board()
    if board.rows:
        if shown is not None and board.marks == _in_words(board_of(domain, here, ())).marks:
            board = replace(board, colour=GREY, notes=(_(EMPTY), *board.notes))
        return board, panel
    if board.image is not None and not images:
        board, panel = (
            Board(),
            replace(panel, below=(*panel.below, Line(_(_NO_PICTURE), Tone.QUIET))),
        )
    every = [*(each.name for each in domain.features), *lesson.derived_features]
    columns = feature_columns(domain, every if shown is None else shown)
    row = domain.feature_values(here)
    values = [
        (translated(plain_name(each.feature.name)), translated(each.text(row))) for each in columns
    ]
    table = Features(values, in_rows=True)
    board, blocks = replace(board, notes=()), list(panel.beside)
    for number, block in enumerate(blocks):
        if isinstance(block, Features):
            hidden = _(_SEEN) if block.hidden and board.drawn else block.hidden
            blocks[number] = replace(table, hidden=hidden)
            return board, replace(panel, beside=blocks)
    return board, replace(panel, below=(*panel.below, GAP, replace(table, chosen=False)))


def _in_words(board: Board) -> Board:
    """Return a board with translated texts."""
    marks = tuple(replace(mark, name=translated(mark.name)) for mark in board.marks)
    notes = tuple(map(translated, board.notes))
    return replace(board, marks=marks, notes=notes, unseen=_(board.unseen))
