"""
``humanopts study check``: the screens that participants see, in order, without a graph.

The screens are those of the real dialogue, which is operated by simulated key presses. A simulated
teacher gives the lesson in this process.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
import re
import time

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.game import Game, Source, Transition
from humanopts_env.seeding import generator
from humanopts_learner.summary import OptionSummary
from humanopts_teach.commands.session import taught_options
from humanopts_teach.dialogue.app import App, Screen
from humanopts_teach.dialogue.consent import ConsentApp
from humanopts_teach.dialogue.keys import ENTER, ESCAPE
from humanopts_teach.dialogue.menu import to_lesson, to_menu
from humanopts_teach.dialogue.panel import OPTION_KEYS
from humanopts_teach.dialogue.study import StudyApp
from humanopts_teach.language import speaking
from humanopts_teach.lesson.in_process import SECONDS, teach
from humanopts_teach.lesson.question_groups import GroupAnswer
from humanopts_teach.lesson.requests import (
    Answer,
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    LessonView,
    Phase,
    RequestStatus,
    World,
)
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.simulated_teacher import Act, TeacherError, TeacherSettings
from humanopts_teach.study.plan import Condition, Part, PartKind, StudyPlan
from humanopts_teach.study.questions import QuestionKind
from humanopts_teach.study.record import OpenRecord
from humanopts_teach.terminal.drawing import frame

WIDTH, HEIGHT = 80, 24  # size of the simulated terminal
_TALL = 200  # rows, enough for every screen
_STARTS = 20  # maximum of start states per option
_ERROR_RATE = 0.02  # share of the simulated teacher's steps that are wrong
_CODE = 'p01'
_READING = 200 / 60  # words per second; adults read about 240 a minute (Brysbaert 2019)
_QUESTION = 8.0  # s per question
_BUTTON = 30.0  # s per button
_PRACTICE = 60.0  # s
_STEP = 5.0  # s between two key presses
_MOST_KEYS = 2000  # key presses in one part


@dataclass
class PlanCheck:
    """
    Goes through the parts of a plan, and yields the screens that participants see.

    :ivar seconds: estimated time of each part, by key.
    :ivar notes: notes for the researcher.
    """

    plan: StudyPlan
    folder: Path
    language: str  # of the screens
    seconds: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    _limits: dict[str, float] = field(default_factory=dict)  # time limits in min, by part

    def run(self) -> Iterator[str]:
        """Yield lines: all screens in order, then the times and the places."""
        for place in range(max(self.plan.participants, 2 * len(self.plan.conditions))):
            for condition, parts in self.plan.turns_of(place, place):
                new = [part for part in parts if part.key not in self.seconds]
                domain = make_domain(condition.domain, dict(condition.parameters)) if new else None
                for part in new:
                    self._limits[part.key] = part.minutes
                    yield f'\n===== {part.key} ====='
                    yield from self._part(part, condition, domain)
        yield from self._summary()

    def _part(self, part: Part, condition: Condition, domain: Domain | None) -> Iterator[str]:
        """Yield the screens of a part, and estimate its time."""
        match part.kind:
            case PartKind.TEACH:
                assert domain is not None
                yield from self._teach(part, condition, domain)
                return
            case PartKind.PRACTICE:
                seconds = _PRACTICE
            case PartKind.PLAY:
                seconds = 60 * part.minutes
            case PartKind.BUTTONS:
                seconds = part.most * _BUTTON
            case PartKind.QUESTIONS if part.questions is not None:
                seconds = len(part.questions.items) * _QUESTION
            case _:
                seconds = max(part.reading, len(part.text.split()) / _READING)
        self.seconds[part.key] = seconds
        app: App = ConsentApp([part]) if part.kind is PartKind.CONSENT else self._app(part, domain)
        app.language = self.language
        keys, now, seen = _keys(part, self.plan.seed), time.monotonic(), None
        for _ in range(_MOST_KEYS):
            while (request := app.advance(now)) is not None:
                app.replied(request, Answer(RequestStatus.OK, ''), now)
                now += _STEP
            if app.ended:
                return
            if app.screen is not seen and type(app.screen) is not Screen:
                seen = app.screen
                yield self._screen(app, part)
            app.drawn()
            app.type([])
            for _ in range(2):  # for the minimum display time
                app.advance(now)
                now += max(app.screen.earliest, _STEP)
            app.type([next(keys, ESCAPE)])
        self.notes.append(f'{part.key} does not end by itself')

    def _app(self, part: Part, domain: Domain | None) -> StudyApp:
        """Return the dialogue of one part, with the game, without a graph."""
        record = OpenRecord(self.folder / f'{part.key.replace("/", "-")}.jsonl')
        world = World(domain=domain, me=_CODE)
        if domain is not None:
            game = Game(domain)
            game.reset('', self.plan.seed, Source.PERSON)
            world.update_game(game.transition)
        return StudyApp([part], record, _CODE, world, seed=self.plan.seed)

    def _teach(self, part: Part, condition: Condition, domain: Domain) -> Iterator[str]:
        """Yield the screens of a lesson, one per kind, and the learned options."""
        names = part.teach_buttons or taught_options(domain)
        app, lines = self._app(part, domain), list[str]()
        app.participant, app.given_options = _CODE, part.teach_buttons
        app.language = self.language
        seen = set[object]()

        def show(*kind: object) -> None:
            if kind not in seen:
                seen.add(kind)
                lines.append(self._screen(app, part))

        def watch(
            lesson: LessonView, game: Transition, summaries: Sequence[OptionSummary], act: Act
        ) -> None:
            world = app.world
            world.lesson, world.summaries = lesson, summaries
            world.update_game(game)
            demonstrates = lesson.phase is Phase.DEMONSTRATING and not lesson.exam
            world.holder = world.me if demonstrates else ''
            if isinstance(act, DefineOption):
                with speaking(self.language):
                    to_menu(app)
                show('menu')
                to_lesson(app)
            elif lesson.phase is Phase.ASKING:
                wanted = reference_options(domain)[lesson.option_name].features
                if group := app.groups.open_group(domain, lesson):
                    show(group.words)
                    some = any(name in wanted for name in group.features)
                    app.groups.answer(group, GroupAnswer.EACH if some else GroupAnswer.NONE)
                if app.groups.reply(domain, lesson) is None:
                    show(lesson.question_feature)
            elif lesson.phase not in (Phase.LEARNING, Phase.NO_SESSION):
                show(lesson.phase, lesson.exam, game.episode != lesson.episode)

        budget = min(condition.budget, _STARTS)
        rules = LessonRules(
            condition.strategy,
            budget,
            self.plan.seed,
            method=condition.learn,
            derive=condition.derive,
        )
        teacher = TeacherSettings(names, _CODE, '1', _ERROR_RATE, seed=self.plan.seed)
        try:
            taught = teach(domain, teacher, rules, watch=watch)
        except TeacherError as error:
            self.notes.append(f'{part.key} was not tried: {error}')
            self.seconds[part.key] = 60 * part.minutes
            return
        if budget < condition.budget:
            yield f'(with {budget} of the {condition.budget} start states)\n'
        yield from lines
        starts = taught.acts[BeginDemonstration] or 1
        asking = sum(SECONDS[kind] * taught.acts[kind] for kind in (DefineOption, AnswerQuestion))
        unlearned = [each for each in taught.summaries if not each.learned]
        more = len(unlearned) * (condition.budget - budget)  # start states
        seconds = taught.seconds + more * (taught.seconds - asking) / starts
        self.seconds[part.key] = min(seconds, 60 * part.minutes)
        if seconds > 60 * part.minutes:
            self.notes.append(
                f'{part.key} may take {seconds / 60:.0f} minutes until every option is learned or '
                f'all {condition.budget} start states are used; the limit is {part.minutes:g}'
            )
        for each in taught.summaries:
            yield (
                f'{each.option_name}: {each.n_demonstrations} shown, {each.n_not_here} not here; '
                f'{each.status}'
            )

    def _screen(self, app: App, part: Part) -> str:
        """Return a screen as text; add a note if it does not fit the terminal."""
        if any('a taller window shows more' in line for line in frame(app, WIDTH, HEIGHT)):
            note = f'a screen of {part.key} needs more than {HEIGHT} rows of {WIDTH} columns'
            self.notes.extend({note}.difference(self.notes))
        lines = '\n'.join(frame(app, WIDTH, _TALL))
        return re.sub(r'\n{3,}', '\n\n', lines) + '\n'

    def _summary(self) -> Iterator[str]:
        """Yield times, places, and notes."""
        yield '===== estimated minutes ====='
        limits = {part: f' (limit {limit:g})' for part, limit in self._limits.items() if limit}
        for key, seconds in self.seconds.items():
            yield f'{seconds / 60:6.1f}  {key}{limits.get(key, "")}'
        places = range(max(self.plan.participants, 2 * len(self.plan.conditions)))
        orders = {place: [each.name for each in self.plan.order_of(place)] for place in places}
        yield '\n===== places ====='
        counts = Counter(tuple(order) for order in orders.values())
        for names, count in counts.items():
            place = next(place for place in places if orders[place] == [*names])
            minutes = sum(self.seconds[p.key] for p in self.plan.parts_of(place, place)) / 60
            held = f'{count} places' if self.plan.participants else 'any number of places'
            yield f'{", ".join(names)}: {held}, about {minutes:.0f} minutes each'
        for note in self.notes:
            yield f'note: {note}'


def _keys(part: Part, seed: int) -> Iterator[str]:
    """Yield the keys that a simulated participant presses in a part, then Escape."""
    rng = generator(seed, 'checked plan', part.key)
    if part.kind is PartKind.CONSENT:
        yield 'y'
    elif part.kind is PartKind.PAGE:
        yield ENTER
    elif part.kind is PartKind.BUTTONS:
        for number in range(part.most):
            yield from (*f'button {number + 1}', ENTER)
    elif part.questions is not None:
        for question in part.questions.items:
            value = question.draw(rng, part.questions.points)
            if question.kind in (QuestionKind.CHOICE, QuestionKind.CHOICES):
                for number in value if isinstance(value, tuple) else (value,):
                    yield OPTION_KEYS[number - 1]
            else:
                yield from str(value)
            yield ENTER
