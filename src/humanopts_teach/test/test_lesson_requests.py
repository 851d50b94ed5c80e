"""The lesson's requests: every one in every phase, while paused, and its codes and questions."""

from humanopts_teach.lesson.requests import (
    Answer,
    AnswerQuestion,
    BeginDemonstration,
    ChangeOption,
    DefineOption,
    EndDemonstration,
    LessonRequest,
    ListDemonstrations,
    OpenSession,
    Phase,
    RequestStatus,
    Verdict,
    WithdrawDemonstration,
)
import pytest
from teach_support.lesson import (
    CHOSEN,
    fill_disk,
    met,
    OPTION,
    preparing,
    START,
    Table,
    TAXI,
    TO_PHASE,
)

_EVERYWHERE_WRONG = dict.fromkeys(Phase, RequestStatus.WRONG_PHASE)
_EVERYWHERE_OK = dict.fromkeys(Phase, RequestStatus.OK)
# What each request answers in each phase.
TABLE: dict[LessonRequest, dict[Phase, RequestStatus]] = {
    OpenSession('p2'): _EVERYWHERE_OK | {Phase.DEMONSTRATING: RequestStatus.WRONG_PHASE},
    DefineOption('another'): _EVERYWHERE_OK
    | dict.fromkeys((Phase.NO_SESSION, Phase.DEMONSTRATING), RequestStatus.WRONG_PHASE),
    AnswerQuestion(1, yes=True): dict.fromkeys(Phase, RequestStatus.NOT_ASKED)
    | {Phase.ASKING: RequestStatus.OK},
    BeginDemonstration(): _EVERYWHERE_WRONG
    | dict.fromkeys((Phase.READY, Phase.FINISHED), RequestStatus.OK),
    AnswerQuestion(0, back=True): dict.fromkeys(Phase, RequestStatus.NOT_ASKED)
    | dict.fromkeys((Phase.READY, Phase.LEARNING, Phase.FINISHED), RequestStatus.OK),
    ChangeOption(OPTION, 'another'): _EVERYWHERE_OK
    | dict.fromkeys((Phase.DEMONSTRATING, Phase.LEARNING), RequestStatus.WRONG_PHASE)
    | dict.fromkeys((Phase.NO_SESSION, Phase.NO_OPTION), RequestStatus.NO_OPTION),
    WithdrawDemonstration(): _EVERYWHERE_WRONG
    | dict.fromkeys((Phase.ASKING, Phase.READY), RequestStatus.NO_DEMONSTRATION)
    | {Phase.FINISHED: RequestStatus.OK},
    ListDemonstrations(): _EVERYWHERE_OK
    | dict.fromkeys((Phase.NO_SESSION, Phase.NO_OPTION), RequestStatus.NO_OPTION),
    EndDemonstration(Verdict.DONE, 1, 0): _EVERYWHERE_WRONG
    | {Phase.DEMONSTRATING: RequestStatus.NO_STEPS},
}
NEW_THINGS = list(TABLE)[:-2]
FULL = 'recording stopped: the disk is full'


@pytest.mark.parametrize('phase', Phase, ids=lambda phase: phase.name)
@pytest.mark.parametrize('asked', TABLE, ids=repr)
def test_every_request_is_answered_in_every_phase(
    table: Table, phase: Phase, asked: LessonRequest
) -> None:
    TO_PHASE[phase](table)
    assert table.lesson.phase is phase
    answer = table.ask(asked)
    assert answer.status is TABLE[asked][phase]
    assert answer.detail
    if not answer.ok:
        assert table.lesson.phase is phase


@pytest.mark.parametrize('phase', Phase, ids=lambda phase: phase.name)
@pytest.mark.parametrize('asked', NEW_THINGS, ids=repr)
def test_while_it_is_paused_nothing_new_begins_and_then_all_goes_on(
    table: Table, phase: Phase, asked: LessonRequest
) -> None:
    view = TO_PHASE[phase](table).lesson.view
    table.lesson.pause(FULL)
    assert table.ask(asked) == Answer(RequestStatus.PAUSED, f'the lesson is paused: {FULL}')
    paused = table.lesson.view
    assert (paused.phase, paused.paused) == (phase, FULL)
    assert paused.text
    table.lesson.pause('')
    assert table.lesson.view == view
    assert table.ask(asked).status is TABLE[asked][phase]


def test_a_demonstration_under_way_is_kept_while_paused_and_said_to_be_unrecorded(
    table: Table,
) -> None:
    table.ready().began(START).drive('west')
    table.lesson.pause(FULL)
    assert table.drive('west').end(Verdict.NOT_HERE).status is RequestStatus.STEPS_TAKEN
    answer = table.end()
    assert answer.ok
    assert 'not in this recording: the next one has it' in answer.detail
    assert 'not in this recording: the next one has it' in table.lesson.view.text
    table.learned()
    assert (table.lesson.phase, table.lesson.view.n_demonstrations) == (Phase.READY, 1)
    assert 'The lesson is paused.' in table.lesson.view.text
    assert table.lesson.demonstrations() == [answer.demonstration]


def test_a_demonstration_under_way_can_be_discarded_while_paused(table: Table) -> None:
    table.ready().began(START).drive('west')
    table.lesson.pause(FULL)
    assert table.end(Verdict.DISCARD).ok
    table.lesson.pause('')
    assert table.ask(BeginDemonstration()).state == START


def test_an_episode_that_begins_after_the_pause_is_no_demonstration(table: Table) -> None:
    table.ready().ask(BeginDemonstration(START))
    table.lesson.pause(FULL)
    assert table.lesson.began(1, START).status is RequestStatus.PAUSED
    assert table.lesson.phase is Phase.READY
    table.lesson.pause('')
    assert table.ask(BeginDemonstration()).ok


@pytest.mark.parametrize('phase', Phase, ids=lambda phase: phase.name)
def test_every_phase_says_what_comes_next(table: Table, phase: Phase) -> None:
    view = TO_PHASE[phase](table).lesson.view
    assert view.phase is phase
    assert view.text


@pytest.mark.parametrize('asked', NEW_THINGS, ids=repr)
def test_nothing_comes_between_the_request_for_an_episode_and_its_start(
    table: Table, asked: LessonRequest
) -> None:
    answer = preparing(table).ask(asked)
    assert answer.status in (RequestStatus.WRONG_PHASE, RequestStatus.NOT_ASKED)


@pytest.mark.parametrize(
    ('participant', 'session'),
    [
        ('', 's1'),
        ('a b', ''),
        ('../x', ''),
        ('..', ''),
        ('x' * 61, ''),
        ('Zo\u00eb', ''),
        ('p1', 's/1'),
    ],
)
def test_a_session_needs_codes(table: Table, participant: str, session: str) -> None:
    assert table.ask(OpenSession(participant, session)).status is RequestStatus.BAD_NAME
    assert table.lesson.phase is Phase.NO_SESSION
    assert [path.name for path in table.store.directory.iterdir()] == ['.lock']


def test_a_new_session_is_named_after_the_day_and_counted(table: Table) -> None:
    assert table.ask(OpenSession('p1', '')).session == '20260102-1'
    assert table.ask(OpenSession('p1', '')).session == '20260102-2'
    assert table.ask(OpenSession('p2', '')).session == '20260102-1'


@pytest.mark.parametrize(
    'name', ['', '   ', 'x' * 61, 'two\nlines', 'bell\a', 'action:north', '\u200b']
)
def test_an_option_needs_a_name_that_can_be_shown(table: Table, name: str) -> None:
    assert table.opened().ask(DefineOption(name)).status is RequestStatus.BAD_NAME
    assert table.lesson.phase is Phase.NO_OPTION


def test_one_question_is_asked_for_each_feature_in_the_words_of_the_paper(table: Table) -> None:
    view = table.defined().lesson.view
    assert view.question == f"Does the '{OPTION}' option depend on {TAXI.features[0].question}?"
    assert (view.question_id, view.questions_total) == (1, len(TAXI.features))
    table.answer_all()
    assert table.lesson.view.chosen_features == CHOSEN
    assert table.lesson.view.question_id == 0


def test_an_answer_to_another_question_changes_nothing(table: Table) -> None:
    table.defined().ask(AnswerQuestion(1, True))
    again = table.ask(AnswerQuestion(1, True))
    assert again.status is RequestStatus.NOT_ASKED
    assert 'question 2 is' in again.detail
    assert table.lesson.view.question_id == 2


def test_the_questions_are_asked_again_when_all_answers_are_no(table: Table) -> None:
    assert table.defined().answer_all(()).status is RequestStatus.NO_FEATURE
    view = table.lesson.view
    assert view.phase is Phase.ASKING
    assert (view.question_feature, view.question_id) == (TAXI.features[0].name, 11)
    assert 'no' in view.text
    assert table.answer_all().ok


def test_asking_again_forgets_the_answers_and_keeps_the_demonstrations(table: Table) -> None:
    met(table)
    answer = table.ask(DefineOption(OPTION, ask_again=True))
    assert (answer.status, answer.resumed) == (RequestStatus.OK, True)
    assert table.lesson.phase is Phase.ASKING
    assert table.lesson.view.n_demonstrations == 1
    table.answer_all(CHOSEN[:2])
    assert table.lesson.phase is Phase.READY  # the criteria held on other features
    assert not table.lesson.criteria_met


@pytest.mark.parametrize(
    ('phase', 'asked'),
    [
        (Phase.NO_SESSION, OpenSession('p2')),
        (Phase.NO_OPTION, DefineOption('another')),
        (Phase.ASKING, AnswerQuestion(1, yes=True)),
    ],
)
def test_a_full_disk_is_told_and_changes_nothing(
    table: Table, monkeypatch: pytest.MonkeyPatch, phase: Phase, asked: LessonRequest
) -> None:
    before = TO_PHASE[phase](table).lesson.view
    with monkeypatch.context() as patch:
        fill_disk(patch)
        assert table.ask(asked).status is RequestStatus.NOT_SAVED
    assert table.lesson.view == before
    assert table.ask(asked).ok
