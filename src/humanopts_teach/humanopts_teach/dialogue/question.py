"""A question about a run of the machine, which is played on the board until it is answered."""

from dataclasses import dataclass

from humanopts_env.domains.described import published_state
from humanopts_env.domains.formulas import feature_columns, plain_name
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.keys import Command, Do, DOWN, LEFT, RIGHT, SPACE, UP
from humanopts_teach.dialogue.panel import Block, Features, GAP, Line, Panel, Tone
from humanopts_teach.language import _, translated
from humanopts_teach.lesson.requests import LessonView

STEP_SECONDS = 0.4  # display time of a state
END_SECONDS = 1.2  # the same for the first and the last state of a run
RUN_SECONDS = 6.0  # maximum playing time; longer runs are played faster


@dataclass
class RunQuestion:
    """
    The open question about a run, and the state of the run to draw.

    :ivar lesson: the lesson with the question.
    :ivar compares: draw the compared demonstration instead of the run.
    :ivar step: index into the states of the run.
    :ivar plays: whether to advance automatically.
    """

    lesson: LessonView
    compares: bool = False
    step: int = 0
    plays: bool = True
    _until: float = 0.0  # s, end of the display of the current state; 0: not drawn yet

    @property
    def states(self) -> tuple[str, ...]:
        """The states of the run, or of the demonstration, in the domain's notation."""
        lesson = self.lesson
        return lesson.question_compared if self.compares else lesson.question_states

    @property
    def state(self) -> str:
        """The state to draw."""
        return self.states[self.step] if self.states else ''

    def tick(self, now: float) -> None:
        """
        Show the next state when it is due; after the last one, switch or start again.

        :param now: monotonic time in seconds.
        """
        last = len(self.states) - 1
        if not self.plays or last < 1 or now < self._until:
            return
        if self._until and self.step == last:
            self._show(compares=bool(self.lesson.question_compared) and not self.compares)
        elif self._until:
            self.step += 1
        at_end = self.step in (0, len(self.states) - 1)
        seconds = min(STEP_SECONDS, RUN_SECONDS / len(self.states))
        self._until = now + (END_SECONDS if at_end else seconds)

    def panel(self, app: App) -> Panel:
        """Return the question, the length of the run, and the features at its start and end."""
        lesson = self.lesson
        runs = [(_('the machine'), lesson.question_states), (_('you'), lesson.question_compared)]
        drawn = [
            Line(
                _('board: {who}, step {number} of {count}').format(
                    who=who,
                    number=self.step if compares == self.compares else 0,
                    count=len(states) - 1,
                ),
                Tone.NEWS if compares == self.compares else Tone.QUIET,
            )
            for compares, (who, states) in enumerate(runs)
            if len(states) > 1
        ]
        number = _('question {number} about its behaviour').format(number=lesson.n_questions + 1)
        after = _('After no, you show what it should do there.')
        blocks: list[Block] = [
            Line(_('Teaching: '), more=(Line(lesson.option_name, strong=True),)),
            Line(number, Tone.QUIET),
            GAP,
            Line(translated(lesson.question), strong=True),
            *drawn,
            self._features(app),
            GAP,
            Line(after, Tone.QUIET),
        ]
        return Panel(blocks)

    def commands(self) -> list[Command]:
        """Return the commands that control the playback."""
        last = len(self.states) - 1
        if last < 1:
            return []
        other = self.lesson.question_compared and self._to(not self.compares, 0)
        return [
            Command([LEFT], _('step back'), self._to(self.compares, max(self.step - 1, 0))),
            Command([RIGHT], _('step forward'), self._to(self.compares, min(self.step + 1, last))),
            Command(
                [SPACE],
                _('stop') if self.plays else _('play'),
                self._play,
                _('replay the run continuously, or stop at a state'),
            ),
            Command([UP], _('machine or you'), other or None, label='↑ ↓'),
            Command([DOWN], _('you or machine'), other or None, label=''),
        ]

    def _to(self, compares: bool, step: int) -> Do:
        def go(app: App) -> None:
            self.plays = False
            self._show(compares, step)

        return go

    def _play(self, app: App) -> None:
        self.plays, self._until = not self.plays, 0.0

    def _show(self, compares: bool, step: int = 0) -> None:
        self.compares, self.step = compares, step

    def _features(self, app: App) -> Features:
        """Return the chosen features at the start of the run, and at its end if they differ."""
        domain, states = app.domain, self.lesson.question_states
        ends = [
            domain.feature_values(published_state(domain, state, app.world.game.features))
            for state in (states[0], states[-1])
        ]
        shown = []
        for column in feature_columns(domain, self.lesson.chosen_features):
            texts = list(dict.fromkeys(translated(column.text(row)) for row in ends))
            shown.append((translated(plain_name(column.feature.name)), ' → '.join(texts)))
        return Features(shown)
