"""Screens for a play of the whole task, which the person cuts into demonstrations of options."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, KW_ONLY, replace
from functools import partial

from humanopts_learner.demonstrations import Demonstration, option_name_fault
from humanopts_learner.segments import cut, event_features, joined, Segment, suggested_features
from humanopts_teach.dialogue import keys
from humanopts_teach.dialogue.app import App, Screen
from humanopts_teach.dialogue.driving import PlayScreen
from humanopts_teach.dialogue.entry import confirm, quitting, TextScreen, with_help
from humanopts_teach.dialogue.keys import Command, Do
from humanopts_teach.dialogue.panel import Choices, GAP, Line, Panel, Tone
from humanopts_teach.dialogue.teaching import LessonScreen
from humanopts_teach.language import _, N_, translated
from humanopts_teach.lesson.attempt import demonstration_of
from humanopts_teach.lesson.requests import (
    AddDemonstrations,
    AnswerQuestion,
    DefineOption,
    Phase,
)

Run = Callable[[str, App], None]


@dataclass
class WholeTaskScreen(PlayScreen):
    """The person plays the whole task, which is then cut into segments."""

    _: KW_ONLY
    run: Run
    title: str = N_('Play the whole task once')
    text: str = N_('Then name its parts, and they become demonstrations.')

    def machine(self, app: App) -> list[Command]:
        since, driven = app.world.since, app.world.driven

        def show(app: App) -> None:
            assert since is not None
            play = demonstration_of(
                app.domain,
                [since, *driven],
                option_name=self.title,
                participant=app.participant,
                session='',
            )
            segments = cut(app.domain, play, event_features(app.domain, [play]))
            app.show(SegmentsScreen(self.menu, self.run, play, segments))

        enter = show if since is not None and driven else None
        return [Command([keys.ENTER], _('cut it into parts'), enter, _('end the play here'))]


@dataclass
class SegmentsScreen(Screen):
    """
    The segments of a play; the person names, merges or drops them.

    :ivar names: option name of each segment; empty: it is left out.
    :ivar at: index of the selected segment.
    :ivar step: step of the play that the board shows.
    :ivar kept: names of options with kept demonstrations.
    """

    menu: Do
    run: Run
    play: Demonstration
    segments: list[Segment]
    names: list[str] = field(init=False)
    at: int = 0
    step: int = field(init=False)
    kept: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        """Begin at the first segment, without names."""
        self.names = [''] * len(self.segments)
        self.step = self.segments[0].last

    @property
    def state(self) -> str:
        """The state of the play to draw."""
        return self.play.states[self.step]

    def panel(self, app: App) -> Panel:
        items = []
        for segment, name in zip(self.segments, self.names):
            kept = _(' (kept)') if name in self.kept else ''
            first, last = segment.first + 1, segment.last
            steps = (
                _('steps {first} to {last}').format(first=first, last=last)
                if first < last
                else _('step {last}').format(last=last)
            )
            items.append((f'{steps}: {name or _("left out")}{kept}', _ends(segment)))
        note = _('Consecutive parts with the same name become one demonstration.')
        where = Line(
            _('board: step {number} of {count}').format(
                number=self.step, count=len(self.play.actions)
            ),
            Tone.QUIET,
        )
        title = Line(_('The parts of your play'), strong=True)
        listed = Choices(items, self.at, 'n')
        return Panel((title, where, GAP, listed, GAP, Line(note, Tone.QUIET)))

    def commands(self, app: App) -> Sequence[Command]:
        part, last = self.segments[self.at], self.at == len(self.segments) - 1

        def go(at: int) -> Do:
            def move(app: App) -> None:
                self.at = at % len(self.segments)
                self.step = self.segments[self.at].last

            return move

        def look(step: int) -> Do:
            def move(app: App) -> None:
                self.step = min(max(step, part.first), part.last)

            return move

        wanted = {*self.names} - {''} - self.kept
        commands = [
            Command([keys.UP], _('move'), go(self.at - 1), label='↑ ↓'),
            Command([keys.DOWN], _('move down'), go(self.at + 1), label=''),
            Command([keys.LEFT], _('step back'), look(self.step - 1)),
            Command([keys.RIGHT], _('step forward'), look(self.step + 1)),
            Command('n', _('name'), self._name, _('name the option that this part shows')),
            Command(
                'm', _('merge'), None if last else self._merge, _('join it with the next part')
            ),
            Command(
                'd', _('drop'), self._drop if self.names[self.at] else None, _('leave it out')
            ),
            Command(
                [keys.ENTER],
                _('make demonstrations'),
                self._keep if wanted else None,
                _('every part with a name becomes a demonstration of its option'),
            ),
            Command([keys.ESCAPE], _('menu'), self._leave if wanted else self.menu),
            *quitting(app),
        ]
        return with_help(commands, self.again)

    def _name(self, app: App) -> None:
        def submit(name: str, app: App) -> None:
            if fault := option_name_fault(name):
                app.say(translated(f'{fault}.'), bad=True)
            else:
                self.names[self.at] = name
                app.show(self)

        ends, name = _ends(self.segments[self.at]), self.names[self.at]
        app.show(TextScreen(_('What is the option called?'), ends, name, submit, self.again))

    def _merge(self, app: App) -> None:
        at = self.at
        whole = replace(self.segments[at + 1], first=self.segments[at].first)
        self.segments[at : at + 2] = [whole]
        self.names[at : at + 2] = [self.names[at] or self.names[at + 1]]
        self.step = whole.last

    def _drop(self, app: App) -> None:
        self.names[self.at] = ''

    def _leave(self, app: App) -> None:
        question = _('Go to the menu? The names are forgotten; the recording keeps the play.')
        app.show(confirm(question, self.menu, self.again))

    def _keep(self, app: App) -> None:
        """Turn the segments of each option into demonstrations, one option after another."""
        found: dict[str, list[Segment]] = {}
        for name, segment in joined(self.segments, self.names):
            found.setdefault(name, []).append(segment)
        left = [name for name in found if name not in self.kept]
        if not left:
            app.say(_('Demonstrations kept: {names}.').format(names=', '.join(found)))
            self.menu(app)
            return
        name = left[0]
        screen = KeepScreen(
            self.again,
            self.run,
            segments=found[name],
            suggested=suggested_features(app.domain, found[name]),
            kept=partial(self._kept, name),
        )
        app.groups.forget()
        app.ask(DefineOption(name), then=lambda answer: app.show(screen))

    def _kept(self, name: str, app: App) -> None:
        self.kept.add(name)
        if name not in app.known_options:
            app.known_options = (*app.known_options, name)
        app.show(self)
        self._keep(app)


@dataclass
class KeepScreen(LessonScreen):
    """
    The questions about an option, with the answers suggested by its segments, which are then kept.

    :ivar accepts: answer all remaining questions as suggested.
    :ivar sent: the segments were sent to the lesson.
    """

    _: KW_ONLY
    segments: Sequence[Segment]
    suggested: tuple[str, ...]
    kept: Do
    accepts: bool = False
    sent: bool = False

    def panel(self, app: App) -> Panel:
        panel = super().panel(app)
        words = _('Your play suggests: {features}').format(
            features=', '.join(map(translated, self.suggested))
        )
        return replace(panel, beside=(*panel.beside, GAP, Line(words, Tone.NEWS)))

    def _answers(self, app: App) -> list[Command]:
        group, lesson = app.groups.open_group(app.domain, app.world.lesson), app.world.lesson
        asked = {lesson.question_feature} if group is None else {*group.features}
        yes, no, *others = super()._answers(app)
        fits = asked & {*self.suggested}
        words = _('as suggested: {answer}').format(answer=_('yes') if fits else _('no'))

        def accept(app: App) -> None:
            self.accepts = True

        return [
            *(yes, no),
            Command([keys.ENTER], words, (yes if fits else no).do),
            Command('a', _('all as suggested'), accept),
            *(each for each in others if keys.ENTER not in each.wanted),
        ]

    def tick(self, app: App) -> None:
        lesson = app.world.lesson
        if lesson.phase is Phase.ASKING and self.accepts:
            yes = lesson.question_feature in self.suggested
            app.ask(AnswerQuestion(lesson.question_id, yes), then=partial(self._answered, app))
        elif lesson.phase not in (Phase.ASKING, Phase.DEMONSTRATING) and not self.sent:
            self.sent = True
            shown = tuple(
                each.demonstration(lesson.option_name, lesson.chosen_features)
                for each in self.segments
            )
            app.ask(AddDemonstrations(shown), then=lambda answer: self.kept(app))
        else:
            super().tick(app)

    def refused(self, app: App) -> None:
        """Go back to the segments if they were refused; their names are kept."""
        super().refused(app)
        self.accepts = False
        if self.sent:
            self.menu(app)


def _ends(segment: Segment) -> str:
    """Describe the changes at the end of a segment."""
    return ', '.join(map(translated, segment.end))
