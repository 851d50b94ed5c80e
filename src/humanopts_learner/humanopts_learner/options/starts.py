"""
Strategies for the next start state, based only on the rules and the learned trees.

``random`` is the paper's strategy (section 5). ``coverage`` chooses the state that differs most
from all demonstrated states. ``failures`` chooses among states from which the learned option does
not behave as demonstrated. It prefers the state with shortest paths to an end through the most
failing situations not demonstrated yet, because a demonstration there teaches the most. Once no
state is stuck, it asks about states outside I without evidence, and then about detours. If the
option cannot be run from all states, it draws a state from a sample: one that is stuck, without
evidence, or decided by a tenth of the demonstrations.

In a replayed domain, states cannot be drawn, only reached by playing. Previously taught options
lead to the starts of this one. The option's own run leads to the state in which it gets stuck,
where the next demonstration starts.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, compress
from typing import Any

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.domains.base import (
    ActableDomain,
    Domain,
    EnumerableDomain,
    is_enumerable,
)
from humanopts_env.domains.formulas import feature_columns
from humanopts_env.domains.registry import KeyedDomain
from humanopts_env.domains.replayed_domain import ReplayedDomain
from humanopts_env.domains.tabular import reachable
from humanopts_env.games import feature_rows, Games, games_at, new_games
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, Kind, shown
from humanopts_learner.execution import (
    draw_among,
    Execution,
    Fixed,
    NONE,
    play,
    Policy,
    RowOptions,
    SeenRows,
)
from humanopts_learner.option import Option
from humanopts_learner.options.decision_tree import encode_rows, feature_encoding
from humanopts_learner.options.failures import (
    Failures,
    find_failures,
    KnownEnds,
    successes_by_chance,
    uncertain,
)
from humanopts_learner.options.learn import fit_leave_fold_out, fold_of, make_dataset
from humanopts_learner.options.learned_option import LearnedOption, loops_of
from humanopts_learner.options.rollout import is_deterministic, Rollouts, rollouts
import numpy as np

STRATEGIES = ('random', 'coverage', 'failures')
SHOWN_WEIGHT = 0.1  # weight of a demonstrated failing situation; others: 1
SAMPLE = 500  # number of sampled states, if the option cannot be run from all
RUNS = 50  # number of runs from sampled states
GAMES, STEPS = 24, 300  # number of games played in a replayed domain; maximum steps of each
DRAWS = 20  # maximum number of samples, or groups of games, for fresh starts
TOLERATED = 0.1  # maximum share of failing states at the end of a lesson


class UnknownStrategyError(ValueError):
    """Unknown strategy; the message lists the strategies."""


@dataclass(frozen=True)
class Sample:
    """A sample of N states; likely starts of the option come first."""

    states: list[Any]
    askable: Flags  # (N,) may be asked about, even without evidence that the option can start


def choose_start_state(
    strategy: str,
    domain: Domain,
    option: LearnedOption | None,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
    drawn: Sample | None = None,
    others: Sequence[Option] = (),
) -> Any:
    """
    Choose the start state of the next demonstration.

    :param strategy: one of ``STRATEGIES``.
    :param option: option learned from the demonstrations; None: not learned yet.
    :param demonstrations: all of this participant and option, including "not here" answers.
    :param drawn: result of ``draw_sample`` with the same ``rng``; None: not called.
    :param others: other options of this participant, in the order of teaching.
    :raises UnknownStrategyError: the strategy is unknown.
    """
    if strategy not in STRATEGIES:
        raise UnknownStrategyError(
            f'unknown start-state strategy {strategy!r}; choose from {", ".join(STRATEGIES)}'
        )
    if not any(demo.kind is Kind.TRAJECTORY for demo in demonstrations):
        option = None  # learned from other demonstrations, such as those of an old option file
    replayed = isinstance(domain, ReplayedDomain)
    if replayed and drawn is None:
        drawn = draw_sample(strategy, domain, demonstrations, rng, others)
    if strategy == 'failures' and option is not None:
        state = _failing_state(domain, option, demonstrations, rng, drawn)
        if state is not None:
            return state
        drawn = drawn if replayed else None  # a different sample
    if not replayed and (strategy == 'random' or not demonstrations):
        return domain.sample_states(rng, 1)[0]
    if drawn is None:
        drawn = possible_starts(domain, rng, others)
    states = drawn.states
    if option is not None:
        rows = feature_rows(domain, states)
        kept = option.can_start(rows) | (uncertain(option, rows, demonstrations) & drawn.askable)
        states = [state for state, keep in zip(states, kept) if keep] or states
    if not demonstrations or (strategy == 'random' and option is not None):
        return states[0]
    return _farthest(domain, states, demonstrations, rng)


def draw_sample(
    strategy: str,
    domain: Domain,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
    others: Sequence[Option] = (),
) -> Sample | None:
    """
    Draw the sample for ``choose_start_state`` in advance; it does not depend on the option.

    :param others: as in ``choose_start_state``.
    :return: the sample; None: the strategy does not use one.
    """
    replayed = isinstance(domain, ReplayedDomain)
    if not replayed and (strategy == 'random' or is_enumerable(domain) or not demonstrations):
        return None
    return possible_starts(domain, rng, others)


def possible_starts(
    domain: Domain, rng: np.random.Generator, others: Sequence[Option] = ()
) -> Sample:
    """
    Draw states in which an option might start.

    :param others: as in ``choose_start_state``.
    """
    if isinstance(domain, ReplayedDomain):
        return _reached(domain, others, rng)
    if not is_enumerable(domain):
        return _random_sample(domain, rng)
    states = _states(domain, reachable(domain) & ~domain.over(), rng)
    return Sample(states, np.ones(len(states), dtype=np.bool_))


def _random_sample(domain: Domain, rng: np.random.Generator) -> Sample:
    return Sample(domain.sample_states(rng, SAMPLE), np.ones(SAMPLE, dtype=np.bool_))


@dataclass(frozen=True)
class AnyStartable(Policy[SeenRows]):
    """Chooses uniformly among the options that can start; a game ends where none can."""

    rng: np.random.Generator

    def choose(self, seen: SeenRows, games: Ints) -> Ints:
        if not seen.options:
            return np.full(len(games), NONE)
        can = seen.startable
        return np.where(can.any(axis=1), draw_among(can, self.rng), NONE)


def _reached(domain: Domain, others: Sequence[Option], rng: np.random.Generator) -> Sample:
    """
    Play games with randomly chosen options, and return the states in which a choice was due.

    States in which no option can start come first, since another option is needed there; then
    those in which an option ended, and then the starts of the task.
    """
    reached: list[list[Any]] = [[], [], []]

    def on_step(step: int, execution: Execution[SeenRows], seen: SeenRows, games: Games) -> None:
        states = games.states()
        for game in execution.decided.tolist():
            kind = 2 if step == 0 else 1 - int(execution.option[game] == NONE)
            reached[kind].append(states[game])

    games, policy = new_games(domain, GAMES, rng), AnyStartable(rng)
    steps, loops = min(domain.max_steps or STEPS, STEPS), loops_of(domain, others, GAMES, rng)
    play(games, RowOptions(others), policy, rng, steps, loops=loops, on_step=on_step)
    states = [kind[at] for kind in reached for at in rng.permutation(len(kind))]
    askable = np.arange(len(states)) < len(reached[0] or states)
    return Sample(states, askable)


def _failing_state(
    domain: Domain,
    option: LearnedOption,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
    drawn: Sample | None,
) -> Any:
    """
    Return a state from which the option fails; None: no such state.

    In a deterministic domain, return an instructive state, even if the option does not fail there.
    """
    if not is_deterministic(domain):
        some = sample_failures(option, domain, demonstrations, rng, drawn)
        stuck_first = isinstance(domain, ReplayedDomain) and bool(some.stuck.any())
        failing = np.flatnonzero(some.stuck if stuck_first else some.failing)
        return some.states[int(rng.choice(failing))] if failing.size else None
    found = find_failures(option, domain, demonstrations)
    if found.doubt.any() and not found.stuck.any():
        return _farthest(domain, _states(domain, found.doubt, rng), demonstrations, rng)
    if found.candidate.any():
        return domain.state_at(_instructive_state(domain, found, rng))
    return None


def _instructive_state(domain: EnumerableDomain, found: Failures, rng: np.random.Generator) -> int:
    """
    Return the state from which a demonstration teaches the most.

    Stuck states come first, then detours. If nothing fails, return the state with paths through
    the least demonstrated states, so that nothing relies on a single demonstration. States with
    an unconfirmed end come first.
    """
    lost = found.stuck & (found.distance < 0) & (found.times_shown == 0)
    if lost.any():  # no path to a demonstrated end
        return int(rng.choice(np.flatnonzero(lost)))
    among = found.stuck if found.stuck.any() else found.detour
    weight = np.where(found.times_shown == 0, 1.0, SHOWN_WEIGHT) * among
    if not among.any():
        among = found.unconfirmed if found.unconfirmed.any() else found.candidate
        weight = among / (1.0 + found.times_shown) ** 2
    # Sum the weights along shortest paths, averaged over equally short ones.
    successor = domain.transitions().successor[:, :, 0]
    for steps in range(2, int(found.distance.max()) + 1):
        at = np.flatnonzero(found.distance == steps)
        nearer = found.nearer[at]
        weight[at] += (weight[successor[at]] * nearer).sum(axis=1) / nearer.sum(axis=1)
    states = np.flatnonzero(among)
    return int(states[_best(weight[states], rng)])


def _farthest(
    domain: Domain,
    states: Sequence[Any],
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
) -> Any:
    """
    Return the state that differs most, in the chosen features, from every demonstrated state.

    Ordinal and continuous features differ by 0..1; nominal ones by 0 or 1, split equally between
    two encoded features.
    """
    visited = np.unique(np.concatenate([demo.feature_rows for demo in demonstrations]), axis=0)
    chosen = shown(demonstrations)[-1].chosen_features
    distance = _differences(domain, chosen, feature_rows(domain, states), visited)
    return states[_best(distance.min(axis=1), rng)]


def _differences(domain: Domain, chosen: Sequence[str], here: Rows, there: Rows) -> Floats:
    """Return (N, M): the differences between rows (N, F) and (M, F) in chosen features."""
    encoding = feature_encoding(domain, chosen)
    spans = {each.feature.name: each.feature.span for each in feature_columns(domain, chosen)}
    scale = [0.5 if each.value is not None else 1 / spans[each.feature] for each in encoding]
    found = np.zeros((len(here), len(there)))
    for ours, theirs in zip(*((encode_rows(encoding, r) * scale).T for r in (here, there))):
        found += np.abs(np.subtract.outer(ours, theirs))
    return found


def sort_stuck(
    domain: Domain,
    stuck: Sequence[tuple[str, Any]],
    taught: Mapping[str, Sequence[Demonstration]],
    planned: Collection[str],
) -> dict[str, list[Any]]:
    """
    Group the states in which a plan got stuck by the option to demonstrate there.

    This is the option that ran. If none could start, or the person answered "not here" for it, it
    is the option with the most similar demonstrated start. States that look like those of a
    demonstration made after the plan are omitted.

    :param stuck: pairs of the option that ran (empty: none) and the state.
    :param taught: demonstrations of each option.
    :param planned: uuids of the demonstrations from which the options of the plan were learned.
    :return: the states of each option; options with the most states, and states with the most
        common look, come first.
    """
    shown = {
        name: [demo for demo in demos if demo.kind is Kind.TRAJECTORY]
        for name, demos in taught.items()
    }
    refused = {
        (name, demo.states[0])
        for name, demos in taught.items()
        for demo in demos
        if demo.kind is Kind.NOT_HERE
    }
    looks: dict[str, dict[bytes, list[Any]]] = {}
    for name, state in stuck:
        text, row = domain.encode(state), feature_rows(domain, [state])
        open_to = [each for each, demos in shown.items() if demos and (each, text) not in refused]
        if not open_to:
            continue
        if name not in open_to:
            name = min(open_to, key=lambda each: _from_starts(domain, row, shown[each]))
        chosen = feature_columns(domain, shown[name][-1].chosen_features)
        since = [demo.feature_rows for demo in shown[name] if demo.uuid not in planned]
        rows = np.concatenate([row, *since])
        values = np.stack([column.values(rows) for column in chosen], axis=1)
        if not (values[1:] == values[0]).all(axis=1).any():
            looks.setdefault(name, {}).setdefault(values[0].tobytes(), []).append(state)
    found = {
        name: list(chain(*sorted(groups.values(), key=len, reverse=True)))
        for name, groups in looks.items()
    }
    return dict(sorted(found.items(), key=lambda each: len(each[1]), reverse=True))


def _from_starts(domain: Domain, row: Rows, demos: Sequence[Demonstration]) -> float:
    """Return the mean difference per chosen feature between a row (1, F) and the nearest start."""
    chosen = demos[-1].chosen_features
    starts = np.stack([demo.feature_rows[0] for demo in demos])
    return float(_differences(domain, chosen, row, starts).min()) / len(chosen)


def _states(domain: EnumerableDomain, chosen: Flags, rng: np.random.Generator) -> list[Any]:
    """Return a sample of at most ``SAMPLE`` of the selected states (S,)."""
    some = rng.permutation(np.flatnonzero(chosen))[:SAMPLE]
    return [domain.state_at(int(index)) for index in some]


def _best(score: Floats, rng: np.random.Generator) -> int:
    """Return the index of the highest score, with random tie-breaking."""
    return int(rng.choice(np.flatnonzero(score >= score.max() - 1e-9)))


@dataclass(frozen=True)
class SampledFailures:
    """The outcome of running an option from a sample of states."""

    states: list[Any]  # (N,); in a replayed domain, the end of a stuck run replaces its start
    member: Flags  # (N,) in the learned I
    stuck: Flags  # (N,) the run from there reaches no end, or does so less often than possible
    failing: Flags  # (N,) stuck, in doubt, or the committee disagrees

    @property
    def share(self) -> float:
        """Share of failing states among those where the option can start or fails."""
        return float(self.failing.sum() / max(1, (self.member | self.failing).sum()))


def sample_failures(
    option: LearnedOption,
    domain: Domain,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
    drawn: Sample | None = None,
    others: Sequence[Option] = (),
) -> SampledFailures:
    """
    Evaluate a sample of states, and run the option from ``RUNS`` of those where it can start.

    :param demonstrations: demonstrations from which the option was learned.
    :param drawn: sample already drawn from ``rng``; None: draw one.
    :param others: as in ``choose_start_state``.
    """
    replayed = isinstance(domain, ReplayedDomain)
    if drawn is None:
        drawn = _reached(domain, others, rng) if replayed else _random_sample(domain, rng)
    states, stuck = list(drawn.states), np.zeros(len(drawn.states), dtype=np.bool_)
    rows = feature_rows(domain, states)
    member = option.can_start(rows)
    failing = uncertain(option, rows, demonstrations) & drawn.askable
    failing |= committee_disagrees(option, domain, demonstrations, rows, int(rng.integers(2**31)))
    some = np.flatnonzero(member)[:RUNS]
    starts = [states[at] for at in some]
    if replayed:
        ends = KnownEnds(domain, option.features, demonstrations)
        for at, state in zip(some.tolist(), _where_stuck(option, domain, starts, ends)):
            stuck[at] = state is not None
            states[at] = states[at] if state is None else state
    elif is_enumerable(domain):
        known = successes_by_chance(option, domain, demonstrations)
        at = [domain.index(state) for state in states]
        stuck = (known.candidate & ~known.possible)[at]
    else:
        stuck[some] = ~rollouts(option, domain, starts, int(rng.integers(2**31))).reached
    return SampledFailures(states, member, stuck, failing | stuck)


def _where_stuck(
    option: LearnedOption, domain: Domain, starts: Sequence[Any], ends: KnownEnds
) -> list[Any]:
    """
    Run an option once from each of N states of a replayed domain.

    :return: (N,) for a run without an end, the state in which it first leaves I, or else its last
        state; for a run with an end unlike the demonstrated ones, its start; otherwise None.
    """
    left: dict[int, Any] = {}
    last = list(starts)

    def on_step(step: int, execution: Execution[SeenRows], seen: SeenRows, games: Games) -> None:
        states = games.states()
        for at, game in enumerate(execution.games.tolist()):
            last[game] = states[at]
            if not seen.startable[at, 0]:
                left.setdefault(game, states[at])

    count, rng = len(starts), np.random.default_rng(0)  # unused: a seed determines each game
    games = games_at(domain, starts)
    final = games.features()
    played = play(
        games,
        RowOptions([option]),
        Fixed(np.zeros(count, dtype=np.intp)),
        rng,
        option.max_steps,
        once=True,
        loops=loops_of(domain, [option], count, None),
        on_step=on_step,
        final=final,
    )
    ran = Rollouts.of(played, final)
    right = ends.like_shown(final, ran.over, ran.last_reward)
    stuck = [left.get(n, last[n]) for n in range(count)]
    ended = [None if right[n] else starts[n] for n in range(count)]
    return [ended[n] if reached else stuck[n] for n, reached in enumerate(ran.reached)]


def committee_disagrees(
    option: LearnedOption,
    domain: ActableDomain,
    demonstrations: Sequence[Demonstration],
    rows: Rows,
    seed: int,
) -> Flags:
    """
    Return (N,): whether a tenth of the demonstrations decides the behaviour in rows (N, F).

    Query by committee (Seung, Opper and Sompolinsky 1992): the option is relearned without each of
    ten folds. If a relearned option differs in I, or in the action inside I, there are too few
    demonstrations, or a slip has too much weight. With one trajectory, the committee disagrees
    everywhere in I.
    """
    inside, action = option.can_start(rows), option.action(rows)
    data = make_dataset(demonstrations, domain)
    if len(data.trajectories) < 2:
        return inside
    found = np.zeros(len(rows), dtype=np.bool_)
    for other in fit_leave_fold_out(data, fold_of(data, seed), domain, seed):
        found |= other.can_start(rows) != inside
        found |= inside & (other.action(rows) != action)
    return found


def nothing_fails(
    option: LearnedOption,
    domain: Domain,
    demonstrations: Sequence[Demonstration],
    rng: np.random.Generator,
    others: Sequence[Option] = (),
) -> bool:
    """
    Return whether the option fails from no state, or only from a few states of a sample.

    :param rng: generator for the sample, if the option cannot be run from all states.
    :param others: as in ``choose_start_state``.
    """
    if is_deterministic(domain):
        return not find_failures(option, domain, demonstrations).failing.any()
    some = sample_failures(option, domain, demonstrations, rng, others=others)
    return some.share <= TOLERATED


def fresh_starts(
    option: LearnedOption,
    domain: Domain,
    seed: int,
    rng: np.random.Generator,
    others: Sequence[Option] = (),
) -> Iterator[list[Any]]:
    """
    Yield groups of starts of an option, drawn the way its task draws them.

    :param seed: seed of states that can be sampled; samples are cached, because drawing is slow.
    :param rng: generator for the games that lead to states in a replayed domain.
    :param others: as in ``choose_start_state``.
    :return: states in I, in at most ``DRAWS`` groups.
    """
    for number in range(DRAWS):
        if isinstance(domain, ReplayedDomain):
            states = _reached(domain, others, rng).states
            rows = feature_rows(domain, states)
        else:
            states, rows = _fresh_sample(KeyedDomain.of(domain), seed, number)
        yield [*compress(states, option.can_start(rows))]


@lru_cache(maxsize=DRAWS)
def _fresh_sample(domain: KeyedDomain, seed: int, number: int) -> tuple[list[Any], Rows]:
    """Return states, and their features (N, F)."""
    sample = _random_sample(domain.value, generator(seed, 'fresh starts', number))
    return sample.states, feature_rows(domain.value, sample.states)
