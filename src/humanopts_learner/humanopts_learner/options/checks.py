"""
Questions about runs of an option that its demonstrations leave open.

Criteria compare an option with its demonstrations, and an exam of few runs finds only common
errors. A question shows one run and is answered with one key. Questions are about ends and changes
that were never shown, starts unlike all demonstrated ones, states where I is a guess, and runs
that are shorter than demonstrated or longer than necessary. *Yes* is evidence for all runs that
are alike in this respect; *no* leads to a demonstration. Questions of one kind are asked until at
most the share ``UNASKED`` of the runs is left.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import chain, combinations
from typing import Any

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.domains.base import ActableDomain, Domain, FeatureKind, is_enumerable
from humanopts_env.domains.described import can_simulate
from humanopts_env.domains.formulas import feature_columns, FeatureColumn, plain_name, stacked
from humanopts_env.domains.tabular import reachable
from humanopts_env.games import feature_rows, Games, games_at
from humanopts_learner.demonstrations import Demonstration, judged, shown, version_of
from humanopts_learner.execution import Execution, Fixed, RowOptions, SeenRows
from humanopts_learner.option import Option
from humanopts_learner.options.decision_tree import encode_rows, feature_encoding, fit_tree
from humanopts_learner.options.failures import find_failures, KnownEnds, uncertain
from humanopts_learner.options.learn import make_dataset
from humanopts_learner.options.learned_option import (
    LearnedOption,
    loops_of,
    MEMBER,
    MEMBERSHIP,
    tabulate,
)
from humanopts_learner.options.rollout import (
    is_deterministic,
    rollouts_from_everywhere,
    run_once,
    without_chance,
)
from humanopts_learner.options.starts import possible_starts
import numpy as np

MAX_CHECKS = 12  # maximum number of questions between two demonstrations
MAX_ENDS = 8  # number of questions after which none is about an end
UNASKED = 0.05  # share of the runs up to which no question is asked
COMMITTEE = 40  # number of feature sets drawn for a committee
SOME = 0.2  # share of a committee that must dissent to justify a question
RUNS = 200  # number of runs, if the option cannot be run from all states
FEW = 8  # maximum number of feature values compared one by one
PARTS = 4  # parts of the range that are compared if there are more values
FEW_IN_PAIRS = 4  # maximum number of feature values compared in pairs


class CheckKind(Enum):
    """What a question is about."""

    END = 'end'  # an end or a change unlike any that was shown
    VALUE = 'value'  # a value of a chosen feature that was never shown
    CONSTANT = 'constant'  # a start that differs in a feature that was always the same
    OUTSIDE = 'outside'  # a state outside I without evidence
    INSIDE = 'inside'  # a state in I that other features would exclude
    SHORTER = 'shorter'  # a run that takes fewer steps than its demonstration
    DETOUR = 'detour'  # a run that takes more steps than necessary


@dataclass(frozen=True)
class Check:
    """A run of an option, with the fields of a ``Demonstration``, and a question about it."""

    kind: CheckKind
    text: str  # the question; yes means that the run is right
    states: tuple[str, ...]  # T + 1; T = 0: the option would not start there
    features: tuple[tuple[float, ...], ...]  # T + 1 rows of all features
    actions: tuple[str, ...] = ()  # T
    rewards: tuple[float, ...] = ()  # T
    terminated: bool = False
    compared: tuple[str, ...] = ()  # states of a demonstration for comparison; empty: none


def next_check(
    option: LearnedOption,
    domain: ActableDomain,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
    others: Sequence[Option] = (),
    *,
    every_end: bool = False,
) -> Check | None:
    """
    Return the next question about an option.

    :param demonstrations: all of this participant and option, with the judged runs.
    :param others: as in ``choose_start_state``.
    :param every_end: whether to ask about rare ends, too, if criteria depend on them.
    :return: None: answers would change little, or the domain cannot be simulated.
    :raises OptionError: the option was not learned in this domain.
    """
    if not can_simulate(domain):
        return None
    option.check_domain(domain)
    demos, answers = shown(demonstrations), judged(demonstrations)
    version, right = version_of(demos), [run for run in answers if run.right]
    asked = sum(run.option_version == version and not run.exam for run in answers)
    if asked >= MAX_CHECKS or not any(demo.actions for demo in demos):
        return None
    known = [*demos, *right]
    starts = _starts(option, domain, demonstrations, known, rng, others)
    questions = _Questions(option, domain, starts, known, answers, rng)
    kinds = [questions.new_values(), questions.guesses()]
    if asked < MAX_ENDS:
        kinds.insert(0, questions.new_ends(0.0 if every_end else UNASKED))
    if is_deterministic(domain):
        kinds += [questions.shorter(), questions.detours()]
    return next(chain(*kinds), None)


@dataclass(frozen=True)
class _Starts:
    """N states, and the runs of an option from those in I."""

    state: Callable[[int], Any]  # state by index
    rows: Rows  # (N, F)
    passed: Rows  # (N, F) first row of each run with a nominal value never shown; else its start
    runs: Flags  # (N,) in I, and the run ends by beta or with the task over
    last: Rows  # (N, F) features where it ends
    over: Flags  # (N,) whether the task is over at the end
    steps: Ints  # (N,) length of each run
    unknown: Flags  # (N,) runs with an end unlike all that were shown or called right
    outside: Flags  # (N,) possible starts outside I
    detour: Flags  # (N,) runs longer than necessary, but often demonstrated
    distance: Ints  # (N,) necessary number of steps, if known
    seeds: Ints  # (N,) random seeds of the runs


@dataclass(frozen=True)
class _Questions:
    """The questions of each kind about an option."""

    option: LearnedOption
    domain: Domain
    starts: _Starts
    known: Sequence[Demonstration]  # demonstrations, and runs that the person called right
    answers: Sequence[Demonstration]  # all judged runs
    rng: np.random.Generator

    def new_ends(self, few: float) -> Iterator[Check]:
        """
        Ask about the most common end, or change from start to end, that was never shown.

        :param few: as in ``_ask``.
        """
        starts, chosen = self.starts, feature_columns(self.domain, self.option.features)
        nominal = [column.feature.kind is FeatureKind.NOMINAL for column in chosen]

        def changes(first: Rows, last: Rows) -> Flags:
            found: Flags = (stacked(chosen, first) != stacked(chosen, last)) & nominal
            return found

        ends = np.stack([run.feature_rows[[0, -1]] for run in self.known if run.actions])
        known, changed = changes(ends[:, 0], ends[:, 1]), changes(starts.rows, starts.last)
        new = starts.runs & ~(changed[:, None] == known).all(axis=2).any(axis=1)
        new |= starts.unknown
        looks = [_parts(column, starts.last)(starts.last) for column in chosen]
        like = np.column_stack([starts.over, changed, *looks])[new]
        _, group, size = np.unique(like, axis=0, return_inverse=True, return_counts=True)
        alike = np.zeros(len(new))
        alike[new] = size[group.ravel()]
        where = {True: ', where you never stopped', False: ''}
        yield from self._ask(
            CheckKind.END,
            new,
            alike,
            lambda at: f'Here it would stop after {{}}{where[bool(starts.unknown[at])]}. Right?',
            few,
        )

    def new_values(self) -> Iterator[Check]:
        """Ask about a run from or through the most common values that were never shown."""
        runs = [run for run in self.known if run.actions]
        seen = np.concatenate([run.feature_rows for run in runs])
        first = np.stack([run.feature_rows[0] for run in runs])
        names = {feature.name for feature in self.domain.features}.difference(self.option.features)
        chosen, starts = feature_columns(self.domain, self.option.features), self.starts
        yield from self._unlike(CheckKind.VALUE, chosen, starts.passed, seen, 'it')
        columns = feature_columns(self.domain, names)
        part = [_parts(column, starts.rows)(first) for column in columns]
        constant = [c for c, values in zip(columns, part) if len(np.unique(values)) == 1]
        yield from self._unlike(CheckKind.CONSTANT, constant, starts.rows, first, 'a start')

    def _unlike(
        self, kind: CheckKind, columns: Sequence[FeatureColumn], rows: Rows, known: Rows, what: str
    ) -> Iterator[Check]:
        """Ask about a start if its row (N, F) has values that no known row (M, F) has."""
        starts = self.starts
        share = np.zeros((len(columns), len(rows)))  # number of starts with the same new value
        for number, column in enumerate(columns):
            part = _parts(column, rows)
            here = part(rows)
            new = starts.runs & ~np.isin(here, part(known))
            _, group, size = np.unique(here[new], return_inverse=True, return_counts=True)
            share[number, new] = size[group]

        def text(at: int) -> str:
            column = columns[int(share[:, at].argmax())]
            value = f'{plain_name(column.feature.name)} {column.text(rows[at])}'
            return f'You never showed {what} with {value}. Here it would stop after {{}}. Right?'

        total = share.sum(axis=0)
        yield from self._ask(kind, total > 0, total, text)

    def guesses(self) -> Iterator[Check]:
        """Ask about states outside I without evidence, and where a committee disagrees on I."""
        starts = self.starts
        evidence = [*self.known, *(run for run in self.answers if not run.right)]
        doubt = starts.outside & uncertain(self.option, starts.rows, evidence)
        not_here = 'It would not start here. Right?'
        yield from self._ask(CheckKind.OUTSIDE, doubt, np.zeros(len(doubt)), lambda at: not_here)
        pairs, text = self._new_pairs(), 'Here it would start, and stop after {}. Right?'
        out, here = (among & (pairs > 0) for among in (starts.outside, starts.runs))
        yield from self._ask(CheckKind.OUTSIDE, out, pairs, lambda at: not_here)
        yield from self._ask(CheckKind.INSIDE, here, pairs, lambda at: text)
        votes = _votes(starts.rows, self.known, self.domain, self.rng)
        missing, here = starts.outside & (votes >= SOME), starts.runs & (votes <= 1 - SOME)
        yield from self._ask(CheckKind.OUTSIDE, missing, votes, lambda at: not_here)
        yield from self._ask(CheckKind.INSIDE, here, -votes, lambda at: text)

    def _new_pairs(self) -> Floats:
        """
        Return (N,): the number of value pairs that no demonstration or answer contains.

        Features that were not chosen count, too, since the person may have missed one.
        """
        names = {*self.option.features, *(feature.name for feature in self.domain.features)}
        every = feature_columns(self.domain, names)
        few = [c for c in every if 0 < len(c.feature.values) <= FEW_IN_PAIRS]
        shown_rows = [run.feature_rows[: max(len(run.actions), 1)] for run in self.known]
        here = stacked(few, self.starts.rows)
        there = stacked(few, np.concatenate(shown_rows))
        total = np.zeros(len(here))
        for one, other in combinations(range(len(few)), 2):
            seen, pairs = (rows[:, one] * FEW_IN_PAIRS + rows[:, other] for rows in (there, here))
            total += ~np.isin(pairs, seen)
        return total

    def shorter(self) -> Iterator[Check]:
        """Ask about the run that saves the most steps, if savings are typical or large."""
        starts, domain = self.starts, self.domain
        assert is_deterministic(domain)
        demos = {run.states[0]: run for run in shown(self.known) if run.actions}
        took = {start: len(demo.actions) for start, demo in demos.items()}
        meant = [
            took[run.states[0]] - len(run.actions)
            for run in judged(self.known)
            if run.states[0] in took
        ]
        at = [domain.index(domain.decode(start)) for start in took]
        saved = np.where(starts.runs[at], [*took.values()] - starts.steps[at], 0)
        start, most = [*took][saved.argmax()], int(saved.max())
        usual = saved.mean() > saved.std() or 2 * most > took[start]
        if usual and most > max(meant, default=0) and self._is_new(start):
            text = f'You took {took[start]} steps here; it takes {took[start] - most}. '
            text += 'Is the shorter way right?'
            state = domain.decode(start)
            found = _check(CheckKind.SHORTER, self.option, domain, state, 0, text)
            yield replace(found, compared=demos[start].states)

    def detours(self) -> Iterator[Check]:
        """Ask about the longest detour that was shown often."""
        starts = self.starts
        longer = (starts.steps - starts.distance).astype(np.float64)
        text = 'It takes {} here; %d would do. Is the detour intended?'
        yield from self._ask(
            CheckKind.DETOUR,
            starts.detour,
            longer,
            lambda at: text % starts.distance[at],
            few=0.0,
        )

    def _ask(
        self,
        kind: CheckKind,
        among: Flags,
        best: Floats,
        text: Callable[[int], str],
        few: float = UNASKED,
    ) -> Iterator[Check]:
        """
        Yield a question about the best new start, unless there are few such starts.

        :param among: (N,) whether to consider each start.
        :param best: (N,) priority of each start.
        :param text: function that returns a question with ``{}`` for the number of steps.
        :param few: share of the runs up to which no question is asked.
        """
        if among.sum() <= few * self.starts.runs.sum():
            return
        order = self.rng.permutation(np.flatnonzero(among))
        for at in order[np.argsort(-best[order], kind='stable')].tolist():
            state, seed = self.starts.state(at), int(self.starts.seeds[at])
            if self._is_new(self.domain.encode(state)):
                yield _check(kind, self.option, self.domain, state, seed, text(at))
                return

    def _is_new(self, start: str) -> bool:
        return all(run.states[0] != start for run in self.answers)


def _starts(
    option: LearnedOption,
    domain: Domain,
    demonstrations: Sequence[Demonstration],
    known: Sequence[Demonstration],
    rng: np.random.Generator,
    others: Sequence[Option],
) -> _Starts:
    """
    Run an option from all states of a deterministic domain, or from a sample of other domains.

    :param known: as in ``_Questions``.
    """
    if is_deterministic(domain):
        found, rows = find_failures(option, domain, demonstrations), domain.feature_table()
        runs = rollouts_from_everywhere(domain, tabulate(option, domain))
        return _Starts(
            domain.state_at,
            rows,
            rows,
            found.candidate & ~found.stuck,
            runs.rows,
            runs.over,
            runs.steps,
            found.unconfirmed,
            reachable(domain) & ~domain.over() & ~option.can_start(rows),
            found.meant,
            found.distance.astype(np.intp),
            np.zeros(len(rows), dtype=np.intp),
        )
    drawn = possible_starts(domain, rng, others)
    times = 1 + is_enumerable(domain) * (RUNS // len(drawn.states))  # repeated runs may differ
    states, askable = drawn.states * times, np.tile(drawn.askable, times)
    rows = feature_rows(domain, states)
    seeds = rng.integers(2**31, size=len(states))
    at, passed = np.flatnonzero(option.can_start(rows))[:RUNS], rows.copy()
    there = np.concatenate([run.feature_rows for run in known if run.actions])
    values = [
        (column, np.unique(column.values(there)))
        for column in feature_columns(domain, option.features)
        if column.feature.kind is FeatureKind.NOMINAL
    ]
    waits = np.ones(len(at), dtype=np.bool_)  # until a value is found that was never shown

    def on_step(step: int, execution: Execution[SeenRows], seen: SeenRows, games: Games) -> None:
        new = waits[execution.games]
        new &= np.any([~np.isin(each.values(seen.rows), some) for each, some in values], axis=0)
        first = execution.games[new]
        passed[at[first]], waits[first] = seen.rows[new], False

    none = np.zeros(len(states), dtype=np.intp)
    ended, over, unknown, steps, last = none > 0, none > 0, none > 0, none.copy(), rows.copy()
    ran = run_once(
        domain,
        [states[n] for n in at.tolist()],
        [option],
        none[at],
        np.full(len(at), option.max_steps),
        [np.random.default_rng(seed) for seed in seeds[at].tolist()],
        loops_of(domain, [option], len(at), None),
        on_step if values else None,
    )
    ends = KnownEnds(domain, option.features, demonstrations)
    unlike = ~ends.like_shown(ran.rows, ran.over, ran.last_reward)
    # Bad luck is not an end.
    reached = ran.reached & ~(ran.over & unlike & (not without_chance(domain)))
    ended[at], over[at], steps[at], last[at] = reached, ran.over, ran.steps, ran.rows
    unknown[at] = reached & unlike
    outside = askable & ~option.can_start(rows)
    parts = ended, last, over, steps, unknown, outside, none > 0, none, seeds
    return _Starts(states.__getitem__, rows, passed, *parts)


def _parts(column: FeatureColumn, rows: Rows) -> Callable[[Rows], Floats]:
    """Return a function from rows to compared values: feature values, or parts of their range."""
    values = np.unique(column.values(rows))
    if column.feature.kind is FeatureKind.NOMINAL or len(values) <= FEW:
        return column.values
    edges = np.linspace(values[0], values[-1], PARTS + 1)[1:-1]
    return lambda some: np.digitize(column.values(some), edges).astype(np.float64)


def _votes(
    rows: Rows, runs: Sequence[Demonstration], domain: Domain, rng: np.random.Generator
) -> Floats:
    """
    Return (N,): the share of a committee by which an option can start in rows (N, F).

    The committee consists of trees of I over random features that explain all demonstrations and
    answers as well as the chosen features do (query by committee, as ``committee_disagrees``).
    """
    data = make_dataset(runs, domain)
    judged_rows = [run.feature_rows[:1] for run in judged(runs)]
    known = np.concatenate([data.initiation.rows, *judged_rows])
    labels = np.append(data.initiation.labels, [len(run.actions) > 0 for run in judged(runs)])
    names = [feature.name for feature in domain.features]
    encoding = feature_encoding(domain, [*names, *data.features])
    X, Y = encode_rows(encoding, known), encode_rows(encoding, rows)

    def fitted(chosen: Collection[str], seed: int) -> tuple[float, Flags]:
        columns = [at for at, each in enumerate(encoding) if each.feature in chosen]
        tree = fit_tree(X[:, columns], labels, MEMBERSHIP, seed)
        errors = (tree.most_probable(X[:, columns]) != labels).mean()
        return float(errors), tree.most_probable(Y[:, columns]) == MEMBER

    allowed, vote = fitted(data.features, 0)
    votes = [vote]
    for number in range(COMMITTEE):
        among = data.features if number % 2 else names
        drawn = rng.permutation(among)[: int(rng.integers(1, len(among) + 1))].tolist()
        errors, vote = fitted(drawn, number)
        if errors <= allowed:
            votes.append(vote)
    share: Floats = np.mean(votes, axis=0)
    return share


def _check(
    kind: CheckKind, option: LearnedOption, domain: Domain, state: Any, seed: int, text: str
) -> Check:
    """
    Return a question about the run from a state.

    :param text: question, with ``{}`` for the number of steps.
    """
    games, options = games_at(domain, [state]), RowOptions([option])
    execution = Execution(options, Fixed(np.zeros(1, dtype=np.intp)), 1)
    seen, chance, over = options.see(games), [np.random.default_rng(seed)], False
    states, rows, actions, rewards = [state], [seen.rows[0]], list[str](), list[float]()
    while kind is not CheckKind.OUTSIDE:
        taken = execution.act(seen)
        step = games.step(taken, chance)
        seen, over = options.see(games), bool(step.over[0])
        states += games.states()
        rows.append(seen.rows[0])
        actions.append(domain.actions[int(taken[0])].name)
        rewards.append(float(step.reward[0]))
        if execution.observe(seen, step).game.size:
            break
    return Check(
        kind,
        text.replace('{}', '1 step' if len(actions) == 1 else f'{len(actions)} steps'),
        tuple(map(domain.encode, states)),
        tuple(tuple(row.tolist()) for row in rows),
        tuple(actions),
        tuple(rewards),
        over,
    )
