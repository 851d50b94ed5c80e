"""The screen of one option's lesson: questions, demonstrations, criteria."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from humanopts_env.domains.capabilities import FeatureGroup
from humanopts_env.domains.described import can_simulate
from humanopts_env.domains.replayed_domain import ReplayedDomain
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.rollout import is_deterministic
from humanopts_teach.dialogue.app import App, Screen
from humanopts_teach.dialogue.combine import CombineScreen
from humanopts_teach.dialogue.driving import control, pace
from humanopts_teach.dialogue.entry import confirm, end, Item, ListScreen, quitting, with_help
from humanopts_teach.dialogue.keys import (
    BACKSPACE,
    Command,
    Do,
    ENTER,
    ESCAPE,
    key_table,
    label,
    SPACE,
)
from humanopts_teach.dialogue.lesson_panel import progress_panel, question_panel
from humanopts_teach.dialogue.panel import GAP, Panel
from humanopts_teach.dialogue.question import RunQuestion
from humanopts_teach.language import _, N_, ngettext, Number, pgettext, translated
from humanopts_teach.lesson.question_groups import GroupAnswer
from humanopts_teach.lesson.requests import (
    ActionGoal,
    AddDemonstrations,
    Answer,
    AnswerQuestion,
    BeginDemonstration,
    CancelRun,
    DefineOption,
    EndDemonstration,
    LessonRequest,
    LessonView,
    ListDemonstrations,
    Phase,
    Request,
    RunOption,
    SetControl,
    Verdict,
    WithdrawDemonstration,
)

MANY_REFUSED = 5  # number of *not here* answers in a row before a comment
_REFUSED = N_(
    'You said not here {count} times in a row. If the option can begin at some of these starts, '
    'show it there; the machine learns little from not here alone.'
)
_EXPLAINED = N_(
    'Say yes if you look at this to decide whether to begin, what to do, or when you '
    'are done. Say no if it makes no difference. If you are not sure, say yes.'
)
_EXPLAINED_GROUP = N_(
    'Say yes if you look at any of this to decide whether to begin, what to do, or when you are '
    'done; a question about each then follows. Say no if none of it makes a difference.'
)
_EXPLANATIONS = {
    Phase.DEMONSTRATING: N_(
        'Do it with the keys, and press Enter when it is done. If it cannot begin at this start, '
        'say not here before the first step.'
    ),
    Phase.CHECKING: N_(
        'The board shows what the machine would do. Say yes if that is right. Say no if it is '
        'wrong; then you show what it should do.'
    ),
    Phase.EXAM: N_(
        'The machine does it alone, from several starts, and you say whether it was right. After '
        'a wrong run, you go on teaching.'
    ),
}
_PAUSES = {Phase.READY, Phase.CHECKING, Phase.EXAM, Phase.FINISHED}  # the person decides
# A list in a lesson: the board shows only features that the option depends on.
_LessonList = partial(ListScreen, hides_features=True)


@dataclass
class LessonScreen(Screen):
    """The lesson of one option; its contents depend on the lesson's phase."""

    menu: Do
    run: Callable[[str, App], None]
    automatic: Phase | None = None  # phase in which the next demonstration begins by itself
    rest: bool = False  # answer all remaining questions with no, or as before
    redo: list[str] = field(default_factory=list)  # actions to repeat after an undo
    changes: list[LessonRequest] = field(default_factory=list)  # sent once the learner is done
    counted: int = -1  # demonstrations and "not here" answers after the last change; -1: none
    refused_starts: int = 0  # number of consecutive *not here* answers
    ended: int = 0  # episode of the last run in the exam that ended here
    stops: bool = False  # the person stopped that run
    question: RunQuestion | None = None  # the open question about a run
    answers_lesson = hides_features = True

    @property
    def state(self) -> str:
        return self.question.state if self.question is not None else ''

    def plays(self, app: App) -> bool:
        lesson = app.world.lesson
        examines = lesson.exam or self.automatic is Phase.EXAM
        playing = {Phase.DEMONSTRATING, Phase.LEARNING}
        if app.world.robot:  # the person drives it to each start
            playing |= {Phase.READY, Phase.EXAM, Phase.FINISHED}
        return lesson.phase in playing and not examines

    def panel(self, app: App) -> Panel:
        phase, question = app.world.lesson.phase, self._run_question(app)
        if phase is Phase.ASKING:
            return question_panel(app)
        if question is not None:
            return question.panel(app)

        def key(do: Do, phase: Phase) -> str:
            table = key_table(self._commands(phase, app)).items()
            for name, each in table:
                if each.do == do:  # with its words, since pages on phones do not show keys
                    return f'{label(name)} {each.words.partition(":")[0]}'
            return ''

        return progress_panel(
            app,
            questions=key(self._ask_again, phase),
            again='' if _can_start_again(app) else key(self._toggle_start, Phase.DEMONSTRATING),
            demonstrations=key(self._list, Phase.DEMONSTRATING),
        )

    def explain(self, app: App) -> str:
        lesson = app.world.lesson
        if lesson.phase is Phase.ASKING:
            return _EXPLAINED_GROUP if app.groups.open_group(app.domain, lesson) else _EXPLAINED
        return _EXPLANATIONS.get(lesson.phase, '')

    def press(self, key: str, app: App) -> None:
        self.rest = False
        if not self.redo:
            super().press(key, app)

    def commands(self, app: App) -> Sequence[Command]:
        lesson = app.world.lesson
        own = lesson.exam or lesson.phase in (Phase.ASKING, Phase.CHECKING, Phase.EXAM)
        helped = lesson.phase if own else Phase.DEMONSTRATING
        commands, explained = self._commands(lesson.phase, app), self._commands(helped, app)
        return with_help(commands, self.again, explained)

    def _commands(self, phase: Phase, app: App) -> list[Command]:
        """Return the commands of a phase."""
        lesson, robot = app.world.lesson, app.world.robot
        start = _('where the robot is') if robot else _('a start of the task')
        listed = Command(
            'lb',
            _('demonstrations'),
            self._list,
            _('list all demonstrations and verdicts; view or delete any'),
        )
        watch = Command(
            'wv',
            _('run it and correct') if robot else _('watch and correct'),
            self._watch_new if lesson.n_demonstrations else None,
            _('watch the option from {start}; an action key takes over').format(start=start),
        )
        learned = [watch, listed]
        questions = Command(
            'ek',
            _('questions'),
            self._ask_again,
            _('say again what the option depends on; Enter keeps an answer'),
        )
        begin = Command([ENTER], _('begin here') if robot else _('begin'), self._begin)
        more = Command(
            'm', _('show one more'), self._begin, _('show the option once more instead')
        )
        commands, question = [*pace(app), *control(app)], self._run_question(app)
        if robot and phase in (Phase.READY, Phase.EXAM, Phase.FINISHED):
            commands = [*app.actions(), *commands]  # the person drives to the next start
        match phase:
            case Phase.DEMONSTRATING if lesson.exam:
                commands = [*self._verdicts(app), *commands]
            case Phase.EXAM:
                begin = Command([ENTER], _('begin the run'), self._examine)
                commands += [begin, self._previous(app), more, listed, questions]
            case Phase.CHECKING if question is not None:
                commands += [*self._answers(app), self._previous(app), *question.commands()]
                commands += [more, listed, questions]
            case Phase.DEMONSTRATING:
                again = _('YES') if _can_start_again(app) else _('no')
                domain = app.domain
                can_repeat = isinstance(domain, ReplayedDomain) or is_deterministic(domain)
                commands = [
                    *(*app.actions(), *commands),
                    Command(
                        [ENTER],
                        _('done'),
                        partial(self._end, Verdict.DONE),
                        _('the option ends here: keep this demonstration'),
                    ),
                    Command(
                        'sa',
                        _('can start again at its end: {again}').format(again=again),
                        self._toggle_start,
                        _('before done: set whether the option could start again where it ended'),
                    ),
                    Command(
                        'nh',
                        _('not here'),
                        partial(self._end, Verdict.NOT_HERE),
                        _('the option cannot start here; only before the first step'),
                    ),
                    Command(
                        [BACKSPACE],
                        _('discard'),
                        self._discard,
                        _('forget this demonstration')
                        if robot
                        else _('forget this demonstration and try the same start again'),
                    ),
                    Command(
                        'uz',
                        _('undo a step'),
                        self._undo if can_repeat else None,
                        _('undo your last step: a new episode repeats the steps before it'),
                    ),
                    *(*learned, questions),
                ]
            case Phase.ASKING:
                combine = Command(
                    'c',
                    _('combine features'),
                    lambda app: app.show(CombineScreen(self.again)),
                    _('make a new feature from existing ones, such as their difference'),
                )
                commands += [*self._answers(app), self._previous(app), combine]
            case Phase.READY:
                space = Command([SPACE], _('begin'), self._begin, label='')
                commands += [
                    begin,
                    *([] if robot else [space]),
                    *learned,
                    self._previous(app),
                    questions,
                ]
            case Phase.FINISHED:
                run = Command('rg', _('run it'), partial(self.run, lesson.option_name))
                to_next = Command([ENTER], _('menu, next option'), self.menu)
                commands += [to_next, more, run, *learned, self._previous(app), questions]
        return [
            *commands,
            Command(
                [ESCAPE],
                _('menu'),
                partial(self._leave, _('Go to the menu'), self.menu),
                _('go to the menu; a demonstration under way is discarded'),
            ),
            *(replace(each, do=partial(self._leave, _('Quit'), end)) for each in quitting(app)),
        ]

    def _answers(self, app: App) -> list[Command]:
        """Return the answers to the open question about one feature or a group of features."""
        lesson, group = app.world.lesson, app.groups.open_group(app.domain, app.world.lesson)
        earlier = set(lesson.earlier_features)

        def answer(yes: bool) -> Do:
            return lambda app: app.ask(
                AnswerQuestion(lesson.question_id, yes), then=partial(self._answered, app)
            )

        def say(group: FeatureGroup, said: GroupAnswer) -> Do:
            return lambda app: app.groups.answer(group, said)

        if group is None:
            asked = {lesson.question_feature}
            yes, no, before = answer(True), answer(False), answer(bool(asked & earlier))
        else:
            asked = set(group.features)
            yes, no = say(group, GroupAnswer.EACH), say(group, GroupAnswer.NONE)
            before = say(group, GroupAnswer.AS_BEFORE)
        answers = [
            Command('y', _('yes'), yes),
            Command('n', _('no') if group is None else _('no, to all of them'), no),
        ]
        if lesson.phase is Phase.CHECKING:
            return answers
        if earlier:
            words = _('as before: {answer}').format(
                answer=_('yes') if asked & earlier else _('no')
            )
            answers.append(Command([ENTER], words, before))
        if _can_skip(lesson) and not _is_derived(lesson):
            words = _('all others as before') if earlier else _('no to all others')
            answers.append(Command('o', words, self._skip))
        return answers

    def _answered(self, app: App, answer: Answer) -> None:
        if not answer.ok:  # the questions restart
            self.rest = False
            app.groups.forget()

    def _skip(self, app: App) -> None:
        self.rest = True

    def _previous(self, app: App) -> Command:
        """Return the command that goes back by one question or one group of features."""
        lesson = app.world.lesson
        group, said = app.groups.asked(app.domain, lesson)
        back = AnswerQuestion(lesson.question_id, back=True)

        def went_back(answer: Answer) -> None:
            group, said = app.groups.asked(app.domain, app.world.lesson)
            if group is not None and said is not GroupAnswer.EACH:
                app.groups.withdraw(group)
                if app.world.lesson.question_feature != group.features[0]:
                    again = AnswerQuestion(app.world.lesson.question_id, back=True)
                    app.ask(again, then=went_back)

        def go_back(app: App) -> None:
            if group is not None and said and lesson.question_feature == group.features[0]:
                app.groups.withdraw(group)
            else:
                app.ask(back, then=went_back)

        first = lesson.question_feature == app.domain.features[0].name
        possible = lesson.phase is not Phase.ASKING or not first or said is not None
        asks = lesson.phase in (Phase.ASKING, Phase.READY)
        words = (
            _('previous question')
            if lesson.phase is Phase.ASKING
            else _('take back the last answer')
        )
        possible &= asks or lesson.n_questions + lesson.exam_runs > 0
        return Command([BACKSPACE], words, go_back if possible else None)

    def _run_question(self, app: App) -> RunQuestion | None:
        """Return the open question about a run; None: none is open."""
        lesson, known = app.world.lesson, self.question
        if lesson.phase is not Phase.CHECKING:
            self.question = None
        elif known is None or known.lesson.question_id != lesson.question_id:
            self.question = RunQuestion(lesson)
        return self.question

    def tick(self, app: App) -> None:
        """Begin the next demonstration, or answer a question without asking the person."""
        lesson = app.world.lesson
        if (question := self._run_question(app)) is not None:
            question.tick(app.now)
        if lesson.phase in _PAUSES and lesson.phase is not self.automatic:
            self.automatic = None
        if self.redo:
            if lesson.phase is Phase.DEMONSTRATING:
                app.drive(self.redo.pop(0))
        elif self.changes and lesson.phase is not Phase.DEMONSTRATING:
            count = lesson.n_demonstrations + lesson.n_not_here
            if lesson.phase is not Phase.LEARNING and self.counted in (-1, count):
                change = self.changes.pop(0)
                self.counted = count + (1 if isinstance(change, AddDemonstrations) else -1)
                again = any(isinstance(each, AddDemonstrations) for each in self.changes)
                app.ask(change, then=partial(_say_changed, app) if again else None)
        elif lesson.phase is Phase.ASKING:
            reply = app.groups.reply(app.domain, lesson)
            if self.rest and _can_skip(lesson) and not _is_derived(lesson):
                reply = lesson.question_feature in lesson.earlier_features
            if reply is not None:
                answer = AnswerQuestion(lesson.question_id, reply)
                app.ask(answer, then=partial(self._answered, app))
        elif self.automatic is Phase.EXAM is lesson.phase:
            self._examine(app)
        elif self.automatic is lesson.phase:
            self._begin(app)

    def refused(self, app: App) -> None:
        """Stop all automatic actions."""
        self.automatic, self.rest, self.redo, self.changes = None, False, [], []
        if app.world.lesson.phase is Phase.ASKING:
            app.groups.forget()

    def _begin(self, app: App) -> None:
        app.ask(BeginDemonstration(app.next_start))
        self.automatic, app.next_start = None, ''

    def _examine(self, app: App) -> None:
        """Begin a run of the exam."""
        self.automatic = None
        app.ask(BeginDemonstration(exam=True), *_run(app))

    def _verdicts(self, app: App) -> list[Command]:
        """Return the commands that judge the exam run, which can be stopped at any time."""
        game, robot, idle = app.world.game, app.world.robot, app.run is None
        begun = game.step > 0 and game.episode == app.world.lesson.episode
        ended = idle and self.ended == app.world.lesson.episode

        def judge(verdict: Verdict, then: Phase | None) -> Do:
            return partial(self._judge, verdict, then)

        return [
            Command(
                'r',
                pgettext('verdict', 'right'),
                judge(Verdict.RIGHT, Phase.EXAM) if ended and begun else None,
                _('the option did what it should') + ('' if robot else _('; the next run begins')),
            ),
            Command(
                'w',
                _('wrong'),
                judge(Verdict.WRONG, None) if begun or ended or (robot and not idle) else None,
                _('stop the run; next you show what the option should do there'),
            ),
            Command(
                [ENTER],
                _('begin the run'),
                (lambda app: app.ask(*_run(app))) if idle and not begun else None,
            ),
            Command(
                [BACKSPACE],
                _('does not count') if robot else _('watch it again'),
                judge(Verdict.DISCARD, Phase.EXAM) if idle and begun else None,
                _('this run does not count')
                + ('' if robot else _('; it is repeated from its start')),
            ),
        ]

    def _judge(self, verdict: Verdict, then: Phase | None, app: App) -> None:
        """Give a verdict on the run of the exam, and stop the run."""
        game, runs = app.world.game, app.run is not None
        self.stops |= runs
        if runs and app.world.robot:
            app.stop()  # the verdict follows when the run has ended, with its last state
            return

        def judged(answer: Answer) -> None:
            self._go_on(then, app)

        end = EndDemonstration(verdict, game.episode, game.step, stopped=self.stops)
        app.ask(*([CancelRun()] if runs else []), end, then=judged)
        app.resume_machine()

    def _go_on(self, phase: Phase | None, app: App) -> None:
        """Begin automatically in a phase, except with a robot or while the lesson is paused."""
        self.automatic = None if app.world.lesson.paused or app.world.robot else phase

    def run_ended(self, run: ActionGoal, well: bool, app: App) -> None:
        lesson = app.world.lesson
        self.ended = lesson.episode
        watched = lesson.phase is Phase.DEMONSTRATING and not lesson.exam
        if app.world.robot and watched and well and not app.world.in_control:
            self._verdict(Verdict.DISCARD, app)  # neither it nor later driving is kept
        if self.stops:
            app.message = GAP  # the lesson says what comes next
            if app.world.robot:
                self._judge(Verdict.WRONG, None, app)
            self.stops = False

    def _end(self, verdict: Verdict, app: App) -> None:
        """Give a verdict; ask for confirmation if the last step had no effect."""
        effect = app.world.last_effect
        if app.run is not None:
            app.ask(SetControl(hold=True))
            app.say(_('The machine has stopped. Look at the board, then press the key again.'))
        elif verdict is not Verdict.DONE:
            self._verdict(verdict, app)
        elif effect is None or effect.changed:
            self._count(app)
        else:
            question = _('The last step had no effect ({text}). Does the option end here?').format(
                text=translated(effect.text)
            )
            app.show(confirm(question, self._count, self.again))

    def _count(self, app: App) -> None:
        """Keep the demonstration; ask whether the machine's leading steps belong to it."""
        steps = app.world.lesson.machine_steps
        if not steps or (app.world.robot and app.world.game.step > steps):
            self._verdict(Verdict.DONE, app)
            return

        def keep(app: App, *, counts: bool) -> None:
            app.show(self)
            self._verdict(Verdict.DONE, app, counts=counts)

        items = [Item(_('Yes'), _('all of them are right'), partial(keep, counts=True))]
        if app.world.game.step > steps:
            items.append(
                Item(_('No'), _('it begins where I took over'), partial(keep, counts=False))
            )
        title = ngettext(
            'The machine took the first step. Is it part of the demonstration?',
            'The machine took the first {count} steps. Are they part of the demonstration?',
            steps,
        )
        app.show(_LessonList(title.format(count=steps), items, self.again))

    def _verdict(self, verdict: Verdict, app: App, *, counts: bool = False) -> None:
        game, again = app.world.game, _can_start_again(app) and verdict is Verdict.DONE
        request = EndDemonstration(verdict, game.episode, game.step, again, counts)
        if verdict is not Verdict.DISCARD:
            self.refused_starts = self.refused_starts + 1 if verdict is Verdict.NOT_HERE else 0
        app.ask(request, then=partial(self._ended, app))

    def _ended(self, app: App, answer: Answer) -> None:
        """Continue with the next start; let the person resolve a contradiction first."""
        self._go_on(Phase.READY, app)
        if self.refused_starts and self.refused_starts % MANY_REFUSED == 0:
            app.say(_(_REFUSED).format(count=self.refused_starts))
        if answer.contradiction:
            items = [
                Item(text, note, partial(self._delete, deleted), (answer.situation,))
                for text, note, deleted in (
                    (_('Keep both'), '', ''),
                    (_('Keep the new one'), _('the earlier one is deleted'), answer.contradicts),
                    (_('Keep the earlier one'), _('the new one is deleted'), answer.uuid),
                )
            ]
            title = _('You showed something else before. {contradiction}.').format(
                contradiction=translated(answer.contradiction)
            )
            app.show(_LessonList(title, items))

    def _discard(self, app: App) -> None:
        """Discard the current demonstration, if there is one."""
        if app.run is not None:
            app.ask(SetControl(hold=True))
        if app.world.lesson.phase is Phase.DEMONSTRATING:
            self._verdict(Verdict.DISCARD, app)

    def _undo(self, app: App) -> None:
        """Start a new episode and repeat all of the person's steps except the last."""
        lesson, since, driven = app.world.lesson, app.world.since, app.world.driven
        if since is None or since.step != lesson.machine_steps or not driven:
            app.say(_('You have not taken a step to undo.'), bad=True)
        elif lesson.paused:
            app.say(_('Not now: the lesson is paused, so no demonstration can begin.'), bad=True)
        else:
            self.redo = [step.previous_action for step in driven[:-1]]
            self._discard(app)
            app.ask(BeginDemonstration(since.state))

    def _toggle_start(self, app: App) -> None:
        again = app.can_start_again[app.world.lesson.option_name] = not _can_start_again(app)
        if again and app.world.lesson.n_demonstrations:
            app.ask(ListDemonstrations(), then=partial(self._start_again_too, app))

    def _start_again_too(self, app: App, answer: Answer) -> None:
        """Ask whether the option can start again at the end of earlier demonstrations, too."""
        shown = [
            demo
            for demo in answer.demonstrations
            if demo.kind is Kind.TRAJECTORY
            and not (demo.can_start_at_end or demo.withdrawn or demo.terminated)
        ]

        def change(app: App) -> None:
            for demo in shown:
                again = replace(demo, can_start_at_end=True)
                self.changes += [WithdrawDemonstration(demo.uuid), AddDemonstrations((again,))]
            self.counted = -1
            app.show(self)

        if shown:
            items = [
                Item(_('Yes'), _('they will be changed'), change),
                Item(_('No'), _('only from now on'), self.again),
            ]
            title = ngettext(
                'Could it also start again where your {count} earlier demonstration ended?',
                'Could it also start again where your {count} earlier demonstrations ended?',
                len(shown),
            )
            app.show(_LessonList(title.format(count=len(shown)), items))

    def _watch_new(self, app: App) -> None:
        """Watch the option from a random start; without rules, from the current state."""
        episode, start = app.world.game.episode, ''
        if can_simulate(app.domain):
            rng = generator(app.seed, 'watched start', app.participant, episode)
            start = app.domain.encode(app.domain.reset(rng))
        self._watch(start, app)

    def _watch(self, start: str, app: App) -> None:
        """Run the option in a new demonstration; the person can take over."""

        def watch(app: App) -> None:
            app.ask(BeginDemonstration(start, watch=True), *_run(app))

        app.show(self)
        self._leave(_('Watch the option'), watch, app)

    def _list(self, app: App) -> None:
        def answered(answer: Answer) -> None:
            self._show_demonstrations(answer.demonstrations, app)

        app.ask(ListDemonstrations(), then=answered)

    def _show_demonstrations(self, shown: Sequence[Demonstration], app: App) -> None:
        if not shown:
            app.say(_('There are no demonstrations yet.'))
            return
        back = partial(self._show_demonstrations, shown)
        items = [
            Item(*_in_words(demo), partial(self._show_one, demo, back), demo.states)
            for demo in reversed(shown)
        ]
        app.show(_LessonList(_('Demonstrations, newest first'), items, self.again))

    def _show_one(self, demo: Demonstration, back: Do, app: App) -> None:
        watch, states = partial(self._watch, demo.states[0]), demo.states
        items = [Item(_('Watch the option from its start'), _('and correct it'), watch, states)]
        if not demo.withdrawn:
            note = _('it no longer counts, and its start will come up again')
            if demo.kind is Kind.JUDGED:
                note = _('this verdict no longer counts')
            items.append(Item(_('Delete it'), note, partial(self._delete, demo.uuid), states))
        app.show(_LessonList(' '.join(_in_words(demo)), items, back))

    def _delete(self, uuid: str, app: App) -> None:
        """Return to the lesson, and withdraw a demonstration when possible (empty uuid: none)."""
        if uuid:
            self._discard(app)
            self.changes, self.counted = [WithdrawDemonstration(uuid)], -1
        app.show(self)

    def _leave(self, words: str, go: Do, app: App) -> None:
        """Discard the current demonstration and leave; ask first if steps were taken."""
        if app.world.lesson.phase is not Phase.DEMONSTRATING:
            go(app)
            return

        def discard(app: App) -> None:
            self._discard(app)
            go(app)

        if app.world.game.step:
            what = (
                _('This run does not count; everything else is saved.')
                if app.world.lesson.exam
                else _('This demonstration is discarded; everything else is saved.')
            )
            app.show(confirm(f'{words}? {what}', discard, self.again))
        else:
            discard(app)

    def _ask_again(self, app: App) -> None:
        def ask(app: App) -> None:
            app.groups.forget()
            app.ask(DefineOption(app.world.lesson.option_name, ask_again=True))

        self._leave(_('Answer the questions again'), ask, app)


def _in_words(demo: Demonstration) -> tuple[str, str]:
    """Return a short description of a demonstration, and further details."""
    steps = len(demo.actions)
    what = ngettext('{count} step, return {reward:g}', '{count} steps, return {reward:g}', steps)
    what = what.format(count=steps, reward=Number(demo.total_reward))
    notes = [_('by {method}').format(method=translated(demo.method)), f'{demo.seconds:.0f} s']
    text = _('no. {number}: {what}').format(
        number=demo.number, what=what if steps else _('not here')
    )
    if demo.kind is Kind.JUDGED:
        text = _('run {number}, judged {verdict}: {what}').format(
            number=demo.number,
            verdict=pgettext('verdict', 'right') if demo.right else _('wrong'),
            what=what if steps else _('it would not start'),
        )
        notes = [_('in an exam') if demo.exam else _('in a question')]
    elif demo.machine_steps:
        notes.append(_('{count} by the machine').format(count=demo.machine_steps))
    return text, ', '.join([*notes, *([_('DELETED')] if demo.withdrawn else [])])


def _say_changed(app: App, answer: Answer) -> None:
    app.say(_('Earlier demonstrations have been changed: it can start again at their ends.'))


def _run(app: App) -> list[Request]:
    """Return the requests that run the option of the lesson."""
    return [*app.release(), RunOption(app.world.lesson.option_name, app.participant)]


def _can_skip(lesson: LessonView) -> bool:
    return bool(lesson.chosen_features or lesson.earlier_features)


def _is_derived(lesson: LessonView) -> bool:
    """Return whether the question is about a derived feature, which is always asked about."""
    return lesson.question_feature in lesson.derived_features


def _can_start_again(app: App) -> bool:
    """Return whether the next 'done' marks its end state as a possible start of the option."""
    return app.can_start_again.get(app.world.lesson.option_name, False)
