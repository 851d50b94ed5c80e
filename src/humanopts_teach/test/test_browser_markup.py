"""What a page shows of a view: its texts are escaped, and its buttons stand for keys."""

from dataclasses import replace
import json
from xml.etree import ElementTree

from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Transition
from humanopts_learner.summary import Criterion, OptionSummary
from humanopts_teach.browser.markup import head_html, PARTS, parts
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.entry import ConfirmScreen, HelpScreen, Item, ListScreen, TextScreen
from humanopts_teach.dialogue.keys import key_of, key_table, KeyCommand, label
from humanopts_teach.dialogue.menu import opening, to_lesson
from humanopts_teach.dialogue.panel import view
from humanopts_teach.lesson.requests import LessonView, Phase
import pytest

NASTY = '<script>alert("x")</script>&\''


@pytest.fixture
def app() -> App:
    """A dialogue in whose lesson a demonstration is under way; a person has chosen all names."""
    app = App(opening(NASTY))
    app.participant = NASTY
    app.world.domain = make_domain('taxi')
    app.world.game = Transition(episode=2, step=0, state='taxi 2,3 passenger R destination B')
    app.world.lesson = LessonView(
        Phase.DEMONSTRATING, NASTY, NASTY, NASTY, paused=NASTY, text=NASTY, episode=2
    )
    found = Criterion('initiation', 0.1, 0.05, met=False)
    status = OptionSummary(NASTY, NASTY, criteria=(found,), conflicts=(NASTY,))
    app.world.summaries = [status]
    return app


def shown(app: App) -> ElementTree.Element:
    """Return the page as a tree: it can be read only where everything is closed and escaped."""
    found = parts(view(app))
    assert tuple(found) == PARTS
    html = ''.join(f'<div class="{name}">{html}</div>' for name, html in found.items())
    return ElementTree.fromstring(f'<page>{html}</page>')


def buttons(app: App) -> dict[str, list[str]]:
    """Return the keys of each button by its words."""
    return {
        ' '.join((button.get('title') or ''.join(button.itertext())).split()): json.loads(keys)
        for button in shown(app).iter('button')
        if (keys := button.get('data-keys'))
    }


def words(app: App) -> str:
    """Return all texts of the page."""
    return ''.join(shown(app).itertext())


def test_what_a_person_named_is_text_and_no_html(app: App) -> None:
    items = [Item(NASTY, NASTY, to_lesson)]
    for screen in (
        *(None, TextScreen(NASTY, NASTY, typed=NASTY), ListScreen(NASTY, items)),
        *(ConfirmScreen(NASTY, to_lesson, to_lesson), HelpScreen([(NASTY, NASTY)], to_lesson)),
    ):
        if screen is None:
            to_lesson(app)
        else:
            app.show(screen)
        assert '<script' not in ''.join(parts(view(app)).values())
        assert NASTY in words(app)


def test_a_name_in_a_question_is_text(app: App) -> None:
    to_lesson(app)
    app.world.lesson = replace(app.world.lesson, phase=Phase.ASKING, question=f'{NASTY}?')
    assert f'{NASTY}?' in words(app)


def test_the_typed_text_is_the_value_of_the_field(app: App) -> None:
    (field,) = shown(app).iter('input')
    assert field.get('value') == NASTY
    assert buttons(app) == {}  # the field has its own button


def test_every_key_of_a_demonstration_has_a_button(app: App) -> None:
    to_lesson(app)
    found = buttons(app)
    assert (found['north'], found['west'], found['p pickup']) == (['up'], ['left'], ['p'])
    pressed = {key for keys in found.values() for key in keys}
    table = key_table(
        make_domain('taxi').actions, (KeyCommand.DONE, KeyCommand.NOT_HERE, KeyCommand.MENU)
    )
    assert pressed >= {*table.actions, *table.commands}


def test_a_choice_moves_there_and_picks_it(app: App) -> None:
    items = [Item(str(number), '', to_lesson) for number in range(12)]
    app.show(ListScreen('Which?', items, at=10))
    choices = list(buttons(app).values())[:12]
    assert choices[9:] == [['1'], ['2'], ['3']]  # of its page
    assert choices[8] == ['up', 'up', 'enter']
    app.show(ListScreen('Which?', items, at=0))
    choices = list(buttons(app).values())[:12]
    assert (choices[0], choices[10]) == (['1'], ['up', 'up', 'enter'])  # around the end


def test_a_choice_whose_way_is_drawn_has_buttons_to_go_along_it(app: App) -> None:
    way = ('taxi 2,3 passenger R destination B', 'taxi 1,3 passenger R destination B')
    app.show(ListScreen('Which?', [Item('plain', '', to_lesson), Item('way', '', to_lesson, way)]))
    assert not {'up', 'right', 'enter'} & {keys[0] for keys in buttons(app).values()}
    app.show(ListScreen('Which?', [Item('way', '', to_lesson, way)]))
    pressed = {keys[0] for keys in buttons(app).values()}
    assert pressed >= {'up', 'down', 'left', 'right', 'enter'}


@pytest.mark.parametrize('key', ['enter', 'escape', 'backspace', ' ', 'up', 'q', '?'])
def test_the_label_of_a_key_leads_back_to_it(key: str) -> None:
    assert key_of(label(key)) == key


@pytest.mark.parametrize('label', ['↑ ↓', '1-9', ''])
def test_labels_of_several_keys_have_no_button(label: str) -> None:
    assert key_of(label) == ''


def test_a_criterion_is_a_bar_with_a_mark_at_its_target(app: App) -> None:
    to_lesson(app)
    (bar,) = [div for div in shown(app).iter('div') if div.get('class') == 'bar']
    assert [part.get('style') for part in bar] == ['width:66.7%', 'left:33.3%']


def test_pages_ask_no_other_server() -> None:
    assert 'http' not in head_html().replace('http://www.w3.org', '')
    assert '@import' not in head_html()


def test_the_board_keeps_its_place_while_the_learner_works(app: App) -> None:
    to_lesson(app)
    for phase, driving in ((Phase.LEARNING, True), (Phase.READY, False), (Phase.ASKING, False)):
        app.world.lesson = replace(app.world.lesson, phase=phase)
        assert ('class="driving"' in parts(view(app))['keys']) is driving
