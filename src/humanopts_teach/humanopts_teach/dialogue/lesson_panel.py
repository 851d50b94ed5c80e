"""The panel of a lesson screen: questions, progress, advice on what to do next."""

from collections.abc import Iterator
import math

from humanopts_env.arrays import Floats
from humanopts_env.domains.capabilities import feature_groups
from humanopts_env.domains.described import published_state
from humanopts_env.domains.formulas import feature_columns, plain_name
from humanopts_learner.demonstrations import GOAL, METHODS, TREES
from humanopts_learner.options.conflicts import SAY_AGAIN
from humanopts_learner.options.judge import likely_range, MIN_HELD_OUT
from humanopts_learner.summary import Criterion, IMITATION, OptionSummary, RETURN
from humanopts_teach.dialogue.app import App
from humanopts_teach.dialogue.driving import last_step, pace_line
from humanopts_teach.dialogue.panel import (
    Block,
    Criteria,
    CriterionRow,
    Features,
    GAP,
    Line,
    Panel,
    TARGET,
    Tone,
)
from humanopts_teach.language import _, N_, Number, translated
from humanopts_teach.lesson.requests import LessonView, Phase
import numpy as np

ADVICE = 2  # maximum number of lines of advice on features
_EXAM = N_(
    'The criteria are met. Begin a run, from a start drawn at random, and watch it. Say '
    'right if the whole run was right, or wrong as soon as it goes wrong.'
)
_EXAM_OF_ROBOT = N_(
    'The criteria are met. Run the option from here, and watch it. Say right if '
    'the whole run was right, or wrong as soon as it goes wrong: the robot stops.'
)


def question_panel(app: App) -> Panel:
    """Return the open question, its number, and the answers so far."""
    lesson = app.world.lesson
    text, asked = translated(lesson.question), lesson.question_feature
    group, said = app.groups.asked(app.domain, lesson)
    # A group counts as one question: the number grows by one after each answer.
    names = [*(feature.name for feature in app.domain.features), *lesson.derived_features]
    groups = {name: each.words for each in feature_groups(app.domain) for name in each.features}
    units = list(dict.fromkeys(groups.get(name, name) for name in names))
    number = units.index(groups.get(asked, asked)) + 1 if asked in names else 0
    which = _('question {number} of {count}').format(number=number, count=len(units))
    if group is not None:
        what, count = translated(group.words), len(group.features)
        more = _('{which}, {number} of {count} about {what}').format(
            which=which, number=group.features.index(asked) + 1, count=count, what=what
        )
        if said is None:
            text = _("Does the '{option}' option depend on anything about {what}?")
            text = text.format(option=lesson.option_name, what=what)
            more = _('{which}; if yes, {count} questions about {what} follow').format(
                which=which, count=count, what=what
            )
        which = more
    yes = ', '.join(translated(plain_name(each)) for each in lesson.chosen_features)
    lines = (
        Line(text, strong=True),
        GAP,
        Line(which, Tone.QUIET),
        Line(_('It depends on: {features}').format(features=yes or _('nothing yet'))),
    )
    return Panel((_title(lesson), GAP, *lines))


def progress_panel(app: App, *, questions: str, again: str, demonstrations: str) -> Panel:
    """
    Return the progress of the lesson and the learning results.

    :param questions: label of the key that repeats the questions; empty: currently unavailable.
    :param again: label of the key that sets whether the option can start again at its end.
    :param demonstrations: label of the key that lists the demonstrations.
    """
    world, lesson = app.world, app.world.lesson
    progress = world.summary_of(lesson.participant, lesson.option_name)
    blocks = list[Block]([_title(lesson), _position(app)])
    if lesson.phase is Phase.EXAM:
        blocks.append(Line(_(_EXAM_OF_ROBOT if world.robot else _EXAM)))
    if app.run is not None:
        blocks.append(Line(_('The machine shows what it has learned.'), Tone.NEWS))
        if not (lesson.exam and world.robot):
            blocks.append(pace_line(world))
    elif lesson.exam and _step(app):
        blocks.append(Line(_('The run has ended. Was it right?'), strong=True))
    if lesson.phase is Phase.DEMONSTRATING:
        blocks += last_step(world)
    if lesson.exam or lesson.phase is Phase.EXAM:
        return Panel([*blocks, _features(app)])
    below = list[Line]() if progress is None else [*_results(progress)]
    if progress is not None and _is_current(progress, lesson):
        advice = [*_advice(progress, questions, again)]
        blocks += advice  # at the top, since a small window hides the end
        below += _conflicts(progress, not advice, questions, demonstrations)
    elif progress is not None:
        text = _('These results are based on your earlier answers: show one more.')
        blocks.append(Line(text, Tone.WARNING))
    blocks.append(_features(app))
    if lesson.method not in ('', TREES):
        blocks.append(
            Line(_('policy: {how}').format(how=translated(METHODS[lesson.method])), Tone.QUIET)
        )
    if progress is None or not progress.criteria:
        blocks.append(Line(_('Nothing has been learned yet.')))
    else:
        blocks += [*_criteria(progress), *_estimate(lesson, progress)]
    return Panel(blocks, below)


def _title(lesson: LessonView) -> Line:
    return Line(_('Teaching: '), more=(Line(lesson.option_name, strong=True),))


def _position(app: App) -> Line:
    """Return the current position in the lesson and the number of demonstrations."""
    lesson, step = app.world.lesson, _step(app)
    start = lesson.n_demonstrations + lesson.n_not_here + 1
    if lesson.exam or lesson.phase is Phase.EXAM:
        where = _('Exam: run {number} of {count}').format(
            number=lesson.exam_runs + 1, count=lesson.exam_needed
        )
        where += _(', step {step}').format(step=step) if lesson.exam else '.'
        counts = (
            _('  ({right} of {count} right)').format(
                right=lesson.exam_right, count=lesson.exam_runs
            )
            if lesson.exam_runs
            else ''
        )
        return Line(where, Tone.NEWS, more=(Line(counts, Tone.QUIET),))
    match lesson.phase:
        case Phase.DEMONSTRATING if not _is_there(app):
            where = _('start {number} is coming ...').format(number=start)
        case Phase.DEMONSTRATING:
            where = (
                _('start {number}, step {step}').format(number=start, step=step)
                if step
                else _('next: start {number}').format(number=start)
            )
        case Phase.LEARNING:
            where = _('learning ...')
        case Phase.FINISHED:
            where = _('This lesson is finished.')
        case _:
            where = _('Enter shows start {number}.').format(number=start)
            if app.world.robot:
                where = _('Drive to start {number}; Enter begins there.').format(number=start)
            where = _('The lesson is paused.') if lesson.paused else where
    counts = _('({shown} shown, {refused} not here; at most {most})').format(
        shown=lesson.n_demonstrations, refused=lesson.n_not_here, most=lesson.budget
    )
    return Line(where, Tone.NEWS, more=(Line(f'  {counts}', Tone.QUIET),))


def _is_there(app: App) -> bool:
    """Return whether the state of the demonstration under way has arrived."""
    return app.world.game.episode == app.world.lesson.episode


def _step(app: App) -> int:
    """Return the step of the demonstration or run under way; 0: it has not begun."""
    return app.world.game.step if _is_there(app) else 0


def _features(app: App) -> Features:
    """Return the features the option depends on, with their values in the displayed state."""
    domain, game, lesson = app.domain, app.world.game, app.world.lesson
    row: Floats | None = None
    if game.state and lesson.phase is Phase.DEMONSTRATING and _is_there(app):
        row = domain.feature_values(published_state(domain, game.state, game.features))
    shown = [
        (
            translated(plain_name(column.feature.name)),
            '' if row is None else translated(column.text(row)),
        )
        for column in feature_columns(domain, lesson.chosen_features)
    ]
    groups = feature_groups(domain)
    unseen = [
        translated(g.words) for g in groups if not set(lesson.chosen_features) & set(g.features)
    ]
    hidden = (
        _('hidden: {what}').format(what=', '.join(unseen)) if unseen else _('all else is hidden')
    )
    hides = {feature.name for feature in domain.features} - {*lesson.chosen_features}
    return Features(shown, hidden if hides else '')


def _criteria(progress: OptionSummary) -> Iterator[Block]:
    """Yield the rate of success, the measured criteria, and how the runs end."""
    if not progress.settled and progress.reach:
        yield Line(translated(progress.reach), Tone.NEWS)
    if measured := [c for c in progress.criteria if c.value is not None]:
        yield Line(
            _('Tested on unseen starts ({method}):').format(method=translated(progress.method)),
            Tone.QUIET,
        )
        yield Criteria([_criterion(criterion) for criterion in measured])
    missing = [translated(c.name) for c in progress.criteria if c.value is None and not c.obstacle]
    if progress.n_demonstrations < MIN_HELD_OUT:
        words = _('Other criteria are measured once there are {count} demonstrations.').format(
            count=MIN_HELD_OUT
        )
        yield Line(words, Tone.QUIET)
    elif missing:
        yield Line(_('Not measured yet: {names}.').format(names=', '.join(missing)), Tone.QUIET)
    ends = {
        _('too early in {count}'): progress.ended_early,
        _('too late in {count}'): progress.ended_late,
        _('never in {count}'): progress.ended_never,
    }
    if found := [words.format(count=count) for words, count in ends.items() if count]:
        yield Line(
            _('Demonstrations: the option ends {how}.').format(how=', '.join(found)),
            Tone.WARNING,
        )


def _criterion(criterion: Criterion) -> CriterionRow:
    value, threshold = criterion.value or 0.0, criterion.threshold or 0.0
    side, limit, needs = _('wrong'), _('at most'), '≤'
    error, most = value, threshold
    if criterion.at_least:
        side, limit, needs = _('of {count}').format(count=criterion.count), _('at least'), '≥'
        error, most = 1 - value, 1 - threshold
    elif criterion.name == RETURN:
        side = _('better') if value < 0 else _('worse')
    now = f'{_percent(abs(value))} {side}'
    if criterion.limit not in (None, value):
        percent = round(100 * criterion.limit, 6)
        whole = np.floor(percent) if criterion.at_least else np.ceil(percent)
        now = f'{now}, {limit} {whole + 0.0:.0f} %'
    full = TARGET * error / most if most > 0 else float(error > most)
    return CriterionRow(
        '✓' if criterion.met else '?' if criterion.undecided else '·',
        translated(criterion.name),
        now,
        f'{needs} {_percent(threshold)}',
        Tone.GOOD if criterion.met else Tone.WARNING,
        min(max(full, 0.0), 1.0),
    )


def _percent(share: float) -> str:
    return f'{Number(100 * share):.3g} %'


def _estimate(lesson: LessonView, progress: OptionSummary) -> Iterator[Line]:
    """Yield whether the option is learned, or how many more demonstrations may be needed."""
    measured = progress.n_demonstrations >= MIN_HELD_OUT
    if progress.obstacles and (progress.settled or measured):
        yield Line(translated(progress.obstacles), Tone.QUIET)
    if progress.settled:
        yield Line(translated(progress.status), Tone.GOOD if progress.learned else Tone.WARNING)
    elif measured:
        undecided = [translated(c.name) for c in progress.criteria if c.undecided]
        why = (
            _(' ({names}: not yet known well enough)').format(names=', '.join(undecided))
            if undecided
            else ''
        )
        text = _('Too early to say how many more are needed{why}.').format(why=why)
        if progress.more_needed >= 0 and progress.method != GOAL:
            low, high = likely_range(progress.more_needed)
            text = _('Perhaps {low} to {high} more are needed{why}.').format(
                low=low, high=high, why=why
            )
            if low > lesson.budget - progress.n_demonstrations:
                text = _('More than the {most} of this lesson seem to be needed{why}.').format(
                    most=lesson.budget, why=why
                )
        yield Line(text)


def _results(progress: OptionSummary) -> Iterator[Line]:
    """Yield the mean returns."""
    yours, its = progress.mean_return_demonstrations, progress.mean_return_policy
    if not math.isnan(its):
        text = _(
            "mean return on starts it has seen: yours {yours:.2f}, the option's {its:.2f}"
        ).format(yours=Number(yours), its=Number(its))
        yield Line(text, Tone.QUIET)


def _is_current(progress: OptionSummary, lesson: LessonView) -> bool:
    """Return whether a summary reflects the current answers."""
    same = progress.method == lesson.method
    return same and set(progress.features) == set(lesson.chosen_features)


def _advice(progress: OptionSummary, questions: str, again: str) -> Iterator[Line]:
    """Yield advice on the chosen features."""
    advice = [text for text in progress.advice if again or text != SAY_AGAIN]
    for text in advice[:ADVICE]:
        key, words = again if text == SAY_AGAIN else questions, translated(text)
        yield Line(f'{words[:-1]} ({key}).' if key else words, Tone.WARNING)


def _conflicts(
    progress: OptionSummary, advise: bool, questions: str, demonstrations: str
) -> Iterator[Line]:
    """Yield conflicts between demonstrations, and what to do about them."""
    if progress.conflicts and len(progress.advice) < ADVICE:
        more = len(progress.conflicts) - 1
        also = _(' (and {count} more)').format(count=more) if more else ''
        yield Line(_('Same situation, shown differently{also}:').format(also=also), Tone.WARNING)
        yield Line(translated(progress.conflicts[0]))
        if advise:
            text = _('If one was a mistake, delete it ({key}).')
            if questions:
                text = _('Delete a mistake ({key}), or choose what differs ({questions}).')
            words = text.format(key=demonstrations, questions=questions)
            yield Line(words, Tone.WARNING)
    repeats = any(c.name == IMITATION and c.value == 1.0 for c in progress.criteria)
    if repeats and progress.n_questions + progress.exam_runs + progress.exams_failed:
        text = _(
            'The option may repeat a run that you judged wrong. If that was a mistake, '
            'delete the verdict'
        )
        yield Line(f'{text} ({demonstrations}).', Tone.WARNING)
