"""From where a learned option does not do what its demonstrations show, by the rules alone."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from humanopts_env.domains.base import Domain, EnumerableDomain, is_enumerable
from humanopts_env.domains.tabular import distance_to, reachable
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.option import LearnedOption, option_tables
from humanopts_learner.options.rollout import follow, rollouts
import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]
# A longer way than needed that was shown once or twice may be a slip; two of three outvote one.
MEANT = 3
SAMPLE = 50  # states that stand for all, where they cannot be enumerated


@dataclass(frozen=True)
class Survey:
    """What a learned option does from each of the S states of an enumerable domain."""

    candidate: Mask  # (S,) open, reachable, and in the learned I or unlike anything shown
    stuck: Mask  # (S,) candidates from which it comes to no end that was shown
    detour: Mask  # (S,) it does, but in more steps than needed; shown less than MEANT times
    times_shown: NDArray[np.int64]  # (S,) demonstrations with a state alike in the features
    distance: NDArray[np.int32]  # (S,) fewest steps to an end that was shown; -1: no way known
    nearer: Mask  # (S, A) the actions of shortest ways

    @property
    def failing(self) -> Mask:
        """Return (S,): stuck or on a detour."""
        return self.stuck | self.detour


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

    An end counts as shown when a demonstration ended in a state alike in the features, with the
    task over or not as after most demonstrations: a taxi that lets its passenger out at the wrong
    place has come to an end, but to none that was shown.

    :param demonstrations: those that the option was learned from.
    :raises OptionError: the option was not learned in this domain.
    """
    transitions, over = domain.transitions(), domain.over()
    tables = option_tables(option, domain)
    times_shown, known_end, new_value = _shown(option, domain, demonstrations)
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
    candidate = reachable(domain) & ~over & (tables.initiation | new_value)
    reached = walks.reached & known_end[walks.final] & tables.initiation
    return Survey(
        candidate=candidate,
        stuck=candidate & ~reached,
        detour=candidate & reached & (walks.steps > distance) & (times_shown < MEANT),
        times_shown=times_shown,
        distance=distance,
        nearer=nearer,
    )


def failing_samples(
    option: LearnedOption, domain: Domain[Any], rng: np.random.Generator
) -> list[Any]:
    """
    Return the sampled states from which the option does not end before ``max_steps``.

    For domains that ``survey`` cannot look at; it takes ``SAMPLE`` states.
    """
    states = domain.sample_states(rng, SAMPLE)
    rows = np.array([domain.feature_values(state) for state in states])
    members = [state for state, inside in zip(states, option.can_start(rows)) if inside]
    runs = rollouts(option, domain, members, int(rng.integers(2**31)))
    return [state for state, reached in zip(members, runs.reached) if not reached]


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
    return len(failing_samples(option, domain, rng))


def has_new_value(rows: NDArray[np.int32], shown: NDArray[np.int32]) -> Mask:
    """Return (N,): which of the rows (N, F) have in some column a value that none shown has."""
    new = np.zeros(len(rows), dtype=np.bool_)
    for values, seen in zip(rows.T, shown.T):
        new |= ~np.isin(values, seen)
    return new


def _shown(
    option: LearnedOption,
    domain: EnumerableDomain[Any],
    demonstrations: Sequence[Demonstration],
) -> tuple[NDArray[np.int64], Mask, Mask]:
    """Return times shown, whether an end was shown, and whether a feature has a new value."""
    columns = sorted({column.index for column in option.columns})
    table = domain.feature_table()[:, columns]
    rows = np.concatenate([demo.feature_rows[:, columns] for demo in demonstrations])
    source = np.repeat(
        np.arange(len(demonstrations)), [len(demo.states) for demo in demonstrations]
    )
    _, inverse = np.unique(np.concatenate([table, rows]), axis=0, return_inverse=True)
    group = inverse.ravel()
    of_state, of_row = group[: len(table)], group[len(table) :]
    shown = np.unique(np.stack([of_row, source]), axis=1)[0]  # once in each demonstration
    times = np.bincount(shown, minlength=group.max() + 1)
    last = np.cumsum([len(demo.states) for demo in demonstrations]) - 1
    is_end = np.array([demo.kind is Kind.TRAJECTORY for demo in demonstrations])
    known_end = np.isin(of_state, of_row[last[is_end]])
    mostly_over = (
        np.mean([d.terminated for d in demonstrations if d.kind is Kind.TRAJECTORY]) > 0.5
    )
    known_end &= domain.over() == mostly_over
    return times[of_state], known_end, has_new_value(table, rows)
