"""Questions about features: keys that answer one, a group of them, or all others; going back."""

from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Transition
from humanopts_teach.lesson.requests import (
    AnswerQuestion,
    DefineOption,
    EndDemonstration,
    Phase,
    Verdict,
)
from teach_support.person import CHOSEN, NAME, Person


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


def answered(person: Person) -> dict[str, bool]:
    """Go through all questions, pressing n; return the answers by feature."""
    said = {}
    for number, feature in enumerate(person.app.domain.features, start=1):
        request = person.asked_about(number) if number > 1 else person.look()
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
    assert answered(pacman_teacher)['legal_moves'] is False
    pacman_teacher.asked_about(1)
    assert pacman_teacher.sees_words('depend on anything about Pac-Man?')


def test_a_refused_answer_about_a_group_is_not_sent_again(pacman_teacher: Person) -> None:
    request = pacman_teacher.press('n')
    assert pacman_teacher.answer(request, ok=False, text='the disk is full') is None
    assert pacman_teacher.sees_words('the disk is full')
    assert pacman_teacher.sees_words('depend on anything about Pac-Man?')


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
