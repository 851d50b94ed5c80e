"""
What a screen shows of a lesson, in words and values.

Everything is computed here from the published state; a screen decides only where it stands and how
it looks. Keys are named by the labels that the screen passes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import feature_groups, FeatureGroup
from humanopts_env.game import Transition
from humanopts_learner.demonstrations import Demonstration, GOAL, METHODS
from humanopts_learner.options.conflicts import NO_START
from humanopts_learner.options.criteria import Criterion, fewest, likely_range, RETURN
from humanopts_teach.lesson.requests import LessonView, OptionStatus, Phase, World

TARGET = 1 / 3  # of the length of a bar: where a criterion begins to hold


class Tone(Enum):
    """What kind of thing a line says."""

    PLAIN = 'plain'
    QUIET = 'quiet'  # read when it is looked for
    NEWS = 'news'  # where we are now
    GOOD = 'good'
    WARNING = 'warning'
    BAD = 'bad'


@dataclass(frozen=True, slots=True)
class Line:
    """A sentence or a few words."""

    text: str
    tone: Tone = Tone.PLAIN
    strong: bool = False
    more: tuple['Line', ...] = ()  # goes on in the same line, with tones of its own


@dataclass(frozen=True, slots=True)
class FeatureShown:
    """A feature that the option depends on."""

    name: str
    value: str  # in the state that is shown; empty: no demonstration is under way


@dataclass(frozen=True, slots=True)
class CriterionShown:
    """A criterion beside what it needs."""

    mark: str
    name: str
    now: str
    needs: str
    tone: Tone
    share: float | None  # of a bar that is filled, 0 to 1; None: it is not measured


def plain(name: str) -> str:
    """Return the name of a feature as people read it."""
    return name.replace('_', ' ')


def last_step(world: World) -> Line | None:
    """Return what the last step did and its reward; None: no step was taken."""
    game = world.game
    if game is None or not game.step:
        return None
    effect = world.last_effect
    text = effect.text if effect is not None else f'last: {game.previous_action}'
    without = effect is not None and not effect.changed
    return Line(f'{text} (reward {game.reward:g})', Tone.WARNING if without else Tone.PLAIN)


def ending(world: World) -> Line | None:
    """Return how the episode ended; None: it goes on."""
    game = world.game
    if game is not None and game.terminated:
        return Line('The task is over.', Tone.NEWS)
    if game is not None and game.truncated:
        return Line('The episode is over: it is at its step limit.', Tone.WARNING)
    return None


def pace(world: World) -> Line:
    """Return how fast the machine moves."""
    if world.paused_by:
        return Line('The machine waits.', Tone.WARNING)
    return Line(f'A step every {world.step_period:g} s at least.', Tone.QUIET)


def winner(world: World) -> Line | None:
    """Return the option that took the last step; None: none did, or it is not known which."""
    game = world.game or Transition()
    option = world.acted.get((game.action_publisher_id, game.action_sequence))
    return Line(f'{option} won this step.') if option else None


def demonstration(demo: Demonstration) -> tuple[str, str]:
    """Return a demonstration in a few words, and what else there is to say."""
    steps = len(demo.actions)
    what = f'{steps} step{"s"[: steps != 1]}, return {demo.total_reward:g}'
    notes = [f'by {demo.method}', f'{demo.seconds:.0f} s']
    if demo.machine_steps:
        notes.append(f'{demo.machine_steps} by the machine')
    if demo.withdrawn:
        notes.append('DELETED')
    return f'no. {demo.number}: {what if steps else "not here"}', ', '.join(notes)


def place(world: World, lesson: LessonView) -> Line:
    """Return where the lesson stands, and how much was shown."""
    game, shown = world.game, lesson.n_demonstrations + lesson.n_not_here
    where = f'Enter shows start {shown + 1}.'
    if lesson.phase is Phase.DEMONSTRATING and game is not None:
        where = f'start {shown + 1}, step {game.step}' if game.step else f'next: start {shown + 1}'
    elif lesson.phase is Phase.LEARNING:
        where = 'learning ...'
    elif lesson.phase is Phase.FINISHED:
        where = 'This lesson is finished.'
    elif lesson.paused:
        where = 'The lesson is paused.'
    counts = f'{lesson.n_demonstrations} shown, {lesson.n_not_here} not here'
    shown_so_far = Line(f'  ({counts}; at most {lesson.budget})', Tone.QUIET)
    return Line(where, Tone.NEWS, more=(shown_so_far,))


def features(world: World, lesson: LessonView) -> list[FeatureShown]:
    """Return what the option depends on, with the values of the state that is shown."""
    domain, game = world.domain, world.game
    if domain is None:
        return []
    values: Sequence[int] = []
    if game is not None and game.state and lesson.phase is Phase.DEMONSTRATING:
        values = domain.feature_values(domain.decode(game.state)).tolist()
    return [
        FeatureShown(plain(feature.name), feature.values[values[index]] if len(values) else '')
        for index, feature in enumerate(domain.features)
        if feature.name in lesson.chosen_features
    ]


def hidden(domain: Domain[Any], lesson: LessonView) -> str:
    """Return what is not shown because the option does not depend on it; empty: nothing."""
    chosen = set(lesson.chosen_features)
    if chosen >= {feature.name for feature in domain.features}:
        return ''
    groups = feature_groups(domain)
    unseen = [group.words for group in groups if not chosen & set(group.features)]
    return f'hidden: {", ".join(unseen)}' if unseen else 'all else is hidden'


def question(
    domain: Domain[Any], lesson: LessonView, group: FeatureGroup | None = None
) -> list[Line]:
    """
    Return the open question, how many there are, and what was answered.

    :param group: that is asked about before its features.
    """
    names = [feature.name for feature in domain.features]
    number = names.index(lesson.question_feature) + 1 if lesson.question_feature in names else 0
    text, where = lesson.question, f'question {number} of {lesson.questions_total}'
    if group is not None:
        text = f"Does the '{lesson.option_name}' option depend on anything about {group.words}?"
        where = f'At yes, {len(group.features)} features of {group.words} are asked about.'
    yes = ', '.join(map(plain, lesson.chosen_features)) or 'nothing yet'
    return [Line(text, strong=True), Line(where, Tone.QUIET), Line(f'It depends on: {yes}')]


def heading(progress: OptionStatus) -> Line:
    """Return how the option is learned, and what its criteria are measured on."""
    way = 'goal' if progress.method == GOAL else 'trees'
    return Line(f'By {way}, on starts it has not seen:', Tone.QUIET)


def criteria(progress: OptionStatus) -> list[CriterionShown]:
    """Return what each criterion comes to, and what it needs."""
    return [_criterion(criterion) for criterion in progress.criteria]


def _criterion(criterion: Criterion) -> CriterionShown:
    value, threshold = criterion.value, criterion.threshold
    if criterion.name == RETURN:
        now = (
            f'{abs(value):.2f} {"worse" if value >= 0 else "better"}' if value is not None else ''
        )
        needs = f'{threshold:.2f}'
    else:
        now = f'{100 * value:.1f} % wrong' if value is not None else ''
        needs = f'{100 * threshold:.1f} %'
    return CriterionShown(
        '✓' if criterion.met else '?' if criterion.undecided else '·',
        criterion.name,
        now or 'not measured',  # shorter than the verdict: a window has 80 columns
        f'≤ {needs}',
        Tone.GOOD if criterion.met else Tone.WARNING,
        None if value is None else _share(value, threshold),
    )


def _share(value: float, threshold: float) -> float:
    """Return how far a bar is filled whose mark, at ``TARGET``, is the threshold."""
    if threshold <= 0:
        return 0.0 if value <= threshold else 1.0
    return min(max(TARGET * value / threshold, 0.0), 1.0)


def estimate(lesson: LessonView, progress: OptionStatus) -> Line:
    """Return how far it is until the criteria hold."""
    if progress.criteria_met:
        goes_on = lesson.phase in {Phase.READY, Phase.DEMONSTRATING}
        still = goes_on and set(progress.features) == set(lesson.chosen_features)
        but = ', but from some starts it still fails.' if still else '.'
        return Line(f'All criteria hold{but}', Tone.GOOD)
    if progress.n_demonstrations < (least := fewest(lesson.method)):
        return Line(f'Measured from {least} demonstrations on.')
    undecided = [c.name for c in progress.criteria if c.undecided]
    why = f': {", ".join(undecided)} is not yet known well enough' if undecided else ''
    if progress.more_needed < 0 or progress.method == GOAL:
        return Line(f'How many more it takes cannot be told yet{why}.')
    low, high = likely_range(progress.more_needed)
    return Line(f'Perhaps {low} to {high} more are needed{why}.')


def returns(progress: OptionStatus) -> Line:
    """Return the mean returns from the starts of the demonstrations."""
    yours, its = progress.mean_return_demonstrations, progress.mean_return_policy
    text = f'on starts it has seen, mean return: yours {yours:.2f}, the option {its:.2f}'
    return Line(text, Tone.QUIET)


def planned(lesson: LessonView) -> Line | None:
    """Return what the policy is where it is planned; None: it is learned."""
    if lesson.method != GOAL:
        return None
    return Line(f'policy {METHODS[GOAL]}', Tone.QUIET)


def outdated(lesson: LessonView, progress: OptionStatus) -> Line | None:
    """Return that the criteria are of an option learned otherwise; None: they are not."""
    changed = (progress.method == GOAL) != (lesson.method == GOAL)
    if changed or set(progress.features) != set(lesson.chosen_features):
        return Line('These are for the earlier answers: show one more.', Tone.WARNING)
    return None


def conflicts(progress: OptionStatus, questions_key: str) -> list[Line]:
    """
    Return a situation that was answered differently, and what to press about it.

    :param questions_key: asks the questions again; empty: not now.
    """
    if not progress.conflicts:
        return []
    more = len(progress.conflicts) - 1
    head = f'Alike, but shown differently{f" (and {more} more)" if more else ""}:'
    lines = [Line(head, Tone.WARNING), Line(progress.conflicts[0])]
    if progress.suggested_feature:
        how = f' ({questions_key})' if questions_key else ''
        text = f'Add "{plain(progress.suggested_feature)}"{how}: it tells most apart.'
        lines.append(Line(text, Tone.WARNING))
    return lines


def ends(progress: OptionStatus, again_key: str, list_key: str) -> Line | None:
    """Return what may be missing where some say that it can start here, and some not."""
    if progress.suggested_feature or not any(NO_START in text for text in progress.conflicts):
        return None  # where a feature is missing, that is why
    slip = f'If the last one was a slip, delete it ({list_key}).'
    text = f'{slip} Where an end can be a start, press {again_key} before done.'
    return Line(text, Tone.WARNING)
