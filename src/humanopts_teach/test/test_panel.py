"""What the terminal and the page draw: values of a lesson, and every kind of block as HTML."""

from dataclasses import replace
import json
from typing import get_args
from xml.etree import ElementTree

from humanopts_env.colours import GREY
from humanopts_env.domains.base import Feature
from humanopts_env.domains.described import DescribedDomain
from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Transition
from humanopts_learner.summary import Criterion, OptionSummary
from humanopts_teach.browser.markup import head_html, PARTS, parts
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.entry import Item, ListScreen
from humanopts_teach.dialogue.menu import opening, to_lesson
from humanopts_teach.dialogue.panel import (
    Block,
    Choices,
    Criteria,
    CriterionRow,
    Features,
    Key,
    KeyList,
    Line,
    Options,
    Page,
    Panel,
    Rating,
    ScreenView,
    TARGET,
    Tone,
    TypedText,
)
from humanopts_teach.dialogue.view import EMPTY, view
from humanopts_teach.lesson.requests import LessonView, Phase
from humanopts_teach.terminal.drawing import drawn, frame
import pytest

NASTY = '<script>alert("x")</script>&\''
HERE, NORTH = 'taxi 2,3 passenger R destination B', 'taxi 1,3 passenger R destination B'


@pytest.fixture
def app() -> App:
    """A lesson in which a demonstration is under way."""
    app = App(opening('p1'))
    app.participant = 'p1'
    app.world.domain = make_domain('taxi')
    app.world.game = Transition(episode=2, step=0, state=HERE)
    chosen = 'taxi_row', 'taxi_col'
    app.world.lesson = LessonView(
        Phase.DEMONSTRATING, 'p1', 's1', 'fetch', chosen_features=chosen, budget=100, episode=2
    )
    to_lesson(app)
    return app


def block(app: App, kind: type) -> Block:
    (found,) = [each for each in view(app).panel.beside if isinstance(each, kind)]
    return found


def tree(view: ScreenView) -> ElementTree.Element:
    """Return the page as a tree: it parses only if everything is closed and escaped."""
    found = parts(view)
    assert tuple(found) == PARTS
    html = ''.join(f'<div class="{name}">{html}</div>' for name, html in found.items())
    return ElementTree.fromstring(f'<page>{html}</page>')


def buttons(app: App) -> dict[str, list[str]]:
    """Return the keys of each button of the page by its words."""
    return {
        ' '.join((button.get('title') or ''.join(button.itertext())).split()): json.loads(keys)
        for button in tree(view(app)).iter('button')
        if (keys := button.get('data-keys'))
    }


def test_a_lesson_shows_the_chosen_features_and_no_others(app: App) -> None:
    features = Features([('taxi row', '2'), ('taxi col', '3')], 'all else is hidden')
    assert block(app, Features) == features
    board = view(app).board
    assert board is not None
    assert 'destination' not in [mark.name for mark in board.marks]


def test_a_board_on_which_nothing_chosen_has_a_place_says_so_and_is_grey(app: App) -> None:
    app.world.lesson = replace(app.world.lesson, chosen_features=('passenger_in_taxi',))
    board = view(app).board
    assert board is not None
    assert {mark.name for mark in board.marks} == {'landmarks'}
    assert (board.colour, board.notes[0]) == (GREY, EMPTY)
    assert EMPTY in '\n'.join(frame(app, 80, 24))
    assert EMPTY in parts(view(app))['board']


def test_without_rules_the_features_of_the_state_are_listed(app: App) -> None:
    far = Feature.continuous('far', 'how far it is', 0.0, 9.0, 'm')
    actions = list(make_domain('taxi').actions)
    app.world.domain = DescribedDomain('rover', {}, [far], actions, 0.9, 100)
    app.world.game = Transition(2, 0, 'anything', features=(3.14159,))
    app.world.lesson = replace(app.world.lesson, chosen_features=('far',))
    assert block(app, Features) == Features([('far', '3.142 m')], in_rows=True)
    assert 'far 3.142 m' in frame(app, 80, 24)
    assert '<li><span>far</span> <b class="news">3.142 m</b></li>' in parts(view(app))['panel']


@pytest.mark.parametrize(
    ('value', 'threshold', 'share'),
    [
        *((0.05, 0.05, TARGET), (0.0, 0.05, 0.0), (0.1, 0.05, 2 * TARGET), (0.9, 0.05, 1.0)),
        *((-3.0, 0.5, 0.0), (0.0, 0.0, 0.0), (0.1, 0.0, 1.0)),
    ],
)
def test_a_bar_reaches_its_mark_at_the_threshold_and_its_end_at_three_times_that(
    app: App, value: float, threshold: float, share: float
) -> None:
    found = Criterion('initiation', value, threshold, met=False)
    app.world.summaries = [OptionSummary('fetch', 'p1', criteria=(found,))]
    criteria = block(app, Criteria)
    assert isinstance(criteria, Criteria)
    assert criteria.rows[0].share == pytest.approx(share)
    (bar,) = [div for div in tree(view(app)).iter('div') if div.get('class') == 'bar']
    assert [part.get('style') for part in bar] == [f'width:{100 * share:.1f}%', 'left:33.3%']


def test_a_bar_of_a_share_shows_what_is_missing(app: App) -> None:
    found = Criterion.of('success', 0.9, 0.95)
    app.world.summaries = [OptionSummary('fetch', 'p1', criteria=(found,))]
    criteria = block(app, Criteria)
    assert isinstance(criteria, Criteria)
    assert criteria.rows[0].share == pytest.approx(2 * TARGET)


def test_every_kind_of_block_is_drawn_and_its_texts_are_escaped() -> None:
    row = CriterionRow(NASTY, NASTY, NASTY, NASTY, Tone.GOOD, 0.5)
    blocks: list[Block] = [
        *(Line(NASTY, more=(Line(NASTY),)), Choices([(NASTY, NASTY)], 0), Criteria([row])),
        *(Rating(7, NASTY, NASTY, 3), Options((NASTY, NASTY), frozenset({1}), several=True)),
        *(KeyList([(NASTY, NASTY)]), Features([(NASTY, NASTY)], NASTY), Page(NASTY)),
    ]
    assert {type(block) for block in blocks} == {*get_args(Block)} - {TypedText}
    for each in blocks:
        assert str(drawn(each))
        shown = ScreenView((NASTY,), Panel([each]), Line(NASTY), [Key('k', 'k', NASTY)], NASTY)
        texts = ''.join(tree(shown).itertext())
        assert texts.count(NASTY) >= 5
        assert '<script' not in ''.join(parts(shown).values())
    (field,) = tree(ScreenView((), Panel([TypedText(NASTY)]))).iter('input')
    assert field.get('value') == NASTY
    text = '*a page* <b> ![p](http://x.org/p.png)'
    assert '<em>a page</em> &lt;b&gt;' in (
        page := parts(ScreenView((), Panel([Page(text)])))['panel']
    )
    assert '<img' not in page


def test_every_key_of_a_demonstration_has_a_button(app: App) -> None:
    found = buttons(app)
    assert (found['north'], found['west'], found['p pickup']) == (['up'], ['left'], ['p'])
    shown = {each.key for each in view(app).keys if each.label}
    assert {key for keys in found.values() for key in keys} == shown >= {'enter', 'n', 'escape'}


def test_a_point_of_a_scale_is_a_button_that_chooses_it_and_erases_before() -> None:
    view = ScreenView((), Panel([Rating(21, 'low', 'high', 17)]))
    points = list(tree(view).iter('button'))
    assert [json.loads(each.get('data-keys', ''))[1:] for each in points[9:11]] == [
        ['1', '0'],
        ['1', '1'],
    ]
    assert [each.text for each in points if each.get('aria-checked') == 'true'] == ['17']


def test_a_choice_is_a_button_that_moves_there_and_chooses_it(app: App) -> None:
    items = [Item(str(number), '', to_lesson) for number in range(12)]
    app.show(ListScreen('Which?', items, at=10))
    choices = list(buttons(app).values())[:12]
    assert choices[8:] == [['up', 'up', 'enter'], ['1'], ['2'], ['3']]  # digits of its page
    app.show(ListScreen('Which?', items))
    choices = list(buttons(app).values())
    assert (choices[0], choices[10]) == (['1'], ['up', 'up', 'enter'])  # around the end
    pressed = {keys[0] for keys in choices[12:]}
    assert not pressed & {'up', 'right', 'enter', '1'}
    app.show(ListScreen('Which?', [Item('way', '', to_lesson, (HERE, NORTH))]))
    assert {keys[0] for keys in buttons(app).values()} >= {'up', 'down', 'left', 'right', 'enter'}


def test_pages_ask_no_other_server() -> None:
    assert 'http' not in head_html().replace('http://www.w3.org', '')
    assert '@import' not in head_html()


def test_the_board_keeps_its_place_while_the_learner_works(app: App) -> None:
    for phase, driving in ((Phase.LEARNING, True), (Phase.READY, False), (Phase.ASKING, False)):
        app.world.lesson = replace(app.world.lesson, phase=phase)
        assert ('class="driving"' in parts(view(app))['keys']) is driving
