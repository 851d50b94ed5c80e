"""Practice for a study: buttons, *done* and *not here*, in the game itself."""

from dataclasses import dataclass, field
from enum import Enum

from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.driving import last_step, PlayScreen
from humanopts_teach.dialogue.entry import with_help
from humanopts_teach.dialogue.keys import BACKSPACE, Command, ENTER, ESCAPE
from humanopts_teach.dialogue.panel import GAP, Line, Panel, Tone
from humanopts_teach.language import _, N_

STEPS = 3  # steps of the practised button


class Stage(Enum):
    """The current exercise."""

    DONE = 'done'
    NOT_HERE = 'not here'
    OVER = 'nothing more'


_TEXTS = {
    Stage.DONE: N_(
        'A button is a name for something that you do again and again. In a kitchen, a button '
        'could be: make tea. You teach a button by doing it yourself, from several starts.'
    ),
    Stage.NOT_HERE: N_(
        'Good: done means that the button ends here. Then the next start comes up. '
        'Sometimes a button makes no sense at a start: there is no tea to make without '
        'water.'
    ),
    Stage.OVER: N_(
        'Good: not here means that the button cannot begin at this start. That is all: '
        'do it and say done, or say not here.'
    ),
}


@dataclass
class PracticeScreen(PlayScreen):
    """One demonstration and one *not here*, with the keys of a lesson; nothing is kept."""

    stage: Stage = field(default=Stage.DONE, init=False)
    _fresh: bool = field(default=False, init=False)  # a new start was requested

    def tick(self, app: App) -> None:
        """Begin at a new start."""
        if not self._fresh and not app.world.robot:
            self._fresh = True
            app.ask(self.new_start(app))

    def panel(self, app: App) -> Panel:
        world, step = app.world, app.world.game.step
        if self.stage is Stage.OVER:
            todo = _('Enter continues with the study.')
        elif world.game.episode and not world.game.open and not world.robot:
            todo = _('This game is over. Backspace: a new start.')
        elif self.stage is Stage.DONE:
            todo = _('Practise the button "take three steps": take three steps with the keys.')
            if step:
                todo = _('{count} of {steps} steps.').format(count=step, steps=STEPS)
            if step >= STEPS:
                todo = _('The button has done what it should. Press Enter: done.')
        else:
            todo = _(
                'For practice, say that "take three steps" makes no sense here. Press n: not here.'
            )
            if step:
                todo = _(
                    'You can say "not here" only before the first step. Backspace: a new start.'
                )
        kept = Line(f'  {_("Nothing here is kept.")}', Tone.QUIET)
        title = Line(_('Practice'), strong=True, more=(kept,))
        blocks = [
            title,
            Line(todo, Tone.NEWS, strong=True),
            *last_step(world),
            GAP,
            Line(_(_TEXTS[self.stage])),
        ]
        return Panel(blocks)

    def commands(self, app: App) -> list[Command]:
        step, over, robot = app.world.game.step, self.stage is Stage.OVER, app.world.robot
        shown = self.stage is Stage.DONE and step > 0
        unmoved = self.stage is Stage.NOT_HERE and (robot or not step)
        commands = [
            *([] if over else app.actions()),
            Command(
                [ENTER],
                _('continue with the study') if over else _('done'),
                self.menu if over else self._done if shown else None,
                '' if over else _('the button ends here'),
            ),
            Command(
                'nh',
                _('not here'),
                (lambda app: self._go_to(Stage.OVER)) if unmoved else None,
                _('the button cannot begin here; only before the first step'),
            ),
            Command(
                [BACKSPACE],
                _('discard'),
                None if over or robot else lambda app: self._go_to(self.stage),
                _('forget this and begin at a new start'),
            ),
            Command(
                'r', _('practise again'), (lambda app: self._go_to(Stage.DONE)) if over else None
            ),
            Command([ESCAPE], _('leave the practice'), None if over else self.menu),
        ]
        return with_help(commands, self.again)

    def _done(self, app: App) -> None:
        if app.world.game.step < STEPS:
            app.say(_('Not yet: the button takes three steps.'), bad=True)
        else:
            self._go_to(Stage.NOT_HERE)

    def _go_to(self, stage: Stage) -> None:
        self.stage, self._fresh = stage, False
