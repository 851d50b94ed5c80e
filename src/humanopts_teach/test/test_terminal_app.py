"""The terminal's state machine: what is asked of the graph for which keys, and what is seen."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Transition
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import GOAL
from humanopts_learner.options.criteria import Criterion, FEWEST
from humanopts_teach.dialogue.app import REPLY_SECONDS, SETTLE_SECONDS
from humanopts_teach.dialogue.menu import opening
from humanopts_teach.lesson.requests import (
    AnswerQuestion,
    BeginDemonstration,
    CancelRun,
    DefineOption,
    Drive,
    EndDemonstration,
    LessonView,
    ListOptions,
    NewEpisode,
    OpenSession,
    OptionStatus,
    Phase,
    PlanOptions,
    PlayEpisodes,
    Request,
    RunOption,
    SetControl,
    SetExecution,
    Verdict,
)
from humanopts_teach.terminal.drawing import frame
import pytest
from teach_support.person import BOTTOM, CHOSEN, NAME, Person, START


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
    lesson, person.world.lesson = person.world.lesson, None
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


def test_questions_are_answered_by_y_and_n_only(teacher: Person) -> None:
    question = f"Does the '{NAME}' option depend on which row the taxi is in?"
    teacher.lesson(
        Phase.ASKING,
        question_id=3,
        question=question,
        question_feature='taxi_row',
        questions_total=10,
    )
    assert teacher.sees_words(question)
    assert teacher.sees_words('question 1 of 10')
    assert teacher.press('x', 'enter', 'up') is None
    first = teacher.press('y')
    assert first == AnswerQuestion(3, yes=True)
    teacher.lesson(Phase.ASKING, question_id=4)
    teacher.answer(first)
    assert teacher.press('N') == AnswerQuestion(4, yes=False)


def test_all_other_questions_are_answered_no_by_one_key(teacher: Person) -> None:
    teacher.lesson(Phase.ASKING, question_id=3, chosen_features=())
    assert teacher.press('o') is None  # an option must depend on something
    assert not teacher.sees_words('no to all others')
    teacher.lesson(Phase.ASKING, question_id=4, chosen_features=CHOSEN)
    assert teacher.sees_words('o no to all others')
    request = teacher.press('o')
    for number in (4, 5):
        assert request == AnswerQuestion(number, yes=False)
        teacher.lesson(Phase.ASKING, question_id=number + 1)
        request = teacher.answer(request)
    teacher.lesson(Phase.READY, question_id=0)
    assert teacher.answer(request) is None


def test_no_to_all_others_stops_at_a_refusal(teacher: Person) -> None:
    teacher.lesson(Phase.ASKING, question_id=4)
    request = teacher.press('o')
    assert teacher.answer(request, ok=False, text='it cannot be written') is None


def test_a_key_does_not_answer_a_question_that_was_not_shown(teacher: Person) -> None:
    teacher.lesson(Phase.ASKING, question_id=3)
    first = teacher.press('y', 'n')
    assert first == AnswerQuestion(3, yes=True)
    assert teacher.answer(first) is None  # the lesson still shows question 3
    assert teacher.lesson(Phase.ASKING, question_id=4) is None
    assert teacher.sees_words('n came before this was shown, and is not taken.')
    assert teacher.press('n') == AnswerQuestion(4, yes=False)


@pytest.mark.parametrize('key', ['n', 'enter', 'u', 'backspace'])
def test_a_key_pressed_while_the_learner_works_does_not_answer_the_next_start(
    shower: Person, key: str
) -> None:
    drives(shower, 'left', 'west', 'taxi 2,2 passenger R destination B')
    ended = shower.press('enter')
    shower.lesson(Phase.LEARNING, n_demonstrations=1, last_uuid='abc')
    begin = shower.answer(ended)
    assert begin is None
    assert shower.sees_words('learning ...')
    begin = shower.lesson(Phase.READY)
    assert begin == BeginDemonstration()
    shower.press(key)  # the screen does not show the next start yet
    shower.game(episode=3, step=0, state=START)
    shower.lesson(Phase.DEMONSTRATING, episode=3)
    assert shower.answer(begin, episode=3) is None
    assert shower.sees_words('came before this was shown, and is not taken.')
    assert not shower.sees_words('Take back')


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


def test_keys_of_one_demonstration_can_be_typed_ahead(shower: Person) -> None:
    assert shower.press('left', 'p', 'enter') == Drive('west', 2, 0)
    assert shower.game(step=1) == Drive('pickup', 2, 1)
    assert shower.game(step=2) == EndDemonstration(Verdict.DONE, 2, 2)


def test_the_board_and_the_words_show_only_the_chosen_features(shower: Person) -> None:
    assert shower.sees_words('taxi row 2, taxi col 3, passenger row 0, passenger col 0')
    assert '⚑' not in shower.sees()
    assert '☻' in shower.sees()


def test_all_keys_are_on_the_screen_while_demonstrating(shower: Person) -> None:
    for key in (
        *('↓ south', '↑ north', '→ east', '← west', 'p pickup', 'd dropoff', 'Enter done'),
        *('n not here', 'Backspace discard', 'can restart at its end: no', 'q quit', '? help'),
    ):
        assert key in shower.sees()


def test_an_arrow_key_is_sent_for_the_state_that_was_seen(shower: Person) -> None:
    assert shower.press('left', 'left') == Drive('west', 2, 0)
    assert shower.look() is None  # the second key waits for the first
    assert shower.game(step=1) == Drive('west', 2, 1)


def test_done_waits_for_the_steps_typed_before_it(shower: Person) -> None:
    shower.press('p', 'enter')
    assert shower.game(step=1) == EndDemonstration(Verdict.DONE, 2, 1)


def test_the_next_start_begins_by_itself_after_a_verdict(shower: Person) -> None:
    request = shower.press('n')
    assert request == EndDemonstration(Verdict.NOT_HERE, 2, 0)
    shower.lesson(Phase.LEARNING, n_not_here=1)
    assert shower.answer(request) is None
    assert shower.lesson(Phase.READY) == BeginDemonstration()


def drives(shower: Person, key: str, action: str, state: str, reward: float = -1.0) -> None:
    """Press a key, and have the game take the step."""
    assert shower.world.game is not None
    shower.press(key)
    step = shower.world.game.step + 1
    shower.game(step=step, state=state, previous_action=action, reward=reward)


def test_each_step_says_what_it_did(shower: Person) -> None:
    assert 'reward' not in shower.sees()
    drives(shower, 'left', 'west', 'taxi 2,2 passenger R destination B')
    assert shower.sees_words('went west (reward -1)')
    drives(shower, 'p', 'pickup', 'taxi 2,2 passenger R destination B')
    assert shower.sees_words('nobody here to pick up (reward -1)')


def test_a_step_whose_beginning_was_not_seen_is_named_by_its_action(shower: Person) -> None:
    shower.game(step=7, previous_action='west', reward=-1.0)
    assert shower.sees_words('last: west (reward -1)')


def test_done_after_a_step_without_effect_asks_once_more(shower: Person) -> None:
    drives(shower, 'p', 'pickup', START)
    assert shower.press('enter') is None
    assert shower.sees_words('The last step had no effect (nobody here to pick up).')
    assert shower.press('x') is None
    assert shower.press('enter', 'enter') == EndDemonstration(Verdict.DONE, 2, 1)


def test_a_fall_is_told_and_not_called_done(teacher: Person) -> None:
    lake = make_domain('gymnasium:FrozenLake-v1')
    teacher.world.domain = lake
    teacher.game(episode=1, step=0, state='row 1, col 0')
    teacher.press('escape', '5')
    teacher.game(step=1, state='row 1, col 1', previous_action='down', terminated=True, reward=0.0)
    assert teacher.sees_words('slid right and fell into a hole (reward 0) The task is over.')
    assert 'done' not in teacher.sees()


def test_a_refused_verdict_leaves_the_demonstration_as_it_is(shower: Person) -> None:
    shower.answer(shower.press('enter'), ok=False, text='nothing was demonstrated')
    assert shower.sees_words('nothing was demonstrated')
    assert shower.press('left') == Drive('west', 2, 0)


def test_starts_are_not_asked_for_again_and_again_when_they_are_refused(teacher: Person) -> None:
    assert teacher.answer(teacher.press(' '), ok=False, text='the budget is spent') is None
    assert teacher.sees_words('the budget is spent')


def test_can_start_again_stays_as_it_was_said_last(shower: Person) -> None:
    assert shower.press('s') is None
    assert 'can restart at its end: YES' in shower.sees()
    request = shower.press('enter')
    assert request == EndDemonstration(Verdict.DONE, 2, 0, can_start_at_end=True)
    shower.lesson(Phase.LEARNING)
    begin = shower.answer(request) or shower.lesson(Phase.READY)
    shower.game(episode=3)
    shower.lesson(Phase.DEMONSTRATING, episode=3)
    shower.answer(begin, episode=3)
    assert shower.press('enter') == EndDemonstration(Verdict.DONE, 3, 0, can_start_at_end=True)
    shower.lesson(Phase.DEMONSTRATING, option_name='another', episode=4)
    assert 'can restart at its end: no' in shower.sees()


def test_leaving_asks_first_once_steps_were_taken(shower: Person) -> None:
    shower.press('left')
    shower.game(step=1)
    assert shower.press('escape') is None
    assert shower.sees_words('The demonstration under way is discarded; all else is saved.')
    assert shower.press('x') is None
    assert shower.press('escape', 'enter') == EndDemonstration(Verdict.DISCARD, 2, 1)


def test_questions_can_be_answered_again(shower: Person) -> None:
    discard = shower.press('e')
    assert discard == EndDemonstration(Verdict.DISCARD, 2, 0)
    shower.lesson(Phase.READY)
    again = shower.answer(discard)
    assert again == DefineOption(NAME, ask_again=True)
    shower.lesson(
        Phase.ASKING,
        question_id=11,
        question_feature='taxi_row',
        chosen_features=(),
        earlier_features=CHOSEN,
    )
    shower.answer(again)
    assert 'Enter as before: yes' in shower.sees()
    answered = shower.press('enter')
    assert answered == AnswerQuestion(11, True)
    shower.lesson(Phase.ASKING, question_id=12, question_feature='destination_row')
    shower.answer(answered)
    assert 'Enter as before: no' in shower.sees()
    answered = shower.press('enter')
    assert answered == AnswerQuestion(12, False)
    shower.lesson(Phase.ASKING, question_id=13, question_feature='taxi_col')
    assert shower.answer(answered) is None
    answered = shower.press('o')
    assert answered == AnswerQuestion(13, True)
    shower.lesson(Phase.ASKING, question_id=14, question_feature='destination_col')
    answered = shower.answer(answered)
    assert answered == AnswerQuestion(14, False)
    shower.lesson(Phase.READY, chosen_features=CHOSEN, earlier_features=())
    assert shower.answer(answered) is None


def test_help_on_a_question_explains_the_keys_of_questions(teacher: Person) -> None:
    teacher.lesson(Phase.ASKING, question_id=1, question_feature='taxi_row', chosen_features=())
    teacher.press('?')
    assert 'pickup' not in teacher.sees()
    assert teacher.sees_words('y yes')


def test_questions_that_are_asked_for_the_first_time_have_no_earlier_answer(
    teacher: Person,
) -> None:
    teacher.lesson(Phase.ASKING, question_id=1, question_feature='taxi_row', chosen_features=())
    assert 'as before' not in teacher.sees()
    assert teacher.press('enter') is None


def criteria(values: Iterable[tuple[str, float | None, float]]) -> OptionStatus:
    """Make the progress of the option."""
    return OptionStatus(
        NAME,
        'p1',
        CHOSEN,
        FEWEST,
        criteria=tuple(Criterion.of(*value) for value in values),
        more_needed=6,
    )


def test_each_criterion_shows_value_target_and_whether_it_can_be_measured(
    shower: Person,
) -> None:
    shower.world.progress = [
        criteria(
            [
                ('return', 0.25, 1.0),
                ('initiation', 0.125, 0.05),
                ('termination', None, 0.05),
            ]
        )
    ]
    screen = shower.sees()
    for line in (
        'By trees, on starts it has not seen:',
        '✓ return       0.25 worse    ≤ 1.00',
        '· initiation   12.5 % wrong  ≤ 5.0 %',
        '· termination  not measured  ≤ 5.0 %',
        'Perhaps 1 to 18 more are needed.',
    ):
        assert line in screen


def test_a_criterion_whose_limit_is_too_large_is_not_yet_known(shower: Person) -> None:
    progress = criteria([('return', 0.25, 1.0)])
    few = (Criterion('return', 0.25, 1.0, met=False),)
    shower.world.progress = [replace(progress, criteria=few)]
    assert '? return  0.25 worse  ≤ 1.00' in shower.sees()
    assert shower.sees_words(
        'Perhaps 1 to 18 more are needed: return is not yet known well enough.'
    )


def test_an_estimate_that_cannot_be_made_is_not_made(shower: Person) -> None:
    progress = criteria([('return', 0.0, 1.0)])
    shower.world.progress = [replace(progress, more_needed=-1)]
    assert 'How many more it takes cannot be told yet.' in shower.sees()


def test_a_person_is_told_why_a_lesson_goes_on_whose_criteria_hold(shower: Person) -> None:
    progress = criteria([('return', 0.0, 1.0)])
    shower.world.progress = [replace(progress, criteria_met=True)]
    assert shower.sees_words('All criteria hold, but from some starts it still fails.')
    shower.lesson(Phase.FINISHED)
    assert shower.sees_words('All criteria hold. ')


def test_a_person_is_told_when_the_criteria_will_be_measured(shower: Person) -> None:
    progress = criteria([('return', None, 1.0)])
    few = replace(progress, n_demonstrations=FEWEST - 1, more_needed=-1)
    shower.world.progress = [few]
    assert f'Measured from {FEWEST} demonstrations on.' in shower.sees()


def test_a_planned_policy_is_named_and_measured_sooner(shower: Person) -> None:
    shower.lesson(Phase.DEMONSTRATING, method=GOAL)
    progress = replace(criteria([('return', None, 1.0)]), n_demonstrations=2, more_needed=-1)
    shower.world.progress = [progress]
    assert shower.sees_words('These are for the earlier answers: show one more.')
    shower.world.progress = [replace(progress, method=GOAL)]
    assert not shower.sees_words('These are for the earlier answers')
    assert shower.sees_words('policy planned: best ways to an end like the shown ones')
    assert shower.sees_words('By goal, on starts it has not seen:')
    assert shower.sees_words('Measured from 3 demonstrations on.')
    shower.world.progress = [
        replace(progress, method=GOAL, n_demonstrations=5, more_needed=4),
    ]
    assert shower.sees_words('How many more it takes cannot be told yet.')


def test_how_an_option_is_learned_can_be_changed_in_the_menu(teacher: Person) -> None:
    teacher.press('escape', '6', '1')
    assert teacher.sees_words('Learn it by goal')
    assert teacher.press('3') == DefineOption(NAME, method=GOAL)
    teacher.lesson(Phase.READY, method=GOAL)
    assert teacher.answer(teacher.asked[-1]) is None
    assert teacher.sees_words(f'Teaching: {NAME}')


def test_conflicts_come_with_the_feature_that_would_tell_them_apart(shower: Person) -> None:
    progress = criteria([('return', 0.0, 1.0)])
    clash = 'taxi row 0: pickup, but also east'
    shower.world.progress = [
        replace(progress, conflicts=(clash, 'more'), suggested_feature='passenger_in_taxi')
    ]
    assert shower.sees_words(clash)
    assert shower.sees_words('Add "passenger in taxi" (e): it tells most apart.')


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


def started(runner: Person) -> RunOption:
    """Start a run."""
    run = runner.answer(runner.press('enter'))
    assert isinstance(run, RunOption)
    assert runner.answer(run) is None
    return run


def test_an_action_key_takes_over_from_a_run(runner: Person) -> None:
    run = started(runner)
    assert runner.press('left') == Drive('west', 1, 0)
    runner.game(step=1)
    runner.app.run_ended(run, True, 'You took over.')
    assert runner.sees_words('You took over.')


def test_a_key_between_two_episodes_takes_control_all_the_same(runner: Person) -> None:
    started(runner)
    runner.game(terminated=True)
    assert runner.press('left') == SetControl(hold=True)


def test_escape_stops_a_run_and_only_then_leaves(runner: Person) -> None:
    run = started(runner)
    runner.answer(runner.press('escape'))
    assert runner.asked[-1] == CancelRun()
    runner.app.run_ended(run, True, 'Stopped.')
    runner.answer(runner.press('escape'))
    assert runner.sees_words('What next?')


def test_a_run_whose_server_is_gone_ends_in_words(runner: Person) -> None:
    started(runner)
    runner.app.lost_server()
    assert runner.app.run is None
    assert runner.sees_words('option_server is gone.')


def test_watching_plans_first_and_plays_then(teacher: Person) -> None:
    plan = teacher.answer(teacher.press('escape', '4', '1', 'enter'))
    assert isinstance(plan, PlanOptions)
    teacher.answer(plan)
    teacher.app.run_ended(plan, True, 'Planned.')
    play = teacher.look()
    assert isinstance(play, PlayEpisodes)
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
    teacher.world.progress = [
        OptionStatus(name, who, criteria_met=met)
        for who, name, met in (('p1', 'a', True), ('p1', 'fetch', False), ('p2', 'b', False))
    ]
    plan = teacher.answer(teacher.press('escape', '4', item, 'enter'))
    teacher.answer(plan)
    teacher.app.run_ended(plan, True, 'Planned.')
    assert teacher.sees_words('Planned. The criteria of fetch do not hold yet.') is named
    assert isinstance(teacher.look(), PlayEpisodes)


def test_how_the_machine_plays_can_be_chosen_before_and_changed_while(teacher: Person) -> None:
    teacher.press('escape', '4', '1', 'x')
    assert teacher.sees_words('Arbitration: options stop where another is worth more.')
    plan = teacher.answer(teacher.press('enter'))
    teacher.answer(plan)
    teacher.app.run_ended(plan, True, 'Planned.')
    play = teacher.look()
    assert isinstance(play, PlayEpisodes)
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
    teacher.press('?')
    assert teacher.sees_words('x other arbitration')


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
    assert shower.app.parting() == [
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


FULL = 'recording stopped: the disk is full. Free some space.'


@pytest.mark.parametrize('key', ['', '?', 'escape'])
def test_a_paused_lesson_says_why_on_every_screen(shower: Person, key: str) -> None:
    shower.lesson(Phase.DEMONSTRATING, paused=FULL)
    shower.press(*filter(None, [key]))
    assert shower.sees_words(f'PAUSED: {FULL}')
    assert f'PAUSED: {FULL}' in shower.sees(70, 20)
    shower.lesson(Phase.DEMONSTRATING, paused='')
    assert 'PAUSED' not in shower.sees()


def test_a_long_reason_leaves_the_board_whole_in_a_low_window(shower: Person) -> None:
    shower.lesson(Phase.DEMONSTRATING, paused=30 * 'the disk is full ')
    assert BOTTOM in shower.sees(70, 20)


def test_while_the_lesson_is_paused_the_next_start_waits_for_a_key(shower: Person) -> None:
    ended = shower.press('enter')
    assert isinstance(ended, EndDemonstration)
    shower.lesson(Phase.READY, paused=FULL)
    assert shower.answer(ended) is None
    assert shower.sees_words('The lesson is paused.')
    assert shower.lesson(Phase.READY, paused='') is None
    assert shower.press('enter') == BeginDemonstration()


def test_the_fullest_screen_fits_in_80_by_24(shower: Person) -> None:
    values = [(name, 0.125, 0.05) for name in ('return', 'initiation', 'termination')]
    shower.lesson(Phase.DEMONSTRATING, last_uuid='abc')
    situation = ', '.join(f'{name.replace("_", " ")} 4' for name in CHOSEN)
    shower.world.progress = [
        replace(
            criteria(values),
            mean_return_demonstrations=-5.25,
            mean_return_policy=-6.5,
            conflicts=(f'{situation}: not the end (10x), the end (2x)', 'another'),
            suggested_feature='passenger_in_taxi',
        )
    ]
    screen = shower.sees()
    assert 'higher window' not in screen
    assert shower.sees_words('on starts it has seen, mean return: yours -5.25, the option -6.50')
    assert shower.sees_words('not the end (10x), the end (2x) Add "passenger in taxi" (e)')


@pytest.fixture
def pacman_teacher(teacher: Person) -> Person:
    """Somebody who has just named an option in Pac-Man, and is asked the first question."""
    pacman = make_domain('pacman')
    teacher.world.domain, teacher.side = pacman, 41
    state = pacman.encode(pacman.reset(generator(0)))
    teacher.world.game = Transition(episode=1, state=state)
    asks(teacher, 1, chosen_features=(), questions_total=len(pacman.features))
    return teacher


def asks(person: Person, number: int, **fields: Any) -> Request | None:
    """Have the lesson ask about a feature of the domain, by its number from 1."""
    feature = person.app.domain.features[number - 1].name
    return person.lesson(Phase.ASKING, question_id=number, question_feature=feature, **fields)


def answered(person: Person) -> dict[str, bool]:
    """Go through all questions, pressing n; return the answers by feature."""
    said = {}
    for number, feature in enumerate(person.app.domain.features, start=1):
        request = asks(person, number) if number > 1 else person.look()
        for _ in range(2):  # about a group, and about the feature
            request = request or person.press('n')
        assert isinstance(request, AnswerQuestion)
        said[feature.name] = request.yes
        person.answer(request)
    return said


def test_a_group_of_features_is_asked_about_once(pacman_teacher: Person) -> None:
    assert pacman_teacher.sees_words(
        f"Does the '{NAME}' option depend on anything about Pac-Man? "
        'At yes, 3 features of Pac-Man are asked about.'
    )
    assert 'n no, to all of them' in pacman_teacher.sees()
    pressed = 0
    for number in range(1, len(pacman_teacher.app.domain.features) + 1):
        request = asks(pacman_teacher, number)
        while request is None:
            request, pressed = pacman_teacher.press('n'), pressed + 1
        assert request == AnswerQuestion(number, yes=False)
        pacman_teacher.answer(request)
    assert pressed == 6  # five groups, and what the last step ate


def test_yes_to_a_group_asks_about_each_of_its_features(pacman_teacher: Person) -> None:
    assert pacman_teacher.press('y') is None
    pacman_teacher.lesson(Phase.ASKING, question='which row Pac-Man is in?')
    assert pacman_teacher.sees_words('which row Pac-Man is in? question 1 of')
    assert pacman_teacher.press('y') == AnswerQuestion(1, yes=True)


def test_a_key_for_a_group_does_not_answer_its_first_feature(pacman_teacher: Person) -> None:
    assert pacman_teacher.press('y', 'y') is None
    assert pacman_teacher.sees_words('y came before this was shown, and is not taken.')


def test_a_group_can_be_answered_as_before(pacman_teacher: Person) -> None:
    asks(pacman_teacher, 1, earlier_features=('pacman_col',))
    assert 'Enter as before: yes' in pacman_teacher.sees()
    assert pacman_teacher.press('enter') == AnswerQuestion(1, yes=False)
    asks(pacman_teacher, 2)
    assert pacman_teacher.answer(pacman_teacher.asked[-1]) == AnswerQuestion(2, yes=True)


def test_questions_that_begin_again_ask_about_groups_again(pacman_teacher: Person) -> None:
    assert answered(pacman_teacher)['legal_moves'] is False
    asks(pacman_teacher, 1)
    assert pacman_teacher.sees_words('depend on anything about Pac-Man?')


def test_a_refused_answer_about_a_group_is_not_sent_again(pacman_teacher: Person) -> None:
    request = pacman_teacher.press('n')
    assert pacman_teacher.answer(request, ok=False, text='the disk is full') is None
    assert pacman_teacher.sees_words('the disk is full')
    assert pacman_teacher.sees_words('depend on anything about Pac-Man?')


@pytest.fixture
def pacman_shower(pacman_teacher: Person) -> Person:
    """Somebody who teaches Pac-Man by the direction of food alone, and has eaten some."""
    pacman, game = pacman_teacher.app.domain, pacman_teacher.world.game
    assert game is not None
    pacman_teacher.lesson(Phase.DEMONSTRATING, episode=2, chosen_features=('food_direction',))
    state = pacman.decode(game.state)
    after = pacman.step(state, 1, generator(0)).state
    pacman_teacher.game(episode=2, step=0)
    pacman_teacher.game(step=1, state=pacman.encode(after), previous_action='west', reward=10.0)
    return pacman_teacher


def test_what_is_hidden_in_pac_man_is_named_and_meals_are_told(pacman_shower: Person) -> None:
    assert pacman_shower.sees_words('hidden: Pac-Man, the ghosts, the power pills, the fruit')
    assert pacman_shower.sees_words('ate food (reward 10)')


def test_the_fullest_screen_of_pac_man_fits_in_80_by_24(pacman_shower: Person) -> None:
    pacman_shower.lesson(Phase.DEMONSTRATING, last_uuid='abc')
    values = [('return', 12.5, 10.0), ('initiation', 0.125, 0.05), ('termination', None, 0.05)]
    conflict = 'food direction north: cannot start here (12x), can start here (1x)'
    status = replace(
        criteria(values),
        features=('food_direction',),
        mean_return_demonstrations=12.25,
        mean_return_policy=-116.5,
        conflicts=(conflict, 'another'),
    )
    pacman_shower.world.progress = [status]
    screen = pacman_shower.sees()
    for text in (
        '· termination  not measured  ≤ 5.0 %',
        '· return       12.50 worse   ≤ 10.00',
        'yours 12.25, the option -116.50',
        conflict,
        'press s before done.',
    ):
        assert text in ' '.join(screen.split()) or text in screen
    assert 'higher window' not in screen
    assert '…' not in screen


def test_menus_are_not_cut_beside_a_wide_board(pacman_teacher: Person) -> None:
    pacman_teacher.press('escape')
    assert pacman_teacher.sees_words('1 Teach a new option name it, answer questions, show it')
    assert pacman_teacher.sees_words('Watch the machine play it plans, then plays')


def test_a_start_that_contradicts_an_end_is_explained_by_a_key(shower: Person) -> None:
    words = (
        'If the last one was a slip, delete it (l). '
        'Where an end can be a start, press s before done.'
    )
    shower.world.progress = [replace(criteria([]), conflicts=('taxi row 4: the end (2x)',))]
    assert not shower.sees_words(words)
    conflict = 'taxi row 4: cannot start here (2x), can start here (1x)'
    shower.world.progress = [replace(criteria([]), conflicts=('another', conflict))]
    assert shower.sees_words(words)
    missing = replace(shower.world.progress[0], suggested_feature='passenger_in_taxi')
    shower.world.progress = [missing]
    assert not shower.sees_words(words)


def test_a_small_window_is_told_so_politely(shower: Person) -> None:
    assert '69 x 24 characters, and 70 x 20 are needed' in shower.sees(69, 24)
    assert '80 x 19 characters, and 70 x 20 are needed' in shower.sees(80, 19)
    assert 'Teaching' in shower.sees(70, 20)


@pytest.mark.parametrize(('width', 'height'), [(80, 24), (120, 40), (70, 20)])
def test_no_line_is_wider_than_the_window(shower: Person, width: int, height: int) -> None:
    for key in ('', '?', 'x', 'e'):
        shower.press(*filter(None, [key]))
        assert max(map(len, frame(shower.app, width, height))) <= width


def test_help_explains_every_key(shower: Person) -> None:
    shower.press('?')
    screen = shower.sees()
    assert 'higher window' not in screen
    assert 'let the passenger in' in screen
    assert 'the option makes no sense from this start' in screen
    shower.press('left')
    assert shower.sees_words('Teaching')
    assert not any(isinstance(request, Drive) for request in shower.asked)


@pytest.mark.parametrize('colours', [None, 'truecolor'])
def test_no_escape_sequence_of_a_message_reaches_the_terminal(colours: Any) -> None:
    person = Person(make_domain('taxi'))
    lesson = LessonView(Phase.NO_SESSION, budget=100, text='a\x1b[2Jb\x07', paused='c\x9b5md')
    person.world.lesson = lesson
    person.world.holder = 'x\x1b]0;title\x07'
    plain = frame(person.app, 80, 30)
    assert all(line.isprintable() and len(line) <= 80 for line in plain)
    coloured = '\n'.join(frame(person.app, 80, 30, colours))
    assert '\x1b[2J' not in coloured
    assert '\x9b' not in coloured
