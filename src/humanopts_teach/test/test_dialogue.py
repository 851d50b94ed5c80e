"""The dialogue: conversations as transcripts, any keys in any order, and what may go wrong."""

from collections.abc import Callable, Iterator
from dataclasses import replace
import json
from pathlib import Path
import re
from tempfile import TemporaryDirectory
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain
from humanopts_learner.demonstrations import GOAL
from humanopts_learner.options.conflicts import SAY_AGAIN, UNTOLD
from humanopts_learner.options.judge import MIN_HELD_OUT
from humanopts_learner.summary import Criterion, NO_RANGE, OptionSummary, SAMPLED_STARTS
from humanopts_teach.browser.markup import parts
from humanopts_teach.dialogue.app import App, REPLY_SECONDS, SETTLE_SECONDS
from humanopts_teach.dialogue.entry import Item, ListScreen
from humanopts_teach.dialogue.menu import opening
from humanopts_teach.dialogue.view import view
from humanopts_teach.lesson.requests import (
    AddDemonstrations,
    AnswerQuestion,
    BeginDemonstration,
    CancelRun,
    EndDemonstration,
    Phase,
    RunOption,
    SetControl,
    SetPace,
    UNKNOWN,
    WithdrawDemonstration,
)
from humanopts_teach.terminal.drawing import frame
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import initialize, invariant, precondition, rule, RuleBasedStateMachine
import pytest
from teach_support import snapshot
from teach_support.desk import Desk, ME
from teach_support.orchard import Orchard

NAME = 'go to passenger and pickup'
CHOSEN = {'taxi_row', 'taxi_col', 'passenger_row', 'passenger_col'}
AT_R = 'taxi 0,1 passenger R destination G'
FULL = 'recording stopped: the disk is full. Free some space.'


def begin(folder: Path, domain: str, *chosen: str) -> Desk:
    """Sit down; with chosen features, an option is named and its first demonstration begun."""
    desk = Desk(make_domain(domain), folder)
    return desk.teach(NAME, chosen, AT_R) if chosen else desk


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    """Demonstrate in Taxi."""
    desk = begin(tmp_path, 'taxi', *CHOSEN)
    yield desk
    desk.store.close()


def drives(desk: Desk, hold: bool) -> None:
    desk.game.set_control(hold, 'hers')
    desk.publish()


def pause(desk: Desk, why: str) -> None:
    desk.lesson.pause(why)
    desk.publish()


def have(desk: Desk, **values: Any) -> None:
    """Let the graph publish something else."""
    for name, value in values.items():
        setattr(desk.world, name, value)


def fall(desk: Desk) -> None:
    while not desk.game.transition.terminated:
        desk.press('down')


def hush(desk: Desk, *nodes: str) -> None:
    desk.silent = set(nodes)


def give_code(desk: Desk) -> None:
    desk.app.screen = opening('no code', ask=False)
    have(desk, lesson=UNKNOWN)
    desk.advance()


def restart(desk: Desk) -> None:
    """Restart the lesson, which has no session then."""
    have(desk, lesson=UNKNOWN)
    desk.publish = lambda: None  # type: ignore[method-assign]


def meet_criteria(desk: Desk) -> None:
    """Let all criteria be met, so that an exam of two runs is next."""
    met = OptionSummary(NAME, 'p1', criteria=(Criterion.of('return', 0.0, 1.0),))
    desk.exam, desk.reports = 2, {NAME: met}


UNCOVERED = [(AT_R, 0.0), ('taxi 3,1 passenger B destination R', 0.25)]
EVENTS: dict[str, Callable[[Desk], object]] = {
    'the code was given': give_code,
    'the lesson is there': lambda desk: (desk.publish(), desk.advance().advance()),
    'the next start is at R': lambda desk: setattr(desk.app, 'next_start', AT_R),
    'the machine takes two steps': lambda desk: desk.machine('north', 'east'),
    'the run ends': lambda desk: desk.run_ends('You took over.'),
    'the option ends': lambda desk: desk.run_ends(f'{NAME}: its termination condition holds.'),
    'its criteria are met': meet_criteria,
    'planning ends': lambda desk: desk.run_ends('Planned.'),
    'it plays': lambda desk: have(desk, running='action:north', execution='interrupted'),
    'an option wins': lambda desk: (
        desk.machine('north'),
        have(desk, acted={('machine', 0): NAME}),
    ),
    'it has played': lambda desk: (have(desk, uncovered=UNCOVERED), desk.run_ends('Played.')),
    'the disk is full': lambda desk: pause(desk, FULL),
    'there is space again': lambda desk: pause(desk, ''),
    'the lesson falls silent': lambda desk: hush(desk, 'lesson'),
    'it answers too late': lambda desk: (desk.advance(REPLY_SECONDS), hush(desk)),
    'nodes are missing': lambda desk: have(desk, missing=('lesson', 'game')),
    'topics lag behind': lambda desk: setattr(desk, 'publish', lambda: None),
    'a second passes': lambda desk: desk.advance(SETTLE_SECONDS),
    'p1 shows in a terminal that was cut off': lambda desk: desk.shows('p1'),
    'anna shows': lambda desk: desk.shows('anna'),
    'anna drives': lambda desk: drives(desk, True),
    'anna lets go': lambda desk: drives(desk, False),
    'it falls into a hole': fall,
    'the lesson restarts': restart,
}
CONVERSATIONS = {  # by snapshot: domain, chosen features, first keys, and what follows
    'first': (
        *('taxi', (), ''),
        'backspace 1 ! enter | backspace enter | ? | x | 1 | f e t c h enter | ? | x | y '
        '| backspace | y | n n | o | enter | ? | x | q | escape',
    ),
    'demonstration': (
        *('taxi', CHOSEN, ''),
        'left | d | enter | x | u | s | p | enter | n | left | n | backspace | escape | 2 | 1',
    ),
    'corrections': (
        *('taxi', {*CHOSEN, 'passenger_in_taxi'}, 'left p enter'),
        '... the next start is at R | backspace escape 2 1 enter | down left up p enter | 3 | l '
        '| right | 1 | escape | 2 | 2 | left p enter | w | backspace | w '
        '| ... the machine takes two steps | - | + |   | . |   | left | ... the run ends | enter '
        '| 2',
    ),
    'exam': (
        *('taxi', CHOSEN, 'left p'),
        '... its criteria are met | enter | ? | x | r | enter | left | r '
        '| ... the machine takes two steps | r | ... the option ends | ? | x | backspace '
        '| ... the machine takes two steps | ... the option ends | r '
        '| ... the machine takes two steps |   | . | w | backspace | enter '
        '| ... the machine takes two steps | w | l | 1 | escape escape | enter | n | m '
        '| escape 2 | 1 | enter '
        '| ... the machine takes two steps | escape | enter | 2',
    ),
    'menu': (
        *('taxi', CHOSEN, 'left p enter escape'),
        '3 | 1 | enter | ? | x | escape | escape | 6 | 1 | 1 | x enter | 6 | 1 | 3 | escape | 6 '
        '| 1 | 2 | enter',
    ),
    'plan': (
        *('taxi', CHOSEN, 'left p enter escape'),
        '4 | 1 | ? | x | x | c | enter | ... planning ends | ... it plays | x '
        '| ... an option wins | ... it has played | c | 2 | 1 | enter | escape 4 2 enter '
        '| ... planning ends',
    ),
    'groups': (
        *('pacman', (), 'enter 1 f e t c h enter'),
        'y | n | backspace backspace | n | n n | backspace | ? | x | n n n n | y | y y | o',
    ),
    'again': ('taxi', CHOSEN, 'left p enter', 'e | enter | n | y | o'),
    'combine': (
        *('taxi', CHOSEN, 'left p enter e c'),
        't a | right | * 0 . 5 | ctrl-u | h | ctrl-u | down down down right | backspace | '
        'down down down right | enter | right | ctrl-u | enter | enter | down down right | enter '
        '| c | t a x i _ r o w - p a s s e n g e r _ r o w | escape | c | down right | up right '
        '| escape | o | y | left',
    ),
    'chance': ('rooms', (), 'enter 1 f e t c h enter y o enter', 'left | ?'),
    'fall': ('gymnasium:FrozenLake-v1', (), 'enter', '4 | ... it falls into a hole | down'),
    'paused': (
        *('taxi', CHOSEN, 'left'),
        '... the disk is full | u | ? | x | escape | x | enter | enter '
        '| ... there is space again | enter',
    ),
    'given_code': (
        *('taxi', (), ''),
        '... the code was given | ... the lesson is there | a n n a enter',
    ),
    'silence': (
        *('taxi', (), ''),
        '... the lesson falls silent | enter | ... it answers too late | enter '
        '| ... nodes are missing',
    ),
    'lag': ('taxi', (), '', '... topics lag behind | enter | ... a second passes'),
    'cut_off': ('taxi', (), '', '... p1 shows in a terminal that was cut off | enter'),
    'left': (
        *('taxi', (), ''),
        '... anna shows | enter | x | ... anna drives | enter | ... anna lets go | enter | enter',
    ),
    'displaced': (
        *('taxi', CHOSEN, 'left backspace'),
        '... anna shows | left | enter y left | ... anna drives | t | ... anna lets go | t '
        '| enter',
    ),
    'restarted': ('taxi', CHOSEN, 'backspace', '... the lesson restarts | escape 1 g o enter | t'),
}


@pytest.mark.parametrize('name', CONVERSATIONS)
def test_a_conversation_is_as_recorded(name: str, tmp_path: Path) -> None:
    domain, chosen, first, script = CONVERSATIONS[name]
    desk = begin(tmp_path, domain, *chosen).press(*first.split())
    lines, bar = [], ''

    def write(what: str) -> None:
        """Write down the screen, and its keys where they have changed."""
        nonlocal bar
        *words, keys = desk.see().split('\n')
        lines.extend(['', what, *(f'  asks {each!r}' for each in desk.asked), *words[1:]])
        if keys != bar:
            lines.append(keys)
        bar = keys
        desk.asked.clear()

    desk.asked.clear()
    write('... to begin with')
    for step in script.split(' | '):
        if step.startswith('... '):
            EVENTS[step[4:]](desk)
            write(step)
        else:
            desk.press(*(step.split() or ' '))
            write(f'> {step}')
    desk.store.close()
    snapshot.check(f'dialogue_{name}.txt', '\n'.join(lines))


def test_in_a_browser_features_are_combined_by_clicks(tmp_path: Path) -> None:
    desk = begin(tmp_path, 'taxi', *CHOSEN).press('left', 'p', 'enter', 'e', 'c')

    def click(words: str) -> None:
        """Press the keys of the button with these words."""
        page = parts(view(desk.app))
        button = rf"<button[^>]*data-keys='([^']*)'[^>]*><\w+>[^<]*</\w+> *{words}"
        choice = rf"<button[^>]*data-keys='([^']*)'[^>]*><b>{words}</b>"
        keys = re.search(choice, page['panel']) or re.search(button, page['keys'])
        assert keys is not None, words
        desk.press(*json.loads(keys[1]))

    for words in ('distance', 'passenger_col', 'destination_row', 'add it'):
        click(words)
    assert desk.lesson.view.derived_features == ('hypot(passenger_col, destination_row)',)
    desk.store.close()


FEW = OptionSummary(NAME, 'p1', tuple(CHOSEN), n_demonstrations=MIN_HELD_OUT, more_needed=6)
VALUES = (Criterion.of('return', 0.25, 1.0), Criterion.of('initiation', 0.125, 0.05))
CLASH = 'taxi row 4: cannot start here (2x), can start here (1x)'
PROGRESS: dict[str, dict[str, Any]] = {
    'nothing': {},
    'the first': {
        'criteria': (Criterion.of('success', 0.25, 0.95, 0.0, count=12, possible=0.5),),
        'n_demonstrations': 1,
        'evidence': SAMPLED_STARTS,
    },
    'with limits': {
        'criteria': (
            Criterion.of('success', 0.98, 0.95, 0.9479, count=300),
            Criterion.of('return', -0.02, 0.1, 0.0312),
            Criterion.of('termination', 0.3, 0.05),
        ),
        'evidence': SAMPLED_STARTS,
        'ended_early': 2,
        'ended_never': 1,
    },
    'measured': {'criteria': (*VALUES, Criterion.of('termination', None, 0.05))},
    'undecided': {'criteria': (Criterion('return', 0.25, 1.0, met=False),)},
    'too few': {'criteria': (Criterion.of('return', None, 1.0),), 'n_demonstrations': 4},
    'no estimate': {'criteria': (Criterion.of('return', 2.0, 1.0),), 'more_needed': -1},
    'no range': {'criteria': (Criterion('return', None, None, met=False, obstacle=NO_RANGE),)},
    'met': {'criteria': (Criterion.of('return', 0.5, 1.0),), 'mean_return_policy': -2.0},
    'by goal': {'criteria': (Criterion.of('return', None, 1.0),), 'method': GOAL},
    'conflict': {'criteria': VALUES, 'conflicts': ('taxi row 4: the end (2x)', 'more')},
    'start and end': {'criteria': VALUES, 'conflicts': (CLASH,), 'advice': (UNTOLD, SAY_AGAIN)},
    'missing': {'criteria': VALUES, 'advice': ('Add "blocked moves": it tells what you do.',)},
}


def test_progress_is_shown_with_what_to_do(desk: Desk) -> None:
    lines = []
    for title, values in PROGRESS.items():
        desk.world.summaries = [replace(FEW, **values)]
        lines += [f'\n... {title}', *desk.see().split('\n')[4:-2]]
    desk.world.lesson = replace(desk.world.lesson, method=GOAL)
    desk.world.summaries = [replace(FEW, **PROGRESS['by goal'], n_demonstrations=2)]
    lines += ['\n... by goal, as chosen', *desk.see().split('\n')[4:-2]]
    snapshot.check('dialogue_progress.txt', '\n'.join(lines))


def test_a_key_counts_only_for_the_screen_and_the_question_that_were_seen(tmp_path: Path) -> None:
    desk = begin(tmp_path, 'taxi')
    first = desk.app.drawn()
    for keys, number in ((['backspace'], first), (['7', 'enter'], first), (['1'], first)):
        desk.app.drawn()
        desk.app.type(keys, number)  # on the same screen, or on the one before the menu
        desk.advance()
    assert desk.lesson.view.participant == 'p7'
    assert 'What next?' in desk.see()
    assert '1 was ignored: it was pressed before this screen appeared.' in desk.see()
    desk.press('1').type('fetch').press('y', 'o')
    desk.app.next_start = AT_R
    desk.press('enter', 'left', 'p')
    desk.learns = False
    desk.press('enter')
    desk.app.drawn()
    desk.app.type(['left', 'n'])  # typed ahead for the demonstration that was just kept
    desk.learns = True
    desk.publish()
    desk.asked.clear()
    desk.advance()
    assert [type(each) for each in desk.asked] == [BeginDemonstration]
    assert 'was ignored: it was pressed before this screen' in desk.see()
    desk.store.close()


def test_keys_of_one_demonstration_can_be_typed_ahead(desk: Desk) -> None:
    desk.app.drawn()
    desk.app.type(['left', 'p', 'enter'])
    desk.advance()
    assert [type(each).__name__ for each in desk.asked[-4:]] == [
        *('Drive', 'Drive', 'EndDemonstration', 'BeginDemonstration')
    ]


@pytest.mark.parametrize('key', ['left', 'enter', 'e'])
def test_who_is_displaced_asks_nothing_of_the_others_lesson_and_gives_control_back(
    desk: Desk, key: str
) -> None:
    desk.press('left', 'backspace')
    desk.world.paused_by = ME
    desk.shows('anna')
    desk.asked.clear()
    assert not any(isinstance(each, EndDemonstration) for each in desk.app.last_requests())
    desk.press(key, 'enter', 'y', 'left')
    assert desk.asked == [SetPace(0.0, paused=False), SetControl(hold=False)]


def test_earlier_demonstrations_can_start_again_at_their_end_too(desk: Desk) -> None:
    desk.press('left', 'p', 'enter', 'n')
    assert 'where your 1 earlier demonstration ended?' in desk.press('s').see()
    desk.press('2', 's', 's')
    desk.asked.clear()
    assert desk.press('1').asked == []
    desk.press('n')  # the demonstration under way is the next to be counted
    kinds = [EndDemonstration, WithdrawDemonstration, AddDemonstrations, BeginDemonstration]
    assert [type(each) for each in desk.asked] == kinds
    (changed,) = [d for d in desk.lesson.demonstrations() if d.actions and not d.withdrawn]
    assert changed.can_start_at_end
    assert changed.actions == ('west', 'pickup')
    assert 'earlier' not in desk.press('s', 's').see()


def test_a_long_list_is_shown_a_page_at_a_time(taxi: Domain) -> None:
    app, picked = App(opening('p1')), list[int]()
    app.world.domain = taxi
    app.screen = ListScreen('Many', [Item(f'item {n}', '', lambda app, n=n: picked.append(n))
                                     for n in range(1, 21)])  # fmt: skip

    def press(*keys: str) -> str:
        app.drawn()
        app.type(keys)
        app.advance(0.0)
        return '\n'.join(frame(app, 80, 24))

    assert '9 item 9' in (seen := press())
    assert 'item 10' not in seen
    assert {'2 item 11', '11 of 20'} <= {
        line.strip(' >') for line in press(*['down'] * 10, '2').split('\n')
    }
    press('up', 'up', 'enter', '9')
    press(*['down'] * 10, '9')  # the last page has two
    assert picked == [11, 9, 9]


@pytest.mark.parametrize(
    ('period', 'key', 'then'), [(0.0, '+', 0.0), (2.0, '-', 2.0), (0.3, '+', 0.1)]
)
def test_the_speed_stays_within_its_limits(
    desk: Desk, period: float, key: str, then: float
) -> None:
    desk.press('left', 'p', 'enter', 'w').world.step_period = period
    assert desk.press(key).asked[-1] == SetPace(then, paused=False)
    assert {'u undo a step', '+ faster', '? help'} <= {
        entry.strip() for line in desk.sees().split('\n') for entry in line.split('  ')
    }  # the fullest bar leaves room for the rest


def test_a_number_repeats_an_action(desk: Desk) -> None:
    assert '12 times: now press an action key.' in desk.press('0', '1', '2').see()
    assert desk.press('?').see().count('a number before an action repeats it') == 1
    desk.press('escape', '3', 'left')
    assert [step.previous_action for step in desk.world.driven] == ['west'] * 3
    assert desk.press('down').world.game.step == 4


def test_a_repeated_action_stops_at_the_end_of_the_episode(tmp_path: Path) -> None:
    desk = begin(tmp_path, 'gymnasium:FrozenLake-v1').press('enter', '4', '9', '9', 'down')
    assert 0 < desk.world.game.step < 99
    assert desk.world.game.terminated
    assert 'The task is over.' in desk.see()


def test_a_list_of_demonstrations_shows_no_feature_that_is_hidden(tmp_path: Path) -> None:
    desk = begin(tmp_path, 'taxi', *CHOSEN).press('left', 'p', 'enter', 'l')
    for _ in range(2):  # all demonstrations, then a single one
        assert isinstance(desk.app.screen, ListScreen)
        assert desk.app.screen.state == AT_R
        board = view(desk.app).board
        assert board is not None
        assert 'destination' not in [mark.name for mark in board.marks]
        desk.press('enter')


def test_a_step_of_a_world_that_is_replayed_is_undone(tmp_path: Path) -> None:
    desk = Desk(Orchard(), tmp_path).teach('fetch', ['basket'], '').press('right')
    before = desk.world.game.state
    desk.press('3', 'down', 'u', 'u', 'u')
    assert (desk.world.game.state, desk.world.game.step) == (before, 1)


ABOARD = 'taxi 1,1 passenger aboard destination G'
RUN = (AT_R, 'taxi 0,0 passenger R destination G', 'taxi 0,0 passenger aboard destination G')


@pytest.fixture
def examined(desk: Desk) -> Desk:
    """Let the machine's runs be judged; what the lesson publishes is set by hand."""
    desk.press('left', 'p', 'enter')
    desk.publish = lambda: None  # type: ignore[method-assign]
    desk.asked.clear()
    return desk


def publishes(desk: Desk, phase: Phase, **values: Any) -> None:
    """Let the lesson publish something else."""
    desk.world.lesson = replace(desk.lesson.view, phase=phase, exam_needed=5, **values)
    desk.advance()


def asks(desk: Desk, *, compared: tuple[str, ...] = (), states: tuple[str, ...] = RUN) -> None:
    """Let the lesson ask about a run."""
    text = 'Here it would stop after 2 steps. Right?'
    publishes(
        desk,
        Phase.CHECKING,
        question=text,
        question_id=7,
        question_states=states,
        question_compared=compared,
    )


def test_a_run_of_the_exam_is_not_judged_before_its_first_state_arrives(examined: Desk) -> None:
    examined.world.game = game = replace(examined.world.game, step=2)  # of a demonstration
    publishes(examined, Phase.DEMONSTRATING, exam=True, episode=game.episode + 1)
    shown = examined.see()
    assert 'Exam: run 1 of 5, step 0' in shown
    assert 'Was it right?' not in shown
    assert examined.press('r', 'w').asked == []
    examined.world.game = replace(game, episode=game.episode + 1)
    assert 'The run has ended. Was it right?' in examined.see()


def test_a_run_is_played_until_the_question_about_it_is_answered(examined: Desk) -> None:
    asks(examined)
    assert 'board: the machine, step 0 of 2' in (seen := examined.see())
    assert 'taxi col 1 → 0' in seen
    assert 'destination' not in seen
    drawn = []
    for _ in range(40):
        examined.advance(0.1)
        drawn.append(examined.app.screen.state)
    assert list(dict.fromkeys(drawn)) == list(RUN)
    assert drawn.count(RUN[0]) > drawn.count(RUN[1])
    assert RUN[0] in drawn[drawn.index(RUN[2]) :]
    assert examined.press('enter', 'right', 'right', 'right').app.screen.state == RUN[2]
    assert examined.advance(5.0).press('left').app.screen.state == RUN[1]
    assert examined.asked == []
    assert 'replay the run continuously' in examined.press('?').see()
    assert examined.press('x', 'y').asked == [AnswerQuestion(7, yes=True)]


def test_a_run_and_a_demonstration_are_drawn_one_after_the_other(examined: Desk) -> None:
    asks(examined, compared=(RUN[0], ABOARD, *RUN))
    seen = {examined.advance(0.3).app.screen.state: examined.see() for _ in range(40)}
    assert {*seen} == {*RUN, ABOARD}
    assert 'board: you, step 1 of 4' in seen[ABOARD]
    assert 'board: the machine, step 0 of 2' in seen[ABOARD]
    assert 'board: you, step 0 of 4' in examined.press('down', 'down', 'up').see()
    assert examined.press('n').asked == [AnswerQuestion(7, yes=False)]


def test_a_start_that_is_refused_is_drawn_alone(examined: Desk) -> None:
    asks(examined, states=(AT_R,))
    assert examined.advance(9.0).app.screen.state == AT_R
    assert 'board:' not in (seen := examined.see())
    assert 'step forward' not in seen


def test_an_answer_counts_only_for_the_question_that_was_seen(examined: Desk) -> None:
    asks(examined)
    number = examined.app.drawn()
    examined.world.lesson = replace(examined.world.lesson, question_id=8)
    examined.app.type(['y'], number)
    assert examined.advance().asked == []


KEYS = [
    'up',
    'down',
    'left',
    'right',
    'enter',
    'escape',
    'backspace',
    ' ',
    *'123456ynoelwsuqcx?t-.rm',
]


class DialogueMachine(RuleBasedStateMachine):
    """Any keys and news in any order: nothing hangs, nothing is lost, nothing is left behind."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = TemporaryDirectory()
        self.kept: set[str] = set()

    @initialize(taught=st.booleans(), met=st.booleans())
    def sit_down(self, taught: bool, met: bool) -> None:
        self.desk = Desk(make_domain('taxi'), Path(self.folder.name), budget=6)
        if met:
            meet_criteria(self.desk)
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
        desk.advance()

    @rule()
    def silence(self) -> None:
        self.desk.silent = {'lesson'}
        if not self.desk.app.ended:
            self.desk.press('enter')
        self.desk.silent = set()
        self.desk.advance(REPLY_SECONDS)

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
