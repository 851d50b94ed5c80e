"""
Check whether options that a lesson calls learned are right.

This goes beyond the paper. In a trial, a simulated teacher gives one lesson, and then the learned
option runs from starts that the lesson did not choose (``right.py``). The teacher is careful, errs
in a share of its steps, answers yes to needless features or no to a needed one, or has a behaviour
in mind that no option can express.

In a *learnable* row of the table, demonstrations and answers determine the option, and at least
``SHARE`` of the options called learned have to be right. In the other rows, at most ``FALSE`` of
all lessons may call a wrong option learned.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
import math
from typing import Any

from humanopts_env.arrays import Flags
from humanopts_env.domains.base import Domain, EnumerableDomain
from humanopts_env.domains.gymnasium_reference import WatchedOption
from humanopts_env.domains.reference import ReferenceOption, TabularReferenceOption
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.domains.replayed_domain import ReplayedDomain
from humanopts_env.domains.tabular import best_paths, distance_to, reachable
from humanopts_env.domains.taxi import ABOARD, landmark_cells, Taxi, TaxiState
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import GOAL, METHODS, TREES
from humanopts_learner.intervals import Interval
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.requests import (
    AnswerQuestion,
    BeginDemonstration,
    Drive,
    EndDemonstration,
    RunOption,
)
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.simulated_teacher import TeacherSettings
from humanopts_teach.report.figures import Drawing
import numpy as np
import pandas as pd

from experiments import report
from experiments.people import Study
from experiments.right import Meant, meant, SHARE
from experiments.trials import Rows, Trial

NAME = 'judging'
TITLE = 'Whether what a lesson calls learned is right'
LESSONS = 6
FALSE = 0.05
SLOW = 1 / 3  # share of the lessons given in slow rows
BUDGET = 40  # start states per option
ATTEMPTS = 100  # per start; many, since some teachers err in most of their steps
REPLAYED = 10  # the same in a replayed domain, which is slow; 1 without errors
KEYS = ['world', 'method', 'taught by']
KEYED = AnswerQuestion, BeginDemonstration, Drive, EndDemonstration, RunOption  # one key each
COSTS = ['demonstrations', 'not here', 'questions', 'exam answers', 'keys']


# Options with an end that depends on the start.


@dataclass(frozen=True, eq=False)
class Relative:
    """A reference option with one end state for each start, in a deterministic domain."""

    domain: EnumerableDomain
    name: str
    features: tuple[str, ...]
    definition: str
    end: tuple[int, ...]  # (S,) end state of a run from each state; -1: it cannot start

    def begun(self, state: Any) -> TabularReferenceOption:
        """Return the option of shortest paths to the end of a run from a state."""
        return _paths_to(self, self.end[self.domain.index(state)])

    def can_start(self, state: Any) -> bool:
        """Return whether a run from a state has an end."""
        return self.end[self.domain.index(state)] >= 0

    def ends(self, state: Any) -> bool:
        """Return False: the end depends on the start."""
        return False

    def optimal_actions(self, state: Any) -> tuple[int, ...]:
        """Return the optimal first actions of a run from a state."""
        return self.begun(state).optimal_actions(state)


@cache
def _paths_to(option: Relative, end: int) -> TabularReferenceOption:
    domain = option.domain
    goal = np.arange(domain.n_states) == end
    table, going = domain.transitions(), ~domain.over() & ~goal
    distance, optimal = distance_to(table, goal[table.successor[:, :, 0]], going)
    return TabularReferenceOption(
        domain,
        option.name,
        option.features,
        np.array(option.end) >= 0,
        goal,
        optimal,
        distance,
        reachable(domain),
        option.definition,
    )


def _relative(
    domain: Taxi,
    name: str,
    definition: str,
    features: tuple[str, ...],
    end: Callable[[TaxiState], TaxiState | None],
) -> dict[str, ReferenceOption]:
    open_states, ends = reachable(domain) & ~domain.over(), []
    for number in range(domain.n_states):
        found = end(domain.state_at(number)) if open_states[number] else None
        ends.append(-1 if found is None else domain.index(found))
    return {name: Relative(domain, name, features, definition, tuple(ends))}


TAXI = 'taxi_row', 'taxi_col'
PASSENGER = 'passenger_row', 'passenger_col', 'passenger_in_taxi'


def next_thing(domain: Taxi) -> dict[str, ReferenceOption]:
    """Return an option with two kinds of ends."""
    cells = [*landmark_cells(domain.rows, domain.cols).values()]

    def end(state: TaxiState) -> TaxiState:
        if state.passenger == ABOARD:
            there = cells[state.destination]
            return TaxiState(*there, state.destination, state.destination)
        return TaxiState(*cells[state.passenger], ABOARD, state.destination)

    return _relative(
        domain,
        'do the next thing',
        'Starts anywhere; picks the passenger up, or delivers one who is aboard; ends then.',
        (*TAXI, *PASSENGER, 'destination_row', 'destination_col'),
        end,
    )


def two_cells_north(domain: Taxi) -> dict[str, ReferenceOption]:
    """Return an option with an end relative to its start."""

    def end(state: TaxiState) -> TaxiState | None:
        return replace(state, row=state.row - 2) if state.row >= 2 else None

    definition = 'Starts in the third row or farther south; ends two cells farther north.'
    return _relative(domain, 'two cells north', definition, TAXI, end)


def fetch(domain: Taxi) -> dict[str, ReferenceOption]:
    """Return an option with an end that depends on history: it returns to its start."""

    def end(state: TaxiState) -> TaxiState | None:
        return None if state.passenger == ABOARD else replace(state, passenger=ABOARD)

    return _relative(
        domain,
        'fetch the passenger',
        'Starts where the passenger waits; picks up; ends with the passenger aboard where it '
        'began.',
        (*TAXI, *PASSENGER),
        end,
    )


class OnIce(TabularReferenceOption):
    """A reference option on ice: next to the goal, the best action may be one that slips there."""

    @property
    def goal(self) -> Flags:
        return self.termination


def to_the_goal(domain: EnumerableDomain) -> dict[str, ReferenceOption]:
    """Return the option of FrozenLake: the best paths to the goal, around the holes."""
    table, over = domain.transitions(), domain.over()
    goal = np.zeros(domain.n_states, dtype=np.bool_)
    goal[table.successor[table.reward > 0]] = True
    value, optimal = best_paths(table, goal[table.successor], ~over, domain.gamma)
    starts = reachable(domain) & ~over & (value > 0)
    option = OnIce(
        domain,
        'walk to the goal',
        tuple(feature.name for feature in domain.features),
        starts,
        goal,
        optimal & starts[:, None],
        np.where(starts, 1, -1).astype(np.int32),
        starts | goal,
        'Starts anywhere; walks to the goal by the best paths around the holes; ends there.',
    )
    return {option.name: option}


# Rows of the table.


@dataclass(frozen=True)
class World:
    """A domain of the table."""

    domain: str
    options: tuple[str, ...] = ()  # taught in turn; empty: all options
    together: bool = False  # a lesson teaches all options: one leads to the starts of another
    methods: tuple[str, ...] = (TREES,)
    answers: bool = True  # whether the domain has needless features
    slow: bool = False  # whether to give only a third of the lessons
    too_few: tuple[str, ...] = ()  # teachers for whom BUDGET start states are too few
    references: Callable[[Any], dict[str, ReferenceOption]] = reference_options
    cost: float = 3.0  # approximate processor seconds per lesson
    least: int = 1  # minimum number of participants for this domain


WORLDS = {
    'Taxi': World('taxi', methods=(TREES, GOAL)),
    'Rooms': World('rooms', methods=(TREES, GOAL), answers=False),
    'FrozenLake 4x4': World(
        'gymnasium:FrozenLake-v1',
        methods=(TREES, GOAL),
        answers=False,
        references=to_the_goal,
    ),
    'FrozenLake 8x8': World(
        'gymnasium:FrozenLake8x8-v1',
        methods=(TREES, GOAL),
        answers=False,
        slow=True,
        references=to_the_goal,
        cost=25.0,
    ),
    'Pac-Man': World(
        'pacman',
        (
            'go to the closest food',
            'avoid ghost',
            'go to the nearest power pellet',
            'eat the ghost',
        ),
        slow=True,
        too_few=('10 % slips', 'yes to 20 % needless features', 'yes to all features'),
        cost=20.0,
    ),
    'DoorKey': World('gymnasium:MiniGrid-DoorKey-8x8-v0', together=True, slow=True, cost=15.0),
    'LunarLander': World(
        'gymnasium:LunarLander-v3', slow=True, too_few=('10 % slips',), cost=60.0, least=20
    ),
}


@dataclass(frozen=True)
class Teacher:
    """A kind of teacher."""

    error_rate: float = 0.0
    needless: float = 0.0  # share of needless features answered with yes
    missing: bool = False  # whether one needed feature is answered with no
    learnable: tuple[str, ...] = (*METHODS,)  # methods by which lessons determine the option
    reason: str = ''  # why lessons with other methods do not
    meaning: Callable[[Any], dict[str, ReferenceOption]] | None = None  # own options (only Taxi)

    def fits(self, world: World) -> bool:
        """Return whether this teacher gives lessons in a world."""
        if self.meaning is not None:
            return world.domain == 'taxi'
        return world.answers or not self.needless


CAREFUL = 'careful'
TEACHERS = {
    CAREFUL: Teacher(),
    '10 % slips': Teacher(error_rate=0.1),
    '60 % slips': Teacher(error_rate=0.6, learnable=(), reason='most steps are wrong'),
    'yes to 20 % needless features': Teacher(needless=0.2),
    'yes to all features': Teacher(needless=1.0),
    'no to a needed feature': Teacher(
        missing=True, learnable=(), reason='the chosen features may not tell what matters'
    ),
    'two kinds of ends': Teacher(
        meaning=next_thing,
        learnable=(GOAL,),
        reason='demonstrations of one kind pass states that look like ends of the other',
    ),
    'two cells north': Teacher(
        meaning=two_cells_north, learnable=(), reason='no set of states is the end'
    ),
    'end by history': Teacher(meaning=fetch, learnable=(), reason='no set of states is the end'),
}


def trials(study: Study) -> list[Trial]:
    """Return one trial per lesson; none if the study uses bags."""
    lessons = 0 if study.bags else study.participants
    return [
        Trial(
            NAME,
            {**dict(zip(KEYS, row)), 'lesson': lesson, 'seed': study.seed},
            give_lesson,
            WORLDS[row[0]].cost,
        )
        for row in table_rows()
        if lessons >= WORLDS[row[0]].least
        for lesson in range(1, math.ceil(lessons * share_of(row[0], row[2])) + 1)
    ]


def share_of(world: str, kind: str) -> float:
    """Return the share of lessons in a row: ``SLOW`` if slow, unlearnable or with own options."""
    teacher = TEACHERS[kind]
    slow = WORLDS[world].slow or not teacher.learnable or teacher.meaning is not None
    return SLOW if slow else 1.0


def table_rows() -> Iterator[tuple[str, str, str]]:
    """Yield world, method and teacher of each row of the table."""
    for name, world in WORLDS.items():
        for method in world.methods:
            for kind, teacher in TEACHERS.items():
                if teacher.fits(world):
                    yield name, method, kind


def obstacle(world: str, method: str, kind: str) -> str:
    """Return the reason why lessons of a row do not determine the option; empty if they do."""
    if method not in TEACHERS[kind].learnable:
        return TEACHERS[kind].reason
    too_few = kind in WORLDS[world].too_few
    return too_few * f'{BUDGET} start states are too few for trees'


@cache
def _world(name: str) -> Domain:
    """Return the domain of a world."""
    return make_domain(WORLDS[name].domain)


@cache
def _references(world: str, kind: str) -> dict[str, ReferenceOption]:
    """Return the options of a world as a kind of teacher means them, in order of teaching."""
    if meaning := TEACHERS[kind].meaning:
        return meaning(_world(world))
    found = WORLDS[world].references(_world(world))
    return {name: found[name] for name in WORLDS[world].options or found}


@lru_cache(maxsize=32)
def _meant(world: str, kind: str, option: str, seed: int) -> Meant:
    """Return an option as the teacher means it."""
    return meant(_world(world), _references(world, kind), option, seed)


def answering(
    option: ReferenceOption, domain: Domain, teacher: Teacher, rng: np.random.Generator
) -> ReferenceOption:
    """Return an option with the features that the teacher chooses for it."""
    features = option.features
    if teacher.needless == 1.0:
        known = [feature.name for feature in domain.features]
        features = (*known, *(name for name in features if name not in known))
    if teacher.missing and len(features) > 1:
        features = tuple(np.delete(features, rng.integers(len(features))).tolist())
    if features == option.features:
        return option
    changed: Any = option
    if isinstance(option, WatchedOption):
        return replace(option, rule=replace(option.rule, features=features))
    return replace(changed, features=features)  # type: ignore[no-any-return]


def give_lesson(parameters: Mapping[str, Any]) -> Rows:
    """
    Give one lesson, and run the options that it has taught.

    :return: one row per option: learned (according to the lesson), right, right starts (share),
        elsewhere (share of other states in which the option can start), faults (share of starts
        with each), ``COSTS``, and the status in words.
    """
    world, method, kind = (parameters[key] for key in KEYS)
    lesson, teacher, domain = parameters['lesson'], TEACHERS[kind], _world(world)
    seed = int(generator(parameters['seed'], NAME, world, method, kind, lesson).integers(2**31))
    references = _references(world, kind)
    names = [*references]
    if not WORLDS[world].together:
        names = [names[lesson % len(names)]]
    rng, attempts = generator(seed, 'answers'), ATTEMPTS
    if isinstance(domain, ReplayedDomain):
        attempts = REPLAYED if teacher.error_rate else 1
    settings = TeacherSettings(
        (*names,),
        error_rate=teacher.error_rate,
        extra_feature_rate=teacher.needless % 1.0,
        own_habits=True,
        attempts=attempts,
        seed=seed,
    )
    taught = teach(
        domain,
        settings,
        LessonRules(budget=BUDGET, seed=seed, method=method),
        references={
            name: answering(option, domain, teacher, rng) for name, option in references.items()
        },
    )
    keys = sum(taught.acts[act] for act in KEYED) + sum(len(name) + 1 for name in names)
    options, rows = {option.name: option for option in taught.options}, list[dict[str, Any]]()
    summaries = {summary.option_name: summary for summary in taught.summaries}
    for name in names:
        row = {**{key: parameters[key] for key in KEYS}, 'option': name, 'lesson': lesson}
        row |= {'learned': False, 'right': False, 'cut short': taught.cut_short}
        rows.append(row)
        if name not in options:
            continue
        summary = summaries[name]
        means = kind if teacher.meaning else CAREFUL
        wanted = _meant(world, means, name, parameters['seed'])
        found = wanted.performance(options[name])
        right = found.right(wanted.teacher)
        row |= {
            'learned': summary.learned,
            'right': found.is_right(wanted.teacher),
            'right starts': float(right.mean()),
            'elsewhere': found.elsewhere,
            'faults': found.faults(wanted.teacher),
            'demonstrations': summary.n_demonstrations,
            'not here': summary.n_not_here,
            'questions': summary.n_questions,
            'exam answers': sum(demo.exam for demo in taught.judged if demo.option_name == name),
            'keys': keys / len(names),
            'features': ', '.join(options[name].features),
            'status': summary.status,
            'criteria': ', '.join(f'{each.name} {each.verdict}' for each in summary.criteria),
        }
    return rows


def table_of(lessons: pd.DataFrame) -> pd.DataFrame:
    """
    Return the table: one row per world, method and teacher.

    :param lessons: one row per option taught.
    :return: ``KEYS``, learnable, reason (if not learnable), lessons, learned (number called
        learned), right (share of these, with Wilson's 95 % limits low and high; empty if none was
        called learned), false (share of all lessons that call a wrong option learned, with
        limits), elsewhere (mean over those called learned), and the medians of ``COSTS``.
    """
    rows = []
    for key, mine in report.grouped(lessons, KEYS):
        learned, right = mine['learned'].to_numpy(bool), mine['right'].to_numpy(bool)
        share, wrong = (Interval.of_share(flags) for flags in (right[learned], learned & ~right))
        rows.append(
            {
                **dict(zip(KEYS, key)),
                'learnable': not (reason := obstacle(*key)),
                'reason': reason,
                'lessons': len(mine),
                'learned': int(learned.sum()),
                'right': share.mean,
                'right: low': share.low,
                'right: high': share.high,
                'false': wrong.mean,
                'false: low': wrong.low,
                'false: high': wrong.high,
                'elsewhere': mine.loc[learned, 'elsewhere'].mean(),
                **mine[COSTS].median(),
            }
        )
    return pd.DataFrame(rows)


def present(rows: pd.DataFrame) -> report.Section:
    """Return the report section from one row per lesson and option."""
    lessons = rows.drop(columns='trial', errors='ignore')
    lessons['faults'] = [
        ', '.join(f'{name} {share:.2g}' for name, share in faults.items())
        if isinstance(faults, dict)
        else ''
        for faults in lessons['faults']
    ]
    table = table_of(lessons)
    tables = [
        report.Table('judging-rows', 'Options called learned, and those that are right', table),
        report.Table('judging-lessons', 'Each lesson', lessons, shown=False),
    ]
    height = 1.2 + 0.2 * len(table)
    pictures = [
        report.Picture(
            'judging-right',
            'Share of right options among those called learned, with 95 % limits. Dots below 0.95 '
            'in learnable rows miss the goal; the other rows show the share of lessons that call '
            'a wrong option learned, which must be at most 0.05.',
            (7.6, height),
            partial(_draw, table),
        )
    ]
    facts = {'share': SHARE, 'false': FALSE, 'budget': BUDGET}
    return report.Section(NAME, TITLE, _comparisons(table), pictures, tables, facts)


def _comparisons(table: pd.DataFrame) -> list[report.Comparison]:
    """Compare each row with its goal."""
    found = []
    for row in table.to_dict('records'):
        case = ', '.join(row[key] for key in KEYS)
        counts = f'{row["learned"]} of {row["lessons"]} called learned'
        if row['learnable']:
            said = f'{case}: at least {SHARE:.0%} of the options called learned are right.'
            value = Interval(row['right'], row['right: low'], row['right: high'])
            verdict = bool(value.mean >= SHARE) if row['learned'] else None
        else:
            said = f'{case}: at most {FALSE:.0%} of the lessons call a wrong option learned.'
            value = Interval(row['false'], row['false: low'], row['false: high'])
            verdict = bool(value.mean <= FALSE)
        values = {'share': value} if row['learned'] or not row['learnable'] else {}
        found.append(
            report.compare(said, verdict, counts, values, '.2f', '' if values else counts)
        )
    return found


def _draw(table: pd.DataFrame, work: Drawing) -> None:
    places = np.arange(len(table))
    for learnable, name, colour in ((True, 'right', 'C0'), (False, 'false', 'C1')):
        mine = table['learnable'] == learnable
        low, mean, high = (table.loc[mine, f'{name}{end}'] for end in (': low', '', ': high'))
        label = 'right, of those called learned' if learnable else 'wrong, but called learned'
        bars = [mean - low, high - mean]
        work.axes.errorbar(mean, places[mine], xerr=bars, fmt='o', color=colour, label=label)
    work.axes.set_yticks(places, [', '.join(row) for row in table[KEYS].to_numpy()])
    work.axes.set(xlim=(0, 1.02), xlabel='share')
    work.axes.invert_yaxis()
    work.axes.legend()
    work.axes.grid(axis='x')
