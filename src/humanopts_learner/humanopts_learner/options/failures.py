"""The states from which a learned option does not behave as demonstrated."""

from collections.abc import Sequence
from dataclasses import dataclass

from humanopts_env.arrays import Flags, Floats, Rows
from humanopts_env.domains.base import EnumerableDomain
from humanopts_env.domains.formulas import feature_columns, stacked
from humanopts_env.domains.tabular import distance_to, reachable
from humanopts_learner.demonstrations import Demonstration, GOAL, Kind
from humanopts_learner.options.decision_tree import encode_rows
from humanopts_learner.options.learned_option import LearnedOption, tabulate
from humanopts_learner.options.rollout import rollouts_from_everywhere
import numpy as np
from numpy.typing import NDArray

MEANT = 3  # demonstrations that make a detour intended; fewer may be slips
REFUSALS = 3  # "not here" answers required as evidence for a leaf outside I


@dataclass(frozen=True)
class Failures:
    """The outcome of running an option from each of the S states of an enumerable domain."""

    candidate: Flags  # (S,) open, reachable, and in the learned I
    stuck: Flags  # (S,) candidates from which no demonstrated end is reached
    detour: Flags  # (S,) candidates with a detour demonstrated fewer than MEANT times
    doubt: Flags  # (S,) open, reachable, and outside I without evidence (``uncertain``)
    times_shown: NDArray[np.int64]  # (S,) demonstrations with a state of equal features
    distance: NDArray[np.int32]  # (S,) fewest steps to a demonstrated end; -1: no known path
    nearer: Flags  # (S, A) first actions of shortest paths
    shortfall: Floats  # (S,) return of the best shortest path - return of the run; stuck: inf

    @property
    def failing(self) -> Flags:
        """Return (S,): stuck, on a detour, or in doubt."""
        return self.stuck | self.detour | self.doubt


def find_failures(
    option: LearnedOption,
    domain: EnumerableDomain,
    demonstrations: Sequence[Demonstration],
) -> Failures:
    """
    Run the option from every state of a deterministic domain.

    An end counts as demonstrated if a demonstration ended in a state with equal features: a taxi
    that drops its passenger at the wrong place has reached an end, but not a demonstrated one. If
    most demonstrations ended with the task over and one did not, or vice versa, its end may be a
    slip and counts only if repeated. A planned policy (``goal.py``) takes the best path to the end
    most similar to the demonstrated ones, so each of its ends counts.

    :param demonstrations: those from which the option was learned.
    :raises OptionError: the option was not learned in this domain.
    """
    transitions, over = domain.transitions(), domain.over()
    table = tabulate(option, domain)
    times_shown, known_end = _shown(option, domain, demonstrations)
    planned = option.method == GOAL
    known_end |= planned
    runs = rollouts_from_everywhere(domain, table)
    successor = transitions.successor[:, :, 0]
    ends = (table.termination | over)[successor] | transitions.terminated[:, :, 0]
    distance, nearer = distance_to(
        transitions, ends & known_end[successor] & ~over[:, None], ~over
    )
    askable = reachable(domain) & ~over
    candidate = askable & table.initiation
    reached = runs.reached & known_end[runs.final]
    doubt = uncertain(option, domain.feature_table(), demonstrations)
    return Failures(
        candidate=candidate,
        stuck=candidate & ~reached,
        detour=candidate
        & reached
        & (runs.steps > distance)
        & (times_shown < MEANT)
        & (not planned),
        doubt=askable & doubt,
        times_shown=times_shown,
        distance=distance,
        nearer=nearer,
        shortfall=np.where(
            reached, _best_return(domain, distance, nearer) - runs.total_reward, np.inf
        ),
    )


def largest_shortfall(
    option: LearnedOption,
    domain: EnumerableDomain,
    demonstrations: Sequence[Demonstration],
) -> float:
    """
    Return the largest shortfall over all states where an option can start, in reward units.

    :return: infinite if it reaches no demonstrated end from some state, or can start nowhere.
    """
    found = find_failures(option, domain, demonstrations)
    return float(found.shortfall[found.candidate].max()) if found.candidate.any() else np.inf


def _best_return(domain: EnumerableDomain, distance: NDArray[np.int32], nearer: Flags) -> Floats:
    """Return (S,): the largest return of a shortest path; -infinity: no path."""
    table = domain.transitions()
    reward, successor = table.reward[:, :, 0], table.successor[:, :, 0]
    best = np.full(len(distance), -np.inf)
    for steps in range(1, distance.max(initial=0) + 1):
        at = np.flatnonzero(distance == steps)
        after = best[successor[at]] if steps > 1 else 0.0
        best[at] = np.where(nearer[at], reward[at] + after, -np.inf).max(axis=1)
    return best


def uncertain(option: LearnedOption, rows: Rows, demonstrations: Sequence[Demonstration]) -> Flags:
    """
    Return (N,): whether rows (N, F) are outside I without evidence.

    They were not demonstrated, and their leaf of the tree has fewer than ``REFUSALS`` distinct
    "not here" answers: it is negative mainly because of ends of the option.
    """
    seen = np.unique(_encoded(option, [demo.feature_rows for demo in demonstrations]), axis=0)
    refusals = [demo.feature_rows for demo in demonstrations if demo.kind is Kind.NOT_HERE]
    refused = np.unique(_encoded(option, [rows[:0], *refusals]), axis=0)
    answers = np.bincount(option.initiation.leaves(refused), minlength=len(option.initiation.left))
    X = _encoded(option, [rows])
    shown = {row.tobytes() for row in seen}
    fresh = np.array([row.tobytes() not in shown for row in X], dtype=np.bool_)
    return fresh & ~option.can_start(rows) & (answers[option.initiation.leaves(X)] < REFUSALS)


def _encoded(option: LearnedOption, parts: Sequence[Rows]) -> NDArray[np.float32]:
    return encode_rows(option.encoding, np.concatenate(parts)) + np.float32(0)  # no -0.0


def _shown(
    option: LearnedOption,
    domain: EnumerableDomain,
    demonstrations: Sequence[Demonstration],
) -> tuple[NDArray[np.int64], Flags]:
    """Return the number of demonstrations per state and the demonstrated ends, (S,) each."""
    chosen = feature_columns(domain, option.features)
    table = stacked(chosen, domain.feature_table())
    rows = stacked(chosen, np.concatenate([demo.feature_rows for demo in demonstrations]))
    lengths = [len(demo.states) for demo in demonstrations]
    source = np.repeat(np.arange(len(demonstrations)), lengths)
    _, inverse = np.unique(np.concatenate([table, rows]), axis=0, return_inverse=True)
    group = inverse.ravel()
    of_state, of_row, size = group[: len(table)], group[len(table) :], group.max() + 1
    once = np.unique(np.stack([of_row, source]), axis=1)[0]  # per demonstration
    trajectory = np.array([demo.kind is Kind.TRAJECTORY for demo in demonstrations])
    ends = of_row[np.cumsum(lengths) - 1][trajectory]
    times_ended = np.bincount(ends, minlength=size)[of_state]
    mostly_over = np.mean([demo.terminated for demo in demonstrations if demo.actions]) > 0.5
    known_end = times_ended >= np.where(domain.over() == mostly_over, 1, 2)
    return np.bincount(once, minlength=size)[of_state], known_end
