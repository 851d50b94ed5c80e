"""The dialogue: its menu, late keys, silent nodes, pauses; the machine plays, runs and plans."""

from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_learner.demonstrations import GOAL
from humanopts_learner.planning.request import Arbitration
from humanopts_learner.summary import Criterion, OptionSummary
from humanopts_teach.dialogue.app import REPLY_SECONDS, SETTLE_SECONDS
from humanopts_teach.dialogue.menu import opening
from humanopts_teach.lesson.requests import (
    BeginDemonstration,
    CancelRun,
    DefineOption,
    Drive,
    EndDemonstration,
    ListOptions,
    NewEpisode,
    OpenSession,
    Phase,
    PlanOptions,
    PlayEpisodes,
    RunOption,
    SetControl,
    SetExecution,
    SetPace,
    UNKNOWN,
    Verdict,
)
import pytest
from teach_support.person import AT_G, CHOSEN, NAME, Person, START


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


def test_a_demonstration_that_somebody_else_left_is_discarded_once_the_person_says_so(
    person: Person,
) -> None:
    left = {'participant': 'anna', 'option_name': NAME, 'episode': 7}
    person.lesson(Phase.DEMONSTRATING, **left)
    assert person.press('enter') is None
    assert person.sees_words('Perhaps anna is still there. Discard it?')
    assert person.press('x') is None
    assert person.sees_words('Who teaches? > p1')
    person.press('enter')
    person.world.holder = 'hers'
    refused = person.press('enter')
    assert refused == OpenSession('p1')  # she drives again
    person.answer(refused, ok=False)
    person.world.holder = ''
    person.press('enter')
    person.lesson(Phase.READY)  # she has ended it meanwhile
    ended = person.press('enter')
    assert ended == OpenSession('p1')
    person.answer(ended, ok=False)
    person.lesson(Phase.DEMONSTRATING, **left)
    person.press('enter')
    discarded = person.press('enter')
    assert discarded == EndDemonstration(Verdict.DISCARD, 7, 0)
    person.lesson(Phase.READY)
    opened = person.answer(discarded)
    assert opened == OpenSession('p1')
    assert person.sees_words('Who teaches?')
    person.lesson(Phase.NO_OPTION, participant='p1')
    person.answer(opened)
    assert person.sees_words('What next?')


@pytest.mark.parametrize('key', ['left', 'enter', 'd'])
def test_nothing_is_asked_of_a_demonstration_of_somebody_who_has_taken_the_lesson_over(
    person: Person, key: str
) -> None:
    person.names_option(Phase.READY)
    person.look()
    person.lesson(Phase.DEMONSTRATING, participant='anna', episode=3)
    asked = len(person.asked)
    assert person.press(key) is None
    assert person.sees_words('anna teaches now.')
    assert person.sees_words('The lesson is no longer yours. Take it back?')
    assert person.press('enter', 'y', 'left') is None
    person.world.holder = 'hers'
    opened = person.press('t')
    assert opened == OpenSession('p1')
    person.answer(opened, ok=False, text='anna has a demonstration under way')
    assert person.sees_words('Take it back?')
    again = person.press('t')
    person.lesson(Phase.NO_OPTION, participant='p1')
    person.answer(again)
    assert person.sees_words('What next?')
    assert person.asked[asked:] == [opened, again]


def test_who_is_displaced_gives_control_back_and_lets_the_machine_go_on(person: Person) -> None:
    person.names_option(Phase.READY)
    person.world.holder = person.world.paused_by = person.world.me
    person.world.step_period = 0.5
    person.lesson(Phase.ASKING, participant='anna', question_id=1)
    goes_on = person.press('y')
    assert goes_on == SetPace(0.5, paused=False)
    person.world.paused_by = ''
    given_back = person.answer(goes_on)
    assert given_back == SetControl(hold=False)
    person.world.holder = ''
    assert person.answer(given_back) is None
    person.press('escape')
    assert person.sees_words('What next?')


def test_a_lesson_that_was_started_again_without_a_session_is_come_back_to(
    person: Person,
) -> None:
    person.names_option(Phase.READY)
    person.lesson(Phase.NO_SESSION, participant='', option_name='')
    person.press('escape')
    assert person.press('1', *NAME, 'enter') is None
    assert person.sees_words('The lesson was started again.')
    assert person.press('t') == OpenSession('p1')


def test_a_state_that_comes_late_displaces_nobody(person: Person) -> None:
    person.lesson(Phase.READY, participant='anna')
    request = person.press('enter')
    person.answer(request)
    person.now = SETTLE_SECONDS
    person.look()
    assert person.sees_words('What next?')
    assert isinstance(person.press('1', *NAME, 'enter'), DefineOption)


def test_a_demonstration_of_somebody_who_drives_is_not_discarded(person: Person) -> None:
    person.lesson(Phase.DEMONSTRATING, participant='anna', option_name=NAME)
    person.world.holder = 'hers'
    assert person.press('enter') == OpenSession('p1')  # which the lesson refuses


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


@pytest.fixture
def runner(teacher: Person) -> Person:
    """Somebody in front of the screen that runs an option."""
    teacher.press('escape')
    request = teacher.press('3')
    assert request == ListOptions('p1')
    teacher.answer(request, option_names=(NAME,))
    teacher.press('enter')
    return teacher


def test_running_gives_control_back_first(runner: Person) -> None:
    runner.world.holder = 'me'
    give_back = runner.press('enter')
    assert give_back == SetControl(hold=False)
    runner.world.holder = ''
    assert runner.answer(give_back) == RunOption(NAME, 'p1')


def test_running_begins_an_episode_when_none_is_under_way(runner: Person) -> None:
    runner.game(terminated=True)
    new = runner.press('enter')
    assert isinstance(new, NewEpisode)
    runner.game(episode=2, terminated=False)
    assert runner.answer(new, episode=2) == SetControl(hold=False)


def started(runner: Person) -> None:
    """Start a run."""
    run = runner.answer(runner.press('enter'))
    assert run == RunOption(NAME, 'p1')
    assert runner.answer(run) is None


def test_an_action_key_takes_over_from_a_run(runner: Person) -> None:
    started(runner)
    assert runner.press('left') == Drive('west', 1, 0)
    runner.game(step=1)
    runner.run_ends('You took over.')
    assert runner.sees_words('You took over.')


def test_a_key_between_two_episodes_takes_control_all_the_same(runner: Person) -> None:
    started(runner)
    runner.game(terminated=True)
    assert runner.press('left') == SetControl(hold=True)


def test_a_step_that_is_refused_while_the_machine_goes_on_takes_control(runner: Person) -> None:
    started(runner)
    step = runner.press('left')
    assert step == Drive('west', 1, 0)
    assert runner.answer(step, ok=False, text='it is step 1') == SetControl(hold=True)


def test_escape_stops_a_run_and_only_then_leaves(runner: Person) -> None:
    started(runner)
    assert 'stop it' in runner.sees()
    runner.answer(runner.press('escape'))
    assert runner.asked[-1] == CancelRun()
    runner.run_ends('Stopped.')
    runner.answer(runner.press('escape'))
    assert runner.sees_words('What next?')


def test_a_run_whose_server_is_gone_ends_in_words(runner: Person) -> None:
    started(runner)
    runner.app.lost_server()
    assert runner.app.run is None
    assert runner.sees_words('option_server is gone.')


def test_stopping_a_run_that_waits_lets_it_go_on_to_its_end(runner: Person) -> None:
    started(runner)
    runner.world.paused_by = 'me'
    goes_on = runner.press('escape')
    assert goes_on == SetPace(0.0, paused=False)
    runner.world.paused_by = ''
    assert runner.answer(goes_on) == CancelRun()


def planned(teacher: Person, *keys: str) -> PlayEpisodes:
    """Press keys, of which the last asks for a plan; return the request to play that follows."""
    plan = teacher.answer(teacher.press(*keys))
    assert isinstance(plan, PlanOptions)
    teacher.answer(plan)
    teacher.run_ends('Planned.')
    play = teacher.look()
    assert isinstance(play, PlayEpisodes)
    return play


def played(teacher: Person, *places: tuple[str, float]) -> None:
    """Plan with the options, which leave places uncovered, and play to the end."""
    teacher.world.uncovered = places
    teacher.answer(planned(teacher, 'escape', '4', '1', 'enter'))
    teacher.run_ends('played.')


def test_watching_plans_first_and_plays_then(teacher: Person) -> None:
    play = planned(teacher, 'escape', '4', '1', 'enter')
    assert (play.action_set, play.participant) == ('human', 'p1')
    teacher.answer(play)
    teacher.world.running = 'fetch'
    assert teacher.sees_words('It runs: fetch')
    teacher.world.running = 'action:north'
    assert teacher.sees_words('It runs: one step north')


@pytest.mark.parametrize(('item', 'named'), [('1', True), ('2', False), ('3', True)])
def test_a_plan_names_its_options_whose_criteria_do_not_hold(
    teacher: Person, item: str, named: bool
) -> None:
    teacher.world.summaries = [
        OptionSummary(name, who, criteria=(Criterion('return', 0.0, 1.0, met),))
        for who, name, met in (('p1', 'a', True), ('p1', 'fetch', False), ('p2', 'b', False))
    ]
    planned(teacher, 'escape', '4', item, 'enter')
    assert teacher.sees_words('Planned. The criteria of fetch are not met yet.') is named


def test_how_the_machine_plays_can_be_chosen_before_and_changed_while(teacher: Person) -> None:
    teacher.press('escape', '4', '1', 'x')
    assert teacher.sees_words('Arbitration: options stop where another is worth more.')
    play = planned(teacher, 'enter')
    assert play.execution == 'interrupted'
    teacher.answer(play)
    teacher.world.execution = 'interrupted'
    change = teacher.press('X')
    assert change == SetExecution('modular_mass')
    teacher.world.execution = 'modular_mass'
    assert teacher.answer(change) is None
    assert teacher.sees_words('Arbitration: all options act at once: the greatest mass.')
    teacher.app.run_ended(play, True, 'RecordedEpisodes.')
    assert teacher.sees_words('the greatest mass.')


def test_the_key_that_changes_how_the_machine_plays_is_on_the_help_line(teacher: Person) -> None:
    teacher.press('escape', '4', '1')
    assert 'x other arbitration' in teacher.sees()


def test_help_explains_what_the_machine_plays_by_and_what_a_fallback_is(teacher: Person) -> None:
    teacher.press('escape', '4', '1', '?')
    assert teacher.sees_words('x another way to choose between options: each option to its end;')
    assert teacher.sees_words('so that a single step was taken (a fallback)')


def test_places_that_no_option_covers_are_starts_to_teach_from(teacher: Person) -> None:
    played(teacher, (AT_G, 0.0), (START, 1.5))
    assert teacher.sees_words('played. 2 places are not covered: c lists them.')
    teacher.press('c')
    assert teacher.sees_words('1 No option can start here')
    assert teacher.sees_words('2 A single step is worth 1.5 more')
    first = teacher.sees().split('\n')[1:5]
    teacher.press('down')
    assert teacher.sees().split('\n')[1:5] != first  # the board shows the place
    teacher.press('up', 'enter')
    define = teacher.press('1')
    assert define == DefineOption(NAME)
    teacher.lesson(Phase.READY)
    teacher.answer(define)
    begun = teacher.press('enter')
    assert begun == BeginDemonstration(AT_G)
    teacher.begins(begun, 3)
    discard = teacher.press('backspace')
    teacher.lesson(Phase.READY)
    assert teacher.answer(discard) == BeginDemonstration()  # the place is taken once


def test_a_new_option_can_be_taught_from_a_place_too(teacher: Person) -> None:
    played(teacher, (AT_G, 0.0))
    teacher.press('c', 'enter', '2')
    define = teacher.press(*'deliver', 'enter')
    assert define == DefineOption('deliver')
    teacher.lesson(Phase.ASKING, option_name='deliver', question_id=1)
    teacher.answer(define)
    teacher.lesson(Phase.READY, question_id=0)
    assert teacher.press('enter') == BeginDemonstration(AT_G)


def test_where_it_is_not_known_what_is_covered_it_is_told(teacher: Person) -> None:
    played(teacher)
    teacher.press('c')
    assert teacher.sees_words('The options cover all that the plan comes to.')
    teacher.world.uncovered = None
    teacher.press('c')
    assert teacher.sees_words('is known of plans with your options alone')


def test_modules_say_which_option_won_the_step_that_is_shown(teacher: Person) -> None:
    teacher.press('escape', '4', '1')
    screen: Any = teacher.app.screen
    screen.execution = Arbitration.MODULAR_MASS
    release = teacher.press('enter')
    plan = teacher.answer(release)
    teacher.answer(plan)
    teacher.world.acted = {('server', 8): 'deliver', ('server', 7): NAME}
    teacher.game(step=1, previous_action='north', action_publisher_id='server', action_sequence=7)
    assert teacher.sees_words(f'{NAME} won this step.')
    teacher.game(step=2, previous_action='north', action_publisher_id='server', action_sequence=9)
    assert not teacher.sees_words('won this step')
