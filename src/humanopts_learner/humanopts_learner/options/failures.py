"""From where a learned option does not do what its demonstrations show, by the rules alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from humanopts_env.domains.base import Domain, EnumerableDomain, is_enumerable
from humanopts_env.domains.tabular import distance_to, reachable
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.option import LearnedOption, option_tables
from humanopts_learner.options.rollout import follow, rollouts
from humanopts_learner.trees.encoding import encode_rows
import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]
# A longer way than needed that was shown once or twice may be a slip; two of three outvote one.
MEANT = 3
REFUSALS = 3  # "not here" answers after which a leaf outside I is believed
SAMPLE = 50  # states that stand for all, where they cannot be enumerated


@dataclass(frozen=True)
class Survey:
    """What a learned option does from each of the S states of an enumerable domain."""

    candidate: Mask  # (S,) open, reachable, and in the learned I
    stuck: Mask  # (S,) candidates from which it comes to no end that was shown
    detour: Mask  # (S,) it does, but in more steps than needed; shown less than MEANT times
    doubt: Mask  # (S,) open, reachable, and outside I by mere guess (``in_doubt``)
    times_shown: NDArray[np.int64]  # (S,) demonstrations with a state alike in the features
    distance: NDArray[np.int32]  # (S,) fewest steps to an end that was shown; -1: no way known
    nearer: Mask  # (S, A) the actions of shortest ways

    @property
    def failing(self) -> Mask:
        """Return (S,): stuck, on a detour, or in doubt."""
        return self.stuck | self.detour | self.doubt


def is_surveyable(domain: Domain[Any]) -> bool:
    """Tell whether ``survey`` can look at every state."""
    return is_enumerable(domain) and domain.transitions().deterministic


def survey(
    option: LearnedOption,
    domain: EnumerableDomain[Any],
    demonstrations: Sequence[Demonstration],
) -> Survey:
    """
    Run the option from every state of a deterministic domain.

    An end counts as shown when a demonstration ended in a state alike in the features: a taxi
    that lets its passenger out at the wrong place has come to an end, but to none that was shown.
    If most demonstrations ended with the task over and this one did not, or the other way round,
    it may be a slip, and counts from the second time on.

    :param demonstrations: those that the option was learned from.
    :raises OptionError: the option was not learned in this domain.
    """
    transitions, over = domain.transitions(), domain.over()
    tables = option_tables(option, domain)
    times_shown, known_end = _shown(option, domain, demonstrations)
    states = np.arange(domain.n_states)
    walks = follow(
        domain,
        tables.action[None],
        tables.termination[None],
        np.zeros_like(states),
        states,
        np.full_like(states, option.max_steps),
    )
    successor = transitions.successor[:, :, 0]
    ends = (tables.termination | over)[successor] | transitions.terminated[:, :, 0]
    distance, nearer = distance_to(
        transitions, ends & known_end[successor] & ~over[:, None], ~over
    )
    askable = reachable(domain) & ~over
    candidate = askable & tables.initiation
    reached = walks.reached & known_end[walks.final]
    doubt = in_doubt(option, domain.feature_table(), demonstrations)
    return Survey(
        candidate=candidate,
        stuck=candidate & ~reached,
        detour=candidate & reached & (walks.steps > distance) & (times_shown < MEANT),
        doubt=askable & doubt,
        times_shown=times_shown,
        distance=distance,
        nearer=nearer,
    )


def in_doubt(
    option: LearnedOption, rows: NDArray[np.int32], demonstrations: Sequence[Demonstration]
) -> Mask:
    """
    Return (N,): which rows (N, F) are outside I by mere guess.

    They were not shown, and fewer than ``REFUSALS`` different "not here" answers fell into their
    leaf of the tree: little more than ends of the option made it negative.
    """
    seen = np.unique(_encoded(option, [demo.feature_rows for demo in demonstrations]), axis=0)
    refusals = [demo.feature_rows for demo in demonstrations if demo.kind is Kind.NOT_HERE]
    refused = np.unique(_encoded(option, [rows[:0], *refusals]), axis=0)
    answers = np.bincount(option.initiation.leaves(refused), minlength=len(option.initiation.left))
    X = _encoded(option, [rows])
    shown = {row.tobytes() for row in seen}
    fresh = np.array([row.tobytes() not in shown for row in X], dtype=np.bool_)
    return fresh & ~option.can_start(rows) & (answers[option.initiation.leaves(X)] < REFUSALS)


def _encoded(option: LearnedOption, parts: Sequence[NDArray[np.int32]]) -> NDArray[np.float32]:
    return encode_rows(option.columns, np.concatenate(parts))


def failing_samples(
    option: LearnedOption,
    domain: Domain[Any],
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
) -> list[Any]:
    """
    Return the sampled states from which the option does not end before ``max_steps``.

    With those that are in doubt. For domains that ``survey`` cannot look at; it takes ``SAMPLE``
    states.
    """
    states = domain.sample_states(rng, SAMPLE)
    rows = np.array([domain.feature_values(state) for state in states])
    member, failing = option.can_start(rows), in_doubt(option, rows, demonstrations)
    members = [state for state, inside in zip(states, member) if inside]
    runs = rollouts(option, domain, members, int(rng.integers(2**31)))
    failing[member] = ~runs.reached
    return [state for state, fails in zip(states, failing) if fails]


def count_failures(
    option: LearnedOption,
    domain: Domain[Any],
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
) -> int:
    """
    Count the states from which the option fails.

    :param rng: draws the states where they cannot be enumerated (then at most ``SAMPLE``).
    """
    if is_enumerable(domain) and is_surveyable(domain):
        return int(survey(option, domain, demonstrations).failing.sum())
    return len(failing_samples(option, domain, demonstrations, rng))


def _shown(
    option: LearnedOption,
    domain: EnumerableDomain[Any],
    demonstrations: Sequence[Demonstration],
) -> tuple[NDArray[np.int64], Mask]:
    """Return how many demonstrations show each state, and which states are ends shown, (S,)."""
    columns = sorted({column.index for column in option.columns})
    table = domain.feature_table()[:, columns]
    rows = np.concatenate([demo.feature_rows[:, columns] for demo in demonstrations])
    lengths = [len(demo.states) for demo in demonstrations]
    source = np.repeat(np.arange(len(demonstrations)), lengths)
    _, inverse = np.unique(np.concatenate([table, rows]), axis=0, return_inverse=True)
    group = inverse.ravel()
    of_state, of_row, size = group[: len(table)], group[len(table) :], group.max() + 1
    once = np.unique(np.stack([of_row, source]), axis=1)[0]  # in each demonstration
    trajectory = np.array([demo.kind is Kind.TRAJECTORY for demo in demonstrations])
    ends = of_row[np.cumsum(lengths) - 1][trajectory]
    times_ended = np.bincount(ends, minlength=size)[of_state]
    mostly_over = np.mean([demo.terminated for demo in demonstrations if demo.actions]) > 0.5
    known_end = times_ended >= np.where(domain.over() == mostly_over, 1, 2)
    return np.bincount(once, minlength=size)[of_state], known_end
