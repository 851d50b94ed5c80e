"""The dialogue of a lesson: questions, demonstrations by keys, what is told of the criteria."""

from dataclasses import replace

from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Transition
from humanopts_learner.demonstrations import GOAL
from humanopts_learner.options.criteria import FEWEST
from humanopts_learner.summary import Criterion
from humanopts_teach.lesson.requests import (
    Answer,
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    Drive,
    EndDemonstration,
    Phase,
    RequestStatus,
    Verdict,
)
import pytest
from teach_support.person import CHOSEN, criteria, NAME, Person, START


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


def test_backspace_goes_back_to_the_question_before(teacher: Person) -> None:
    teacher.lesson(Phase.ASKING, question_id=4, question_feature='passenger_row')
    assert teacher.press('backspace') == AnswerQuestion(4, back=True)


def test_there_is_no_question_before_the_first_one(teacher: Person) -> None:
    teacher.lesson(Phase.ASKING, question_id=1, question_feature='taxi_row')
    assert 'back a question' not in teacher.sees()
    assert teacher.press('backspace') is None


def test_a_group_of_features_is_asked_about_once(pacman_teacher: Person) -> None:
    assert pacman_teacher.sees_words(
        f"Does the '{NAME}' option depend on anything about Pac-Man? "
        'If yes, 3 features of Pac-Man are asked about.'
    )
    assert 'n no, to all of them' in pacman_teacher.sees()
    pressed = 0
    for number in range(1, len(pacman_teacher.app.domain.features) + 1):
        request = pacman_teacher.asked_about(number)
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
    pacman_teacher.asked_about(1, earlier_features=('pacman_col',))
    assert 'Enter as before: yes' in pacman_teacher.sees()
    assert pacman_teacher.press('enter') == AnswerQuestion(1, yes=False)
    pacman_teacher.asked_about(2)
    assert pacman_teacher.answer(pacman_teacher.asked[-1]) == AnswerQuestion(2, yes=True)


def test_questions_that_begin_again_ask_about_groups_again(pacman_teacher: Person) -> None:
    pacman_teacher.press('y')
    no = pacman_teacher.press('n')
    assert isinstance(no, AnswerQuestion)
    pacman_teacher.lesson(Phase.ASKING, question_id=31)
    every_answer_was_no = Answer(RequestStatus.NO_FEATURE, '')
    pacman_teacher.app.replied(no, every_answer_was_no, pacman_teacher.now)
    assert pacman_teacher.sees_words('depend on anything about Pac-Man?')


def test_a_refused_answer_about_a_group_is_not_sent_again(pacman_teacher: Person) -> None:
    request = pacman_teacher.press('n')
    assert pacman_teacher.answer(request, ok=False, text='the disk is full') is None
    assert pacman_teacher.sees_words('the disk is full')
    assert pacman_teacher.sees_words('depend on anything about Pac-Man?')


def test_going_back_inside_a_group_goes_to_the_feature_before_and_then_to_the_group(
    pacman_teacher: Person,
) -> None:
    pacman_teacher.press('y')
    yes = pacman_teacher.press('y')
    pacman_teacher.asked_about(2)
    pacman_teacher.answer(yes)
    back = pacman_teacher.press('backspace')
    assert back == AnswerQuestion(2, back=True)
    pacman_teacher.asked_about(1)
    assert pacman_teacher.answer(back) is None
    assert 'question 1 of' in pacman_teacher.sees()
    assert pacman_teacher.press('backspace') is None
    assert pacman_teacher.sees_words('depend on anything about Pac-Man?')
    assert 'back a question' not in pacman_teacher.sees()


def test_going_back_into_a_group_goes_to_its_question() -> None:
    pacman = make_domain('pacman')
    person = Person(pacman)
    names = [feature.name for feature in pacman.features]
    group = pacman.feature_groups[2]  # type: ignore[attr-defined]
    last, first = names.index(group.features[-1]), names.index(group.features[0])
    person.world.game = Transition()
    person.names_option(Phase.ASKING, question_id=9, question_feature=names[last + 1])
    back = person.press('backspace')
    for number in range(last, first - 1, -1):
        assert back == AnswerQuestion(9 + last - number, back=True)
        person.lesson(Phase.ASKING, question_id=10 + last - number, question_feature=names[number])
        back = person.answer(back)
    assert back is None
    assert person.sees_words(f'depend on anything about {group.words}?')


def test_each_criterion_shows_value_target_and_whether_it_can_be_measured(
    shower: Person,
) -> None:
    shower.world.summaries = [
        criteria(('return', 0.25, 1.0), ('initiation', 0.125, 0.05), ('termination', None, 0.05))
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
    few = (Criterion('return', 0.25, 1.0, met=False),)
    shower.world.summaries = [replace(criteria(), criteria=few)]
    assert '? return  0.25 worse  ≤ 1.00' in shower.sees()
    assert shower.sees_words(
        'Perhaps 1 to 18 more are needed: return is not yet known well enough.'
    )


def test_an_estimate_that_cannot_be_made_is_not_made(shower: Person) -> None:
    shower.world.summaries = [criteria(('return', 2.0, 1.0), more_needed=-1)]
    assert 'How many more it takes cannot be told yet.' in shower.sees()


def test_a_person_is_told_when_the_criteria_will_be_measured(shower: Person) -> None:
    few = {'n_demonstrations': FEWEST - 1, 'more_needed': -1}
    shower.world.summaries = [criteria(('return', None, 1.0), **few)]
    assert f'Measured from {FEWEST} demonstrations on.' in shower.sees()


def test_a_planned_policy_is_named_and_measured_sooner(shower: Person) -> None:
    shower.lesson(Phase.DEMONSTRATING, method=GOAL)
    progress = replace(criteria(('return', None, 1.0)), n_demonstrations=2, more_needed=-1)
    shower.world.summaries = [progress]
    assert shower.sees_words('These are for the earlier answers: show one more.')
    shower.world.summaries = [replace(progress, method=GOAL)]
    assert not shower.sees_words('These are for the earlier answers')
    assert shower.sees_words('policy planned: best ways to an end like the shown ones')
    assert shower.sees_words('By goal, on starts it has not seen:')
    assert shower.sees_words('Measured from 3 demonstrations on.')
    shower.world.summaries = [
        replace(progress, method=GOAL, n_demonstrations=5, more_needed=4),
    ]
    assert shower.sees_words('How many more it takes cannot be told yet.')


def test_conflicts_come_with_the_feature_that_would_tell_them_apart(shower: Person) -> None:
    progress = criteria(('return', 0.0, 1.0))
    clash = 'taxi row 0: pickup, but also east'
    shower.world.summaries = [
        replace(progress, conflicts=(clash, 'more'), suggested_feature='passenger_in_taxi')
    ]
    assert shower.sees_words(clash)
    assert shower.sees_words('Add "passenger in taxi" (e): it tells most apart.')


def test_a_start_that_contradicts_an_end_is_explained_by_a_key(shower: Person) -> None:
    words = (
        'If the last one was a slip, delete it (l). '
        'Where an end can be a start, press s before done.'
    )
    shower.world.summaries = [replace(criteria(), conflicts=('taxi row 4: the end (2x)',))]
    assert not shower.sees_words(words)
    conflict = 'taxi row 4: cannot start here (2x), can start here (1x)'
    shower.world.summaries = [replace(criteria(), conflicts=('another', conflict))]
    assert shower.sees_words(words)
    missing = replace(shower.world.summaries[0], suggested_feature='passenger_in_taxi')
    shower.world.summaries = [missing]
    assert not shower.sees_words(words)


def drives(shower: Person, key: str, action: str, state: str, reward: float = -1.0) -> None:
    """Press a key, and have the game take the step."""
    shower.press(key)
    step = shower.world.game.step + 1
    shower.game(step=step, state=state, previous_action=action, reward=reward)


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
    teacher.side = 13  # a smaller board
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
