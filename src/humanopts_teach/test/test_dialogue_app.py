"""The dialogue: who teaches, its menu, silent nodes, late keys, and a lesson that is paused."""

from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_learner.demonstrations import GOAL
from humanopts_teach.dialogue.app import REPLY_SECONDS, SETTLE_SECONDS
from humanopts_teach.dialogue.menu import opening
from humanopts_teach.lesson.requests import (
    BeginDemonstration,
    DefineOption,
    EndDemonstration,
    OpenSession,
    Phase,
    SetControl,
    UNKNOWN,
    Verdict,
)
import pytest
from teach_support.person import CHOSEN, NAME, Person


def test_enter_accepts_the_proposed_code_and_leads_to_the_menu(person: Person) -> None:
    assert person.sees_words('Who teaches? > p1')
    request = person.press('enter')
    assert request == OpenSession('p1')
    person.lesson(Phase.NO_OPTION, participant='p1')
    person.answer(request, known_options=('fetch',))
    assert person.sees_words('What next?')
    assert person.sees_words('Go on teaching an option')


def test_a_code_that_was_given_is_not_asked_for(taxi: Domain[Any]) -> None:
    person = Person(taxi)
    person.app.screen = opening('anna', ask=False)
    lesson, person.world.lesson = person.world.lesson, UNKNOWN
    person.look()
    assert person.asked == []  # the lesson is not there yet
    person.world.lesson = lesson
    request = person.look()
    assert person.asked == [OpenSession('anna')]
    person.answer(request, ok=False)
    person.look()
    assert person.sees_words('Who teaches? > anna')
    assert person.asked == [OpenSession('anna')]  # refused: the person decides
    assert person.press('enter') == OpenSession('anna')


@pytest.mark.parametrize('erased', [0, 2])
def test_another_code_can_be_typed_over_the_proposed_one(person: Person, erased: int) -> None:
    assert person.press(*['backspace'] * erased, *'anna-2', 'enter') == OpenSession('anna-2')


def test_the_proposed_code_can_be_mended(person: Person) -> None:
    assert person.press('backspace', '7', 'enter') == OpenSession('p7')


def test_a_refused_code_stays_to_be_mended_with_the_reason(person: Person) -> None:
    person.answer(person.type('p1!'), ok=False, text="'p1!' is not a code")
    assert person.sees_words("'p1!' is not a code")
    assert person.sees_words('> p1!')


def test_a_key_of_an_earlier_frame_counts_only_while_its_screen_is_shown(person: Person) -> None:
    first = person.app.drawn()
    person.app.type(['backspace'], first)
    person.look()
    assert person.sees_words('> p')
    second = person.app.drawn()
    person.app.type(['7', 'enter'], first)  # the same screen, one frame late
    opened = person.look()
    assert opened == OpenSession('p7')
    person.lesson(Phase.NO_OPTION, participant='p7')
    person.answer(opened)
    person.app.type(['1'], second)  # the menu came meanwhile
    assert person.look() is None
    assert person.sees_words('1 came before this was shown, and is not taken.')
    assert person.sees_words('What next?')
    person.app.type(['1'], 10**6)  # of no frame that is known
    person.look()
    assert person.sees_words('What next?')


def test_a_silent_node_is_named_after_the_deadline_and_nothing_hangs(person: Person) -> None:
    person.press('enter')
    person.now = REPLY_SECONDS
    assert person.look() is None
    assert person.sees_words('lesson does not answer.')
    assert person.press('enter') == OpenSession('p1')


def test_topics_that_lag_behind_an_answer_hold_nothing_up(person: Person) -> None:
    request = person.press('enter')
    assert person.answer(request) is None
    person.now = SETTLE_SECONDS
    person.look()
    assert person.sees_words('What next?')


def test_an_answer_that_comes_after_the_deadline_is_ignored(person: Person) -> None:
    late = person.press('enter')
    person.now = REPLY_SECONDS
    person.look()
    person.answer(late)
    assert person.sees_words('Who teaches?')


def test_ctrl_c_ends_at_once_whatever_is_under_way(shower: Person) -> None:
    shower.press('left')
    shower.press('ctrl-c')
    assert shower.app.ended
    shower.world.holder = 'me'
    assert shower.app.last_requests() == [
        EndDemonstration(Verdict.DISCARD, 2, 0),
        SetControl(hold=False),
    ]


def test_a_demonstration_left_by_a_cut_connection_is_taken_up(person: Person) -> None:
    person.lesson(Phase.DEMONSTRATING, participant='p1', option_name=NAME, chosen_features=CHOSEN)
    assert person.press('enter') is None
    assert person.sees_words(f'Teaching: {NAME}')


def test_nodes_that_are_gone_are_named(shower: Person) -> None:
    shower.world.missing = ('lesson',)
    assert shower.sees_words('lesson: not there. Everything taught is saved; Ctrl-C quits.')


def test_how_an_option_is_learned_can_be_changed_in_the_menu(teacher: Person) -> None:
    teacher.press('escape', '6', '1')
    assert teacher.sees_words('Learn it by goal')
    assert teacher.press('3') == DefineOption(NAME, method=GOAL)
    teacher.lesson(Phase.READY, method=GOAL)
    assert teacher.answer(teacher.asked[-1]) is None
    assert teacher.sees_words(f'Teaching: {NAME}')


FULL = 'recording stopped: the disk is full. Free some space.'


@pytest.mark.parametrize('key', ['', '?', 'escape'])
def test_a_paused_lesson_says_why_on_every_screen(shower: Person, key: str) -> None:
    shower.lesson(Phase.DEMONSTRATING, paused=FULL)
    shower.press(*filter(None, [key]))
    assert shower.sees_words(f'PAUSED: {FULL}')
    assert f'PAUSED: {FULL}' in shower.sees(70, 20)
    shower.lesson(Phase.DEMONSTRATING, paused='')
    assert 'PAUSED' not in shower.sees()


def test_while_the_lesson_is_paused_the_next_start_waits_for_a_key(shower: Person) -> None:
    ended = shower.press('enter')
    assert isinstance(ended, EndDemonstration)
    shower.lesson(Phase.READY, paused=FULL)
    assert shower.answer(ended) is None
    assert shower.sees_words('The lesson is paused.')
    assert shower.lesson(Phase.READY, paused='') is None
    assert shower.press('enter') == BeginDemonstration()
