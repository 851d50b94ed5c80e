"""What the terminal and the page in the browser draw, as plain values."""

from dataclasses import replace
from typing import get_args

from humanopts_env.domains.base import Feature
from humanopts_env.domains.described import DescribedDomain
from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Transition
from humanopts_learner.summary import Criterion, OptionSummary
from humanopts_teach.browser.markup import parts
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.entry import Item
from humanopts_teach.dialogue.menu import opening, to_lesson, to_menu
from humanopts_teach.dialogue.panel import (
    Block,
    Choices,
    Criteria,
    CriterionShown,
    Features,
    FeatureShown,
    KeyList,
    Line,
    Page,
    Panel,
    TARGET,
    Tone,
    TypedText,
    view,
)
from humanopts_teach.lesson.requests import LessonView, Phase
from humanopts_teach.terminal.drawing import drawn
import pytest

NAME = 'fetch <b>&'
FAR = Feature.continuous('far', 'how far it is', 0.0, 9.0, 'm')
CHOSEN = ('taxi_row', 'taxi_col')


@pytest.fixture
def app() -> App:
    """A dialogue in whose lesson a demonstration is under way."""
    app = App(opening('p1'))
    app.participant = 'p1'
    app.world.domain = make_domain('taxi')
    app.world.game = Transition(episode=2, step=0, state='taxi 2,3 passenger R destination B')
    app.world.lesson = LessonView(
        Phase.DEMONSTRATING, 'p1', 's1', NAME, chosen_features=CHOSEN, budget=100, episode=2
    )
    return app


def test_a_person_who_has_just_come_is_asked_for_a_code(app: App) -> None:
    shown = view(app)
    assert shown.panel.beside[0] == Line('Who teaches?', strong=True)
    assert TypedText('p1') in shown.panel.beside
    assert list(shown.head) == ['humanopts', 'taxi', 'p1', 'session s1']


def test_the_menu_has_choices_of_which_one_is_marked(app: App) -> None:
    to_menu(app)
    (choices,) = [block for block in view(app).panel.beside if isinstance(block, Choices)]
    assert [item.text for item in choices.items][:1] == ['Teach a new option']
    assert choices.at == 0


def test_a_lesson_shows_the_chosen_features_with_their_values_and_no_others(app: App) -> None:
    to_lesson(app)
    shown = view(app)
    (features,) = [block for block in shown.panel.beside if isinstance(block, Features)]
    values = [(feature.name, feature.value) for feature in features.shown]
    assert values == [('taxi row', '2'), ('taxi col', '3')]
    assert features.hidden == 'all else is hidden'
    assert shown.board is not None
    assert 'destination' not in [mark.name for mark in shown.board.marks]
    assert shown.panel.beside[0] == Line('Teaching: ', more=(Line(NAME, strong=True),))


@pytest.mark.parametrize(
    ('value', 'threshold', 'share'),
    [
        *((0.05, 0.05, TARGET), (0.0, 0.05, 0.0), (0.1, 0.05, 2 * TARGET), (0.9, 0.05, 1.0)),
        *((-3.0, 0.5, 0.0), (0.0, 0.0, 0.0), (0.1, 0.0, 1.0), (None, 0.05, None)),
    ],
)
def test_a_bar_reaches_its_mark_at_the_threshold_and_its_end_at_three_times_that(
    app: App, value: float | None, threshold: float, share: float | None
) -> None:
    to_lesson(app)
    found = Criterion('initiation', value, threshold, met=False)
    app.world.summaries = [OptionSummary(NAME, 'p1', criteria=(found,))]
    (criteria,) = [block for block in view(app).panel.beside if isinstance(block, Criteria)]
    assert criteria.rows[0].share == pytest.approx(share)


def test_every_kind_of_block_is_drawn_in_the_terminal_and_on_the_page(app: App) -> None:
    row = CriterionShown('✓', 'return', '0.5', '≤ 1', Tone.GOOD, 0.5)
    blocks: list[Block] = [
        *(Line('a line'), TypedText('typed'), Choices([Item('an item', '', to_menu)], 0)),
        *(KeyList([('k', 'a key')]), Features([FeatureShown('a feature', '')], '')),
        *(Criteria([row]), Page('*a page* <b>')),
    ]
    assert {type(block) for block in blocks} == set(get_args(Block))
    for block in blocks:
        assert str(drawn(block))
        shown = replace(view(app), panel=Panel([block]))
        assert parts(shown)['panel'] != parts(replace(shown, panel=Panel()))['panel']
    page = parts(replace(view(app), panel=Panel([Page('*a page* <b> ![p](http://x.org/p.png)')])))[
        'panel'
    ]
    assert '<em>a page</em> &lt;b&gt;' in page
    assert '<img' not in page


def test_nodes_that_are_missing_are_said_before_anything_else(app: App) -> None:
    app.say('well done')
    assert view(app).said == Line('well done', Tone.GOOD)
    app.world.missing, app.way_out = ('lesson',), 'come back later'
    saved = 'Missing: lesson. Everything taught is saved; come back later.'
    assert view(app).said == Line(saved, Tone.BAD)


def test_a_lesson_that_is_paused_says_why(app: App) -> None:
    app.world.lesson = replace(app.world.lesson, paused='the disk is full')
    assert view(app).paused == 'the disk is full'


def test_what_is_seen_of_a_domain_without_rules_is_its_features(app: App) -> None:
    rover = DescribedDomain('rover', {}, [FAR], list(make_domain('taxi').actions), 0.9, 100)
    app.world.domain = rover
    app.world.game = Transition(2, 0, 'anything', features=(3.14159,))
    app.world.lesson = replace(app.world.lesson, chosen_features=('far',))
    to_lesson(app)
    shown = view(app)
    assert shown.board is not None
    assert shown.board.notes == ('far: 3.142 m',)
    (features,) = [block for block in shown.panel.beside if isinstance(block, Features)]
    assert features.shown == [FeatureShown('far', '3.142 m')]
