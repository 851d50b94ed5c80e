"""What a person mends at the dialogue: watch and correct, undo, look at and delete, rename."""

from dataclasses import replace
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Source, Transition
from humanopts_learner.demonstrations import Demonstration, make_demonstration
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.entry import Item, ListScreen
from humanopts_teach.lesson.requests import (
    BeginDemonstration,
    ChangeOption,
    Drive,
    EndDemonstration,
    ListDemonstrations,
    Phase,
    RunOption,
    SetControl,
    SetPace,
    Verdict,
    WithdrawDemonstration,
)
import pytest
from teach_support.person import AT_G, CHOSEN, NAME, Person, START


def drive(person: Person, *keys: str) -> None:
    """Press keys of actions, and let the game take each step."""
    for key in keys:
        request = person.press(key)
        assert isinstance(request, Drive)
        person.game(
            step=person.world.game.step + 1,
            previous_action=request.action,
            action_source=Source.PERSON,
        )


def shown(number: int = 1, *, withdrawn: bool = False) -> Demonstration:
    """Return a demonstration of two steps."""
    taxi = make_domain('taxi')
    states = [taxi.decode(f'taxi 0,{col} passenger G destination B') for col in (2, 3, 4)]
    demo = make_demonstration(taxi, NAME, states, ('east', 'east'), number=number)
    return replace(demo, withdrawn=withdrawn)


@pytest.fixture
def watcher(shower: Person) -> Person:
    """Somebody who watches the option from a start of the task."""
    shower.lesson(Phase.DEMONSTRATING, n_demonstrations=3)
    discard = shower.press('w')
    assert discard == EndDemonstration(Verdict.DISCARD, 2, 0)
    shower.lesson(Phase.READY)
    request = shower.answer(discard)
    assert isinstance(request, BeginDemonstration)
    assert request.watch
    release = shower.begins(request, 3)
    assert release == SetControl(hold=False)
    run = shower.answer(release)
    assert run == RunOption(NAME, 'p1')
    shower.answer(run)
    return shower


def taken_over(watcher: Person, **game: Any) -> Person:
    """Let the machine take two steps, and the person one."""
    for step in (1, 2):
        watcher.game(step=step, previous_action='north', action_source=Source.MACHINE, **game)
    watcher.lesson(Phase.DEMONSTRATING, machine_steps=2)
    drive(watcher, 'left')
    watcher.run_ends('You took over.')
    return watcher


def test_a_watched_option_begins_at_a_start_of_the_task_that_is_another_each_time(
    watcher: Person, taxi: Domain[Any]
) -> None:
    first = next(r for r in watcher.asked if isinstance(r, BeginDemonstration) and r.watch)
    assert taxi.encode(taxi.decode(first.start_state)) == first.start_state
    watcher.run_ends('it ended')
    watcher.press('w')
    watcher.lesson(Phase.READY)
    second = watcher.answer(watcher.asked[-1])
    assert isinstance(second, BeginDemonstration)
    assert second.start_state != first.start_state


def test_nothing_is_watched_before_something_is_learned(shower: Person) -> None:
    assert 'w watch' not in shower.sees()
    assert shower.press('w') is None


@pytest.mark.parametrize(('answer', 'counts'), [('1', True), ('2', False)])
def test_after_a_correction_the_person_is_asked_once_whether_the_steps_before_count(
    watcher: Person, answer: str, counts: bool
) -> None:
    taken_over(watcher).world.before = None  # so nothing is asked about what the step did
    assert watcher.press('enter') is None
    assert watcher.sees_words('The machine took the first 2. Do its steps count as shown by you?')
    asked = watcher.press(answer)
    assert asked == EndDemonstration(Verdict.DONE, 3, 3, count_machine_steps=counts)


def test_a_run_without_steps_of_the_person_can_only_be_counted_whole(watcher: Person) -> None:
    watcher.game(step=1, previous_action='north', action_source=Source.MACHINE)
    watcher.lesson(Phase.DEMONSTRATING, machine_steps=1)
    watcher.run_ends('it ended')
    watcher.world.before = None
    watcher.press('enter')
    assert 'where I took over' not in watcher.sees()
    assert watcher.press('2') is None
    assert watcher.press('1') == EndDemonstration(Verdict.DONE, 3, 1, count_machine_steps=True)


@pytest.mark.parametrize('key', ['enter', 'n'])
def test_a_verdict_while_the_machine_moves_stops_it_first(watcher: Person, key: str) -> None:
    assert watcher.press(key) == SetControl(hold=True)
    assert watcher.sees_words('The machine has stopped.')


def test_leaving_a_watched_option_stops_the_machine_and_discards(watcher: Person) -> None:
    stop = watcher.press('backspace')
    assert stop == SetControl(hold=True)
    watcher.world.holder = 'me'
    assert watcher.answer(stop) == EndDemonstration(Verdict.DISCARD, 3, 0)


def test_the_machine_waits_takes_single_steps_and_changes_its_speed(watcher: Person) -> None:
    watcher.world.step_period = 0.5
    assert watcher.sees_words('Space wait')
    waits = watcher.press(' ')
    assert waits == SetPace(0.5, paused=True)
    watcher.world.paused_by = 'me'
    watcher.answer(waits)
    assert watcher.sees_words('The machine waits.')
    step = watcher.press('.')
    assert step == SetPace(0.5, paused=True, steps=1)
    watcher.answer(step)
    slower = watcher.press('-')
    assert slower == SetPace(1.0, paused=True)
    watcher.world.step_period = 1.0
    watcher.answer(slower)
    goes = watcher.press(' ')
    assert goes == SetPace(1.0, paused=False)
    watcher.world.paused_by = ''
    watcher.answer(goes)
    assert watcher.sees_words('A step every 1 s at least.')


@pytest.mark.parametrize(
    ('period', 'key', 'then'), [(0.0, '+', 0.0), (2.0, '-', 2.0), (0.3, '+', 0.1)]
)
def test_the_speed_stays_within_what_there_is(
    watcher: Person, period: float, key: str, then: float
) -> None:
    watcher.world.step_period = period
    assert watcher.press(key) == SetPace(then, paused=False)


def test_a_pause_ends_with_the_run(watcher: Person) -> None:
    watcher.world.paused_by = 'me'
    watcher.run_ends('You took over.')
    assert watcher.look() == SetPace(0.0, paused=False)


def test_an_undone_step_is_driven_up_to_in_a_new_episode(shower: Person) -> None:
    drive(shower, 'left', 'up', 'down')
    discard = shower.press('u')
    assert discard == EndDemonstration(Verdict.DISCARD, 2, 3)
    shower.lesson(Phase.READY)
    request = shower.answer(discard)
    assert request == BeginDemonstration(START)
    again = shower.begins(request, 3)
    assert again == Drive('west', 3, 0)
    assert shower.press('p') is None  # keys that come between are not taken
    last = shower.game(step=1, previous_action='west', action_source=Source.PERSON)
    assert last == Drive('north', 3, 1)
    assert shower.game(step=2, previous_action='north', action_source=Source.PERSON) is None
    assert isinstance(shower.press('p'), Drive)


def test_at_the_first_step_there_is_nothing_to_undo(shower: Person) -> None:
    assert shower.press('u') is None
    assert shower.sees_words('There is no step of yours to undo.')


def test_while_the_lesson_is_paused_an_undo_loses_nothing(shower: Person) -> None:
    drive(shower, 'left')
    shower.lesson(Phase.DEMONSTRATING, paused='the disk is full')
    assert shower.press('u') is None
    assert shower.sees_words('Not now: the lesson is paused')


def test_an_undo_after_taking_over_begins_where_the_person_did(watcher: Person) -> None:
    discard = taken_over(watcher, state=AT_G).press('u')
    watcher.lesson(Phase.READY)
    assert watcher.answer(discard) == BeginDemonstration(AT_G)


def test_a_step_whose_beginning_was_not_seen_cannot_be_undone(shower: Person) -> None:
    drive(shower, 'left')
    shower.game(step=4, previous_action='up', action_source=Source.PERSON)
    assert shower.press('u') is None
    assert shower.sees_words('There is no step of yours to undo.')


def test_where_chance_plays_a_part_a_step_cannot_be_undone() -> None:
    rooms = make_domain('rooms')
    person = Person(rooms)
    start = rooms.encode(rooms.state_at(0))  # type: ignore[attr-defined]
    person.world.game = Transition(episode=1, state=start)
    person.names_option(Phase.READY, chosen_features=('row',))
    begun = person.press('enter')
    person.world.update_game(Transition(episode=2, state=start))
    person.lesson(Phase.DEMONSTRATING, episode=2)
    person.answer(begun, episode=2)
    drive(person, 'left')
    assert 'undo' not in person.sees()
    assert person.press('u') is None
    person.press('?')
    assert 'undo' not in person.sees()


def test_all_that_was_shown_is_listed_with_its_way_on_the_board(shower: Person) -> None:
    listed = shower.press('l')
    assert listed == ListDemonstrations()
    shower.answer(listed, demonstrations=(shown(1, withdrawn=True), shown(2)))
    assert shower.sees_words('1 no. 2: 2 steps, return -2 by trees, 0 s')
    assert shower.sees_words('2 no. 1: 2 steps, return -2 by trees, 0 s, DELETED')
    boards = []
    for key in ('right', 'right', 'right', 'left'):
        boards.append(shower.sees().split('\n')[2][:21])
        shower.press(key)
    assert len(set(boards)) == 3  # start, way and end
    assert shower.sees_words('board: step 1 of 2')


def test_any_demonstration_can_be_deleted_once_the_learner_is_done(shower: Person) -> None:
    shower.answer(shower.press('l'), demonstrations=(shown(1), shown(2)))
    shower.press('2')  # the older one
    discard = shower.press('2')
    assert discard == EndDemonstration(Verdict.DISCARD, 2, 0)
    shower.lesson(Phase.READY)
    withdraw = shower.answer(discard)
    assert withdraw == WithdrawDemonstration(shown(1).uuid)
    shower.lesson(Phase.LEARNING)
    shower.answer(withdraw, text='is taken back')
    assert shower.lesson(Phase.READY) == BeginDemonstration()


def test_what_is_deleted_can_be_watched_from_but_not_deleted_again(shower: Person) -> None:
    shower.answer(shower.press('l'), demonstrations=(shown(withdrawn=True),))
    shower.press('1')
    assert not shower.sees_words('Delete it')
    discard = shower.press('1')
    shower.lesson(Phase.READY)
    assert shower.answer(discard) == BeginDemonstration(shown().states[0], watch=True)


def test_escape_leads_from_one_demonstration_to_the_list_and_to_the_lesson(
    shower: Person,
) -> None:
    shower.answer(shower.press('l'), demonstrations=(shown(1), shown(2)))
    shower.press('2')
    assert shower.sees_words('Delete it')
    shower.press('escape')
    assert shower.sees_words('What was shown, the newest first')
    shower.press('escape')
    assert shower.sees_words(f'Teaching: {NAME}')


def test_an_empty_list_is_told(shower: Person) -> None:
    shower.answer(shower.press('l'), demonstrations=())
    assert shower.sees_words('Nothing was shown yet.')


def test_a_finished_lesson_takes_another_demonstration(teacher: Person) -> None:
    teacher.lesson(Phase.FINISHED)
    assert teacher.sees_words('Enter show one more')
    assert teacher.press('enter') == BeginDemonstration()


@pytest.mark.parametrize(('key', 'deleted'), [('1', ''), ('2', 'earlier uuid'), ('3', 'new uuid')])
def test_a_contradiction_is_told_at_once_and_the_person_chooses_what_to_keep(
    shower: Person, key: str, deleted: str
) -> None:
    drive(shower, 'left')
    shower.world.before = None  # what the step did is not known: no question about it
    done = shower.press('enter')
    shower.lesson(Phase.LEARNING)
    asked = shower.answer(
        done,
        uuid='new uuid',
        contradiction='taxi row 0: now south, in demonstration 1 west',
        contradicts='earlier uuid',
        situation=AT_G,
    )
    assert asked is None
    assert shower.sees_words(
        'Shown differently before. taxi row 0: now south, in demonstration 1 west.'
    )
    assert shower.press(key) is None  # the learner works
    then = shower.lesson(Phase.READY)
    assert then == (WithdrawDemonstration(deleted) if deleted else BeginDemonstration())
    if deleted:
        shower.lesson(Phase.READY, last_uuid='other')
        assert shower.answer(then) == BeginDemonstration()


def test_an_option_is_renamed_and_deleted_in_the_menu(teacher: Person) -> None:
    teacher.press('escape', '6', '1', '1')
    rename = teacher.press(*'fetch', 'enter')
    assert rename == ChangeOption(NAME, 'fetch')
    teacher.answer(rename, ok=False, text="there is an option 'fetch' already")
    assert teacher.sees_words("there is an option 'fetch' already")
    rename = teacher.press('s', 'enter')
    assert rename == ChangeOption(NAME, 'fetchs')
    teacher.lesson(Phase.READY, option_name='fetchs')
    teacher.answer(rename, known_options=('fetchs',))
    assert teacher.app.known_options == ('fetchs',)
    assert teacher.sees_words('What next?')
    assert teacher.press('6', '1', '2') is None
    assert teacher.sees_words('Delete fetchs?')
    delete = teacher.press('enter')
    assert delete == ChangeOption('fetchs')
    teacher.lesson(Phase.NO_OPTION, option_name='')
    teacher.answer(delete)
    assert teacher.app.known_options == ()
    assert not teacher.sees_words('Change an option')


def test_the_question_mark_in_a_menu_explains_the_game(teacher: Person) -> None:
    teacher.press('escape', '?')
    assert teacher.sees_words('□ ■ the taxi: empty, and with the passenger')
    assert teacher.sees_words('p let the passenger in')
    teacher.press('x')
    assert teacher.sees_words('What next?')


def test_a_long_list_is_shown_a_page_at_a_time(taxi: Domain[Any]) -> None:
    person, picked = Person(taxi), []

    def picking(number: int) -> Item:
        return Item(f'item {number}', '', lambda app: picked.append(number))

    back: list[App] = []
    person.app.screen = ListScreen('Many', [picking(n) for n in range(1, 21)], back.append)
    assert person.sees_words('9 item 9')
    assert not person.sees_words('item 10')
    person.press(*['down'] * 10, '2')
    assert person.sees_words('2 item 11')
    assert person.sees_words('11 of 20')
    person.press('up', 'up', 'enter', '9')
    assert picked == [11, 9, 9]
    person.press(*['down'] * 10, '9')  # the last page has two
    assert picked == [11, 9, 9]


def test_the_fullest_key_bar_leaves_room_for_the_rest(watcher: Person) -> None:
    watcher.world.step_period = 0.5
    screen = watcher.sees()
    for words in (
        'Space wait',
        '. single step',
        '- slower',
        '+ faster',
        'u undo a step',
        'q quit',
    ):
        assert words in screen
    assert 'higher window' not in screen
    assert CHOSEN[0] not in screen
