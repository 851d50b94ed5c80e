"""The dialogue: conversations as transcripts, any keys in any order, and what may go wrong."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain
from humanopts_learner.demonstrations import GOAL
from humanopts_learner.options.judge import MIN_TRAJECTORIES
from humanopts_learner.summary import Criterion, NO_RANGE, OptionSummary
from humanopts_teach.dialogue.app import App, REPLY_SECONDS, SETTLE_SECONDS
from humanopts_teach.dialogue.entry import Item, ListScreen
from humanopts_teach.dialogue.menu import opening
from humanopts_teach.dialogue.view import view
from humanopts_teach.lesson.requests import (
    AnswerQuestion,
    BeginDemonstration,
    CancelRun,
    DefineOption,
    Drive,
    EndDemonstration,
    OpenSession,
    Phase,
    PlayEpisodes,
    RunOption,
    SetControl,
    SetPace,
    UNKNOWN,
    Verdict,
)
from humanopts_teach.terminal.drawing import frame
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import initialize, invariant, precondition, rule, RuleBasedStateMachine
import pytest
from teach_support import snapshot
from teach_support.desk import Desk, ME

NAME = 'go to passenger and pickup'
CHOSEN = {'taxi_row', 'taxi_col', 'passenger_row', 'passenger_col'}
AT_R = 'taxi 0,1 passenger R destination G'


class Transcript(Desk):
    """A desk that writes down keys, requests and screens."""

    lines: list[str]

    def press(self, *keys: str) -> 'Transcript':
        before = len(self.asked)
        super().press(*keys)
        self.lines.append(f'\n> {" ".join(keys)}')
        self.lines += [f'  asks {each!r}' for each in self.asked[before:]]
        return self._write()

    def note(self, what: str) -> 'Transcript':
        """Write down something else that has happened, and the screen."""
        self.lines.append(f'\n... {what}')
        return self._write()

    def _write(self) -> 'Transcript':
        """Write down the screen, and its keys where they are others than before."""
        *words, keys = self.see().split('\n')
        self.lines += [*words[1:], *([keys] if keys not in self.lines else [])]
        return self


Begin = Callable[..., Transcript]


@pytest.fixture
def begin(tmp_path: Path) -> Iterator[Begin]:
    """Sit down at a desk; nothing before ``lines`` are emptied counts."""
    desks: list[Transcript] = []

    def begin(domain: str = 'taxi', *, chosen: set[str] | None = None, **more: Any) -> Transcript:
        desk = Transcript(make_domain(domain), tmp_path / str(len(desks)), **more)
        desks.append(desk)
        desk.lines = []
        if chosen is not None:
            desk.teach(NAME, chosen, AT_R)
        desk.lines.clear()
        return desk

    yield begin
    for desk in desks:
        desk.store.close()


def keep(desk: Transcript, name: str) -> None:
    snapshot.check(f'dialogue_{name}.txt', '\n'.join(desk.lines))


def test_a_person_is_led_from_the_code_to_a_demonstration(begin: Begin) -> None:
    desk = begin().note('somebody has come')
    desk.press('backspace', '1', '!', 'enter').press('backspace', 'enter').press('?').press('x')
    desk.press('1').press(*'fetch', 'enter').press('?').press('x').press('y').press('backspace')
    desk.press('y').press('n', 'n').press('o').press('enter').press('?').press('x')
    desk.press('q').press('escape')
    keep(desk, 'first')


def test_a_demonstration_is_driven_mended_and_kept(begin: Begin) -> None:
    desk = begin(chosen=CHOSEN).note('the first start')
    desk.press('left').press('d').press('enter').press('x').press('u').press('s')
    desk.press('p').press('enter').press('n').press('left').press('n').press('backspace')
    desk.press('escape').press('2').press('1')
    keep(desk, 'demonstration')


def test_what_was_shown_is_listed_watched_contradicted_and_deleted(begin: Begin) -> None:
    desk = begin(chosen={*CHOSEN, 'passenger_in_taxi'})
    desk.press('left', 'p', 'enter')
    desk.app.next_start = AT_R
    desk.lines.clear()
    desk.press('backspace', 'escape', '2', '1', 'enter').press('down', 'left', 'up', 'p', 'enter')
    desk.press('3').press('l').press('right').press('1').press('escape').press('2').press('2')
    desk.press('left', 'p', 'enter').press('w')
    desk.machine('north', 'east').note('the machine takes two steps')
    desk.press('-').press(' ').press('.').press(' ').press('left')
    desk.run_ends('You took over.').note('the run ends').press('enter').press('2')
    keep(desk, 'corrections')


def test_an_option_is_run_renamed_learned_by_goal_and_deleted(begin: Begin) -> None:
    desk = begin(chosen=CHOSEN)
    desk.press('left', 'p', 'enter', 'escape')
    desk.lines.clear()
    desk.press('3').press('1').press('enter').press('?').press('x').press('escape')
    desk.press('escape').press('6').press('1').press('1').press(*'x', 'enter').press('6')
    desk.press('1').press('3').press('escape').press('6').press('1').press('2').press('enter')
    keep(desk, 'menu')


def test_the_machine_plans_plays_and_says_what_is_not_covered(begin: Begin) -> None:
    desk = begin(chosen=CHOSEN)
    desk.press('left', 'p', 'enter', 'escape')
    desk.lines.clear()
    desk.press('4').press('1').press('?').press('x').press('x').press('c').press('enter')
    desk.run_ends('Planned.').note('it is planned')
    desk.world.running, desk.world.execution = 'action:north', 'interrupted'
    desk.note('it plays').press('x')
    desk.machine('north')
    desk.world.acted = {('machine', 0): NAME}
    desk.note('an option wins')
    desk.world.uncovered = [(AT_R, 0.0), ('taxi 3,1 passenger B destination R', 0.25)]
    desk.run_ends('Played.').note('it has played').press('c').press('2').press('1')
    assert desk.app.next_start == 'taxi 3,1 passenger B destination R'
    keep(desk, 'plan')


@pytest.mark.parametrize(('item', 'named'), [('1', True), ('2', False), ('3', True)])
def test_a_plan_names_its_options_whose_criteria_are_not_met(
    begin: Begin, item: str, named: bool
) -> None:
    desk = begin(chosen=CHOSEN).press('left', 'p', 'enter', 'escape', '4', item, 'enter')
    desk.run_ends('Planned.')
    assert isinstance(desk.asked[-1], PlayEpisodes)
    assert (f'The criteria of {NAME} are not met yet.' in desk.see()) is named


FEW = OptionSummary(NAME, 'p1', tuple(CHOSEN), n_demonstrations=MIN_TRAJECTORIES, more_needed=6)
VALUES = (Criterion.of('return', 0.25, 1.0), Criterion.of('initiation', 0.125, 0.05))
CLASH = 'taxi row 4: cannot start here (2x), can start here (1x)'
PROGRESS: dict[str, dict[str, Any]] = {
    'nothing': {},
    'measured': {'criteria': (*VALUES, Criterion.of('termination', None, 0.05))},
    'undecided': {'criteria': (Criterion('return', 0.25, 1.0, met=False),)},
    'too few': {'criteria': (Criterion.of('return', None, 1.0),), 'n_demonstrations': 4},
    'no estimate': {'criteria': (Criterion.of('return', 2.0, 1.0),), 'more_needed': -1},
    'no range': {'criteria': (Criterion('return', None, None, met=False, obstacle=NO_RANGE),)},
    'met': {'criteria': (Criterion.of('return', 0.5, 1.0),), 'mean_return_policy': -2.0},
    'by goal': {'criteria': (Criterion.of('return', None, 1.0),), 'method': GOAL},
    'conflict': {'criteria': VALUES, 'conflicts': ('taxi row 4: the end (2x)', 'more')},
    'start and end': {'criteria': VALUES, 'conflicts': ('another', CLASH)},
    'missing': {'criteria': VALUES, 'conflicts': (CLASH,), 'suggested_feature': 'blocked_moves'},
}


def test_what_is_learned_is_told_with_what_to_do(begin: Begin) -> None:
    desk = begin(chosen=CHOSEN)
    for title, values in PROGRESS.items():
        desk.world.summaries = [replace(FEW, **values)]
        desk.note(title)
    desk.world.lesson = replace(desk.world.lesson, method=GOAL)
    desk.world.summaries = [replace(FEW, **PROGRESS['by goal'], n_demonstrations=2)]
    desk.note('by goal, as chosen')
    keep(desk, 'progress')


def test_the_questions_can_be_answered_again(begin: Begin) -> None:
    desk = begin(chosen=CHOSEN).press('left', 'p', 'enter', 'e')
    answers = [('enter', True), ('n', False), ('y', True), ('o', True)]
    for key, yes in answers:
        number = desk.lesson.view.question_id
        desk.press(key)
        assert AnswerQuestion(number, yes) in desk.asked
    assert set(desk.lesson.view.chosen_features) == CHOSEN - {'taxi_col'}
    assert desk.lesson.phase is Phase.DEMONSTRATING  # the next start begins by itself


def test_groups_of_features_are_asked_about_once(begin: Begin) -> None:
    desk = begin('pacman')
    desk.press('enter', '1', *'fetch', 'enter')
    desk.lines.clear()
    desk.note('the first group').press('y').press('n').press('backspace', 'backspace')
    desk.press('n').press('n', 'n').press('backspace').press('?').press('x')
    assert "Does the 'fetch' option depend on anything about" in desk.see()
    keep(desk, 'groups')
    pressed = 0
    while desk.lesson.view.question_id <= 31 and pressed < 50:
        desk.press('n')
        pressed += 1
    assert desk.lesson.view.chosen_features == ()  # all are asked about again
    desk.press('y', 'y', 'y', 'y', 'o', 'escape', '2', '1', 'e', 'enter')
    assert desk.lesson.view.question_feature == 'ghost_distance' or desk.lesson.view.question


def test_where_chance_plays_a_part_a_step_cannot_be_undone(begin: Begin) -> None:
    desk = begin('rooms')
    desk.press('enter', '1', *'fetch', 'enter', 'y', 'o', 'enter', 'left')
    assert 'undo' not in desk.see()
    assert 'undo' not in desk.press('?').see()


def test_a_fall_is_told_and_not_called_done(begin: Begin) -> None:
    desk = begin('gymnasium:FrozenLake-v1').press('enter', '4')
    while not desk.game.transition.terminated:
        desk.press('down')
    assert ' fell into a hole (reward 0)\nThe task is over.' in desk.see()
    asked = len(desk.asked)
    desk.press('down')
    assert (len(desk.asked), 'The episode is over' in desk.see()) == (asked, True)


FULL = 'recording stopped: the disk is full. Free some space.'


def test_a_paused_lesson_says_why_on_every_screen_and_waits(begin: Begin) -> None:
    desk = begin(chosen=CHOSEN).press('left')
    desk.lesson.pause(FULL)
    desk.publish()
    for key in ('u', '?', 'x', 'escape', 'x'):
        desk.press(key)
        assert FULL in desk.see()
        for size in ((80, 24), (70, 20)):
            assert f'PAUSED: {FULL}' in desk.sees(*size)
    assert desk.lesson.phase is Phase.DEMONSTRATING  # the undo lost nothing
    desk.press('enter')
    assert desk.lesson.phase is Phase.READY
    desk.press('enter')
    assert 'Not now: the lesson is paused' in desk.see()
    desk.lesson.pause('')
    desk.publish()
    desk.press('enter')
    assert desk.lesson.phase is Phase.DEMONSTRATING


def test_a_code_that_was_given_is_not_asked_for(begin: Begin) -> None:
    desk = begin()
    desk.app.screen = opening('no code', ask=False)
    lesson, desk.world.lesson = desk.world.lesson, UNKNOWN
    desk.go_on()
    assert desk.asked == []  # the lesson is not there yet
    desk.world.lesson = lesson
    desk.go_on().go_on()
    assert desk.asked == [OpenSession('no code')]  # refused: the person decides
    assert '> no code' in desk.see()
    desk.type('anna')
    assert desk.lesson.view.participant == 'anna'


def test_a_key_counts_only_for_the_screen_and_the_question_that_were_seen(begin: Begin) -> None:
    desk = begin()
    first = desk.app.drawn()
    desk.app.type(['backspace'], first)
    desk.go_on()
    second = desk.app.drawn()
    desk.app.type(['7', 'enter'], first)  # the same screen, one frame late
    desk.go_on()
    assert desk.lesson.view.participant == 'p7'
    for number, frame_number in (('1', second), ('2', 10**6)):  # the menu came meanwhile
        desk.app.type([number], frame_number)
        desk.go_on()
        said = f'{number} was pressed before this was shown; ignored.'
        assert said in desk.see()
        assert 'What next?' in desk.see()
    desk.press('1').type('fetch').press('y', 'o')
    desk.app.next_start = AT_R
    desk.press('enter', 'left', 'p')
    desk.learns = False
    desk.press('enter')
    desk.app.drawn()
    desk.app.type(['left', 'n'])
    desk.learns = True
    desk.publish()
    asked = len(desk.asked)
    desk.go_on()
    assert desk.lesson.phase is Phase.DEMONSTRATING
    assert 'was pressed before this was shown' in desk.see()
    assert [type(each) for each in desk.asked[asked:]] == [BeginDemonstration]


def test_keys_of_one_demonstration_can_be_typed_ahead(begin: Begin) -> None:
    desk = begin(chosen=CHOSEN)
    desk.app.drawn()
    desk.app.type(['left', 'p', 'enter'])
    desk.go_on()
    asked = [type(each) for each in desk.asked[-4:]]
    assert asked == [Drive, Drive, EndDemonstration, BeginDemonstration]


def test_a_silent_node_is_named_and_nothing_hangs(begin: Begin) -> None:
    desk = begin()
    desk.silent = {'lesson'}
    desk.press('enter')
    late = desk.asked[-1]
    desk.go_on(REPLY_SECONDS)
    assert 'lesson does not answer.' in desk.see()
    desk.silent = set()
    desk.app.replied(late, desk.lesson.carry_out(late), desk.now)  # too late
    assert 'Who teaches?' in desk.see()
    desk.press('enter')
    assert 'What next?' in desk.see()
    desk.world.missing = ('lesson', 'game')
    assert 'Missing: lesson, game. Everything taught is saved; Ctrl-C quits.' in desk.see()


def test_topics_that_lag_behind_an_answer_hold_nothing_up(begin: Begin) -> None:
    desk = begin()
    desk.publish = lambda: None  # type: ignore[method-assign]
    desk.press('enter')
    assert 'Who teaches?' in desk.see()
    desk.go_on(SETTLE_SECONDS)
    assert 'What next?' in desk.see()


def left_by(desk: Desk, who: str) -> None:
    """Have a demonstration of somebody under way."""
    desk.lesson.carry_out(EndDemonstration(Verdict.DISCARD, 0, 0))
    desk.lesson.carry_out(OpenSession(who))
    desk.lesson.carry_out(DefineOption('hers'))
    for _ in desk.app.domain.features:
        number = desk.lesson.view.question_id
        desk.lesson.carry_out(AnswerQuestion(number, yes=True))
    desk._carry_out(BeginDemonstration(AT_R))
    desk.publish()


def test_a_demonstration_that_was_left_is_taken_up_or_discarded_if_the_person_says_so(
    begin: Begin,
) -> None:
    desk = begin()
    left_by(desk, 'p1')  # by a connection that was cut off
    desk.press('enter')
    assert 'Teaching: hers' in desk.see()
    assert desk.asked == []
    desk = begin()
    left_by(desk, 'anna')
    assert 'anna may still be there. Discard it?' in desk.press('enter').see()
    assert 'Who teaches?' in desk.press('x').see()
    desk.game.set_control(True, 'hers')  # she drives again
    desk.publish()
    desk.press('enter')
    assert desk.asked == [OpenSession('p1')]
    assert 'anna has a demonstration under way' in desk.see()
    desk.game.set_control(False, 'hers')
    desk.publish()
    desk.press('enter', 'enter')
    assert isinstance(desk.asked[-2], EndDemonstration)
    assert desk.asked[-2].verdict is Verdict.DISCARD
    assert 'What next?' in desk.see()


@pytest.mark.parametrize('key', ['left', 'enter', 'e'])
def test_who_is_displaced_asks_nothing_of_the_others_lesson_and_gives_control_back(
    begin: Begin, key: str
) -> None:
    desk = begin(chosen=CHOSEN).press('left', 'backspace')
    desk.world.paused_by = ME
    left_by(desk, 'anna')
    asked, last = len(desk.asked), desk.app.last_requests()
    assert not any(isinstance(each, EndDemonstration) for each in last)
    desk.press(key)
    assert 'The lesson is no longer yours. Take it back?' in desk.see()
    assert 'anna is teaching now.' in desk.see()
    assert desk.asked[asked:] == [SetPace(0.0, paused=False), SetControl(hold=False)]
    desk.press('enter', 'y', 'left')
    assert len(desk.asked) == asked + 2
    desk.game.set_control(True, 'hers')
    desk.publish()
    assert 'Take it back?' in desk.press('t').see()  # she drives
    desk.lesson.carry_out(EndDemonstration(Verdict.DISCARD, 0, 0))
    desk.publish()
    assert 'What next?' in desk.press('t').see()


def test_a_lesson_that_was_restarted_without_a_session_is_come_back_to(begin: Begin) -> None:
    desk = begin(chosen=CHOSEN).press('backspace')
    desk.world.lesson = UNKNOWN
    desk.publish = lambda: None  # type: ignore[method-assign]
    desk.press('escape', '1', *'fetch', 'enter')
    assert 'The lesson was restarted.' in desk.see()
    assert desk.press('t').asked[-1] == OpenSession('p1')


def test_a_long_list_is_shown_a_page_at_a_time(taxi: Domain[Any]) -> None:
    app, picked = App(opening('p1')), list[int]()
    app.world.domain = taxi

    def picking(number: int) -> Item:
        return Item(f'item {number}', '', lambda app: picked.append(number))

    app.screen = ListScreen('Many', [picking(n) for n in range(1, 21)])

    def press(*keys: str) -> str:
        app.drawn()
        app.type(keys)
        app.advance(0.0)
        return '\n'.join(frame(app, 80, 24))

    assert '9 item 9' in (seen := press())
    assert 'item 10' not in seen
    assert '2 item 11' in (seen := press(*['down'] * 10, '2'))
    assert '11 of 20' in seen
    press('up', 'up', 'enter', '9')
    press(*['down'] * 10, '9')  # the last page has two
    assert picked == [11, 9, 9]


@pytest.mark.parametrize(
    ('period', 'key', 'then'), [(0.0, '+', 0.0), (2.0, '-', 2.0), (0.3, '+', 0.1)]
)
def test_the_speed_stays_within_what_there_is(
    begin: Begin, period: float, key: str, then: float
) -> None:
    desk = begin(chosen=CHOSEN).press('left', 'p', 'enter', 'w')
    desk.world.step_period = period
    assert desk.press(key).asked[-1] == SetPace(then, paused=False)
    seen = desk.sees()
    for words in (
        'Space pause',
        '. single step',
        '- slower',
        '+ faster',
        'u undo a step',
        'q quit',
    ):
        assert words in seen  # the fullest bar leaves room for the rest
    assert 'higher window' not in seen


def test_discarding_a_watched_option_stops_the_machine(begin: Begin) -> None:
    desk = begin(chosen=CHOSEN).press('left', 'p', 'enter', 'w', 'backspace')
    stop, discard, _ = desk.asked[-3:]  # the same start begins again
    assert stop == SetControl(hold=True)
    assert isinstance(discard, EndDemonstration)
    assert discard.verdict is Verdict.DISCARD


KEYS = [
    'up',
    'down',
    'left',
    'right',
    'enter',
    'escape',
    'backspace',
    ' ',
    *'123456ynoelwsuqcx?t-.',
]


class DialogueMachine(RuleBasedStateMachine):
    """Any keys and news in any order: nothing hangs, nothing is lost, nothing is left behind."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = TemporaryDirectory()
        self.kept: set[str] = set()

    @initialize(taught=st.booleans())
    def sit_down(self, taught: bool) -> None:
        self.desk = Desk(make_domain('taxi'), Path(self.folder.name), budget=6)
        if taught:
            self.desk.teach(NAME, CHOSEN, AT_R)

    def teardown(self) -> None:
        self.desk.store.close()
        self.folder.cleanup()

    @precondition(lambda self: not self.desk.app.ended)
    @rule(key=st.sampled_from(KEYS))
    def press(self, key: str) -> None:
        self.desk.press(key)

    @precondition(lambda self: not self.desk.app.ended)
    @rule(number=st.integers(0, 20))
    def press_a_key_that_is_shown(self, number: int) -> None:
        """A key beside which something is written has a meaning."""
        desk = self.desk
        shown = [key for key, label, _ in view(desk.app).keys if label and key != 'ctrl-c']
        desk.app.say('')
        if not shown:
            return
        before, asked, key = desk.see(), len(desk.asked), shown[number % len(shown)]
        desk.press(key)
        moves = key in ('left', 'right', 'up', 'down')
        assert moves or desk.app.ended or (desk.see(), len(desk.asked)) != (before, asked)

    @rule(text=st.sampled_from(['fetch', 'go', NAME]))
    def type(self, text: str) -> None:
        if not self.desk.app.ended and '> ' in self.desk.see():
            self.desk.type(text)

    @precondition(lambda self: isinstance(self.desk.app.run, RunOption))
    @rule(action=st.sampled_from(['north', 'east']), ends=st.booleans())
    def machine(self, action: str, ends: bool) -> None:
        self.desk.machine(action)
        if ends and self.desk.app.run is not None:
            self.desk.run_ends('It ended.')

    @rule(learns=st.booleans(), paused=st.booleans(), restarted=st.booleans())
    def news(self, learns: bool, paused: bool, restarted: bool) -> None:
        desk = self.desk
        desk.learns = learns
        desk.lesson.pause(FULL if paused else '')
        if restarted:
            desk.lesson.game_restarted()
        desk.publish()
        desk.go_on()

    @rule()
    def silence(self) -> None:
        self.desk.silent = {'lesson'}
        if not self.desk.app.ended:
            self.desk.press('enter')
        self.desk.silent = set()
        self.desk.go_on(REPLY_SECONDS)

    @invariant()
    def the_screen_fits_and_nothing_is_under_way(self) -> None:
        if hasattr(self, 'desk'):
            app = self.desk.app
            assert len(frame(app, 80, 24)) == 24
            assert app.waits_for is None
            assert view(app).keys

    @invariant()
    def no_demonstration_is_lost(self) -> None:
        if hasattr(self, 'desk'):
            shown = {demo.uuid for demo in self.desk.lesson.demonstrations()}
            assert self.kept <= shown
            self.kept = shown

    @invariant()
    def nothing_is_left_behind_when_the_terminal_ends(self) -> None:
        if hasattr(self, 'desk'):
            lesson, requests = self.desk.lesson.view, self.desk.app.last_requests()
            mine = lesson.participant == self.desk.app.participant
            discards = any(isinstance(each, EndDemonstration) for each in requests)
            assert discards == (mine and lesson.phase is Phase.DEMONSTRATING)
            assert (SetControl(hold=False) in requests) == (self.desk.world.holder == ME)
            assert (CancelRun() in requests) == (self.desk.app.run is not None)


DialogueMachine.TestCase.settings = settings(
    max_examples=40, stateful_step_count=40, deadline=None
)
TestDialogue = DialogueMachine.TestCase
