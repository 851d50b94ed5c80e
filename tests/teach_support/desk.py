"""A person at the dialogue, with the real lesson and game behind it; nothing here needs ROS."""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

from humanopts_env.domains.base import ActableDomain
from humanopts_env.game import Accepted, Command, Game, Source
from humanopts_learner.demonstrations import group_by_option
from humanopts_learner.options.exam import with_verdicts
from humanopts_learner.summary import OptionSummary, unmeasured
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.menu import opening
from humanopts_teach.dialogue.view import view
from humanopts_teach.lesson.lesson import Lesson
from humanopts_teach.lesson.requests import (
    Answer,
    AnswerQuestion,
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
    Request,
    RequestStatus,
    RunOption,
    server,
    SetControl,
    SetExecution,
    SetPace,
    Verdict,
)
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.store import DemonstrationStore
from humanopts_teach.terminal.drawing import drawn, frame
from rich.console import Console

from teach_support.lesson import Drawn

ME = 'terminal'
MEASURED = ('criteria', 'more_needed', 'conflicts', 'advice', 'mean_return_policy')


class Desk:
    """
    Presses keys, and has each request carried out at once.

    :ivar asked: all requests, in order.
    :ivar silent: nodes that do not answer.
    :ivar learns: the learner counts each demonstration in, or out, at once.
    :ivar reports: what it measures of an option, by name; else it measures nothing.
    :ivar exam: number of runs in the first exam of an option.
    """

    def __init__(
        self, domain: ActableDomain, folder: Path, *, budget: int = 100, app: App | None = None
    ) -> None:
        self.app = app or App(opening('p1'))
        self.world = self.app.world
        self.world.domain, self.world.me = domain, ME
        self.store = DemonstrationStore(folder)
        self.game = self.make_game()
        self.now = 0.0
        self.lesson = Lesson(
            domain,
            self.store,
            Drawn(domain, LessonRules('random', budget)),
            clock=lambda: self.now,
            today=lambda: '20260102',
        )
        self.asked: list[Request] = []
        self.silent: set[str] = set()
        self.learns = True
        self.reports: dict[str, OptionSummary] = {}
        self.exam = 0
        self.game.reset('', 0, Source.PERSON)
        self.publish()

    def make_game(self) -> Any:
        """Return what is acted in."""
        return Game(self.app.domain)

    def press(self, *keys: str) -> 'Desk':
        """Look at the screen long enough and press keys, one after the other."""
        for key in keys:
            self.app.drawn()
            self.app.type([])
            self.advance().advance(self.app.screen.earliest)
            self.app.type([key])
            self.advance()
        return self

    def teach(self, name: str, chosen: Collection[str], start: str) -> 'Desk':
        """Open a session, name an option, answer its questions, and begin at a start."""
        self.press('enter', '1').type(name)
        while self.lesson.phase is Phase.ASKING:
            asked = self.lesson.view
            yes = asked.question_feature in chosen
            self.lesson.carry_out(AnswerQuestion(asked.question_id, yes))
        self.publish()
        self.app.next_start = start
        return self.press('enter')

    def shows(self, who: str) -> None:
        """Let a person, at another terminal, begin a demonstration."""
        self.lesson.carry_out(EndDemonstration(Verdict.DISCARD, 0, 0))
        self.lesson.carry_out(OpenSession(who))
        self.lesson.carry_out(DefineOption('hers'))
        for _ in self.app.domain.features:
            number = self.lesson.view.question_id
            self.lesson.carry_out(AnswerQuestion(number, yes=True))
        self.carry_out(BeginDemonstration('taxi 0,1 passenger R destination G'))
        self.publish()

    def type(self, text: str) -> 'Desk':
        """Type a text and Enter."""
        return self.press(*text, 'enter')

    def advance(self, seconds: float = 0.0) -> 'Desk':
        """Let time pass, and carry out what is asked for."""
        self.now += seconds
        while (request := self.app.advance(self.now)) is not None:
            self.asked.append(request)
            if server(request) in self.silent:
                break
            answer = self.carry_out(request)
            self.publish()
            self.app.replied(request, answer, self.now)
        return self

    def machine(self, *actions: str) -> 'Desk':
        """Let the machine take steps, as far as the game takes them."""
        for action in actions:
            here = self.game.transition
            self._step(Command('machine', 0, Source.MACHINE, here.episode, here.step, action))
        self.publish()
        return self.advance()

    def run_ends(self, text: str, *, well: bool = True) -> 'Desk':
        """Let the run under way end."""
        assert self.app.run is not None
        self.app.run_ended(self.app.run, well, text)
        return self.advance()

    def publish(self) -> None:
        """Let lesson, learner and game publish how things are."""
        counted = group_by_option(self.lesson.demonstrations())
        if self.learns:
            for (_, name), demos in counted.items():
                measured = {key: getattr(self.reports[name], key)
                            for key in MEASURED if name in self.reports}  # fmt: skip
                summary = replace(unmeasured(demos), **measured)
                self.reports[name] = with_verdicts(summary, demos, self.exam)
            names = {name for _, name in counted}
            self.world.summaries = [each for name, each in self.reports.items() if name in names]
            self.lesson.update_summaries(self.world.summaries)
        self.world.lesson = self.lesson.view
        self.world.holder = self.game.control.holder_id

    def sees(self, width: int = 80, height: int = 24) -> str:
        """Return the whole screen of a terminal."""
        return '\n'.join(frame(self.app, width, height))

    def see(self) -> str:
        """Return all words of the screen but those of the board."""
        shown, console = view(self.app), Console(width=400, color_system=None)
        with console.capture() as words:
            for block in (*shown.panel.beside, *shown.panel.below):
                console.print(drawn(block))
        lines = [' · '.join(shown.head), shown.paused, *words.get().split('\n')]
        said = [f'"{shown.said.text}"'] if shown.said.text else []
        keys = '  '.join(f'[{label}] {words}' for _, label, words in shown.keys if label)
        return '\n'.join(line.rstrip() for line in (*lines, *said, keys) if line.strip())

    def carry_out(self, request: Request) -> Answer:
        """Answer as the graph would."""
        match request:
            case Drive(action):
                here = self.game.transition
                taken = self._step(Command(ME, 0, Source.PERSON, here.episode, here.step, action))
                return _answer(taken == '', taken)
            case SetControl(hold):
                reply = self.game.set_control(hold, ME)
                return _answer(not reply.detail.startswith('control is'), '')
            case SetPace(period, paused):
                self.world.step_period, self.world.paused_by = period, ME if paused else ''
            case NewEpisode(seed):
                self._reset('', seed)
                return Answer(RequestStatus.OK, '', episode=self.game.transition.episode)
            case ListOptions():
                names = tuple(s.option_name for s in self.world.summaries if s.n_demonstrations)
                return Answer(RequestStatus.OK, '', option_names=names)
            case SetExecution(execution):
                self.world.execution = execution
            case CancelRun() if self.app.run is not None:
                self.app.run_ended(self.app.run, True, 'Stopped.')
            case RunOption() | PlanOptions() | PlayEpisodes() | CancelRun():
                pass
            case _:
                answer = self.lesson.carry_out(request)
                if isinstance(request, BeginDemonstration) and answer.ok:
                    self._reset(answer.state, answer.seed)
                    here = self.game.transition
                    answer = self.lesson.began(here.episode, here.state)
                    self.lesson.add_transition(here)
                return answer
        return Answer(RequestStatus.OK, '')

    def _step(self, command: Command) -> str:
        """Take a step; return why it is refused."""
        result = self.game.command(command)
        if not isinstance(result, Accepted):
            return result.detail
        self.world.update_game(result.transition)
        self.lesson.add_transition(result.transition)
        return ''

    def _reset(self, state: str, seed: int) -> None:
        self.game.reset(state, seed, Source.PERSON)
        self.world.update_game(self.game.transition)


def _answer(ok: bool, detail: str) -> Answer:
    return Answer(RequestStatus.OK if ok else RequestStatus.REFUSED, detail)
