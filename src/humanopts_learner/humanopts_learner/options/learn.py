"""
Learning an option from demonstrations (paper, section 6).

Examples of I are positive in visited states, negative in "not here" states, and negative in end
states unless the person says that the option could start again there. Examples of beta are
positive in end states and in "not here" states, because an option may continue only where it could
start (Sutton, Precup and Singh 1999, section 2), and negative in the other states of a trajectory.

A replayed domain has many states. If an option always ended with the task over there, it needs no
other end. Its last states are then not examples, so that similar states do not count as ends.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.domains.base import ActableDomain, action_index, FeatureKind, is_enumerable
from humanopts_env.domains.described import can_simulate
from humanopts_env.domains.formulas import feature_columns, FeatureColumn, stacked
from humanopts_env.domains.registry import parameters_json
from humanopts_env.domains.replayed_domain import ReplayedDomain
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import (
    Demonstration,
    FOREST,
    GOAL,
    group_by_option,
    Kind,
    shown,
    TREES,
    without_idle_steps,
)
from humanopts_learner.execution import looks_of
from humanopts_learner.options.decision_tree import (
    encode_rows,
    EncodedFeature,
    feature_encoding,
    fit_tree,
    Tree,
)
from humanopts_learner.options.goal import paths_to_goal, preferred_actions
from humanopts_learner.options.learned_option import LearnedOption, MEMBER, MEMBERSHIP
import numpy as np
from numpy.typing import NDArray

MAX_STEPS = 200  # per option run, if the domain has no step limit
FOLDS = 10
N_TREES = 30  # trees in a forest
LEAF_SIZE = 5  # minimum on a robot, where sensor values separate any two rows, and thus slips
SLIP_GAIN = 2.0  # minimum gain of a split of pi on a robot; a single deviation adds less than 2


class NotLearnableError(ValueError):
    """Not enough demonstrations to learn from; the message says what is missing."""


@dataclass(frozen=True)
class Examples:
    """Labelled rows of all features, with their source demonstrations."""

    rows: Rows  # (N, F)
    labels: NDArray[np.int64]  # (N,)
    source: NDArray[np.int64]  # (N,) index of the demonstration

    @classmethod
    def of(cls, labelled: Iterable[tuple[Rows, Sequence[int]]]) -> 'Examples':
        """Concatenate the labelled rows of each demonstration."""
        rows, labels = zip(*labelled)
        source = np.repeat(np.arange(len(labels)), [len(each) for each in labels])
        return cls(np.concatenate(rows), np.concatenate(labels).astype(np.int64), source)


@dataclass(frozen=True)
class Dataset:
    """The demonstrations and examples of one option of one participant."""

    demonstrations: tuple[Demonstration, ...]  # (D,) distinct, sorted by number
    actions: tuple[str, ...]  # all of the domain
    chosen: tuple[FeatureColumn, ...]  # features chosen with the newest demonstration
    encoding: tuple[EncodedFeature, ...]  # encoding of these features
    method: str = TREES  # chosen with the newest demonstration
    min_leaf: int = 1  # smallest number of examples in a leaf of pi and beta
    ends_with_task: bool = False  # only then: states in which the task is over are not examples

    @property
    def features(self) -> tuple[str, ...]:
        """The names of the chosen features."""
        return tuple(column.feature.name for column in self.chosen)

    @property
    def trajectories(self) -> list[Demonstration]:
        """The demonstrations with steps, without "not here" answers."""
        return [demo for demo in self.demonstrations if demo.kind is Kind.TRAJECTORY]

    def of(self, chosen: Flags) -> 'Dataset':
        """
        Return the data set of selected demonstrations (D,), with unchanged features.

        Labels that depend on several demonstrations then depend only on the selected ones.
        """
        return replace(self, demonstrations=tuple(compress(self.demonstrations, chosen)))

    @cached_property
    def policy(self) -> Examples:
        """The demonstrated actions."""
        index = {name: number for number, name in enumerate(self.actions)}
        return Examples.of(
            (demo.feature_rows[: len(demo.actions)], [index[name] for name in demo.actions])
            for demo in self.demonstrations
        )

    @cached_property
    def initiation(self) -> Examples:
        """
        Visited states, labelled as members of I or not.

        If the option can start again at its end, ends where the task is over are not examples,
        because the person is not asked there.
        """
        again, labelled = any(demo.can_start_at_end for demo in self.demonstrations), []
        for demo in self.demonstrations:
            member_at_end = demo.kind is Kind.TRAJECTORY and demo.can_start_at_end
            labels = [MEMBER] * len(demo.actions) + [int(member_at_end)]
            asked = len(labels) - ((again or self.ends_with_task) and demo.terminated)
            labelled.append((demo.feature_rows[:asked], labels[:asked]))
        return Examples.of(labelled)

    @cached_property
    def termination(self) -> Examples:
        """
        Visited states, labelled as ends or not.

        Termination is checked only after a step, so a start is not an example against an end with
        equal chosen features. If the option can start where it ends, a start with a nominal value
        that otherwise only ends have is not an example, either. The last state is repeated to fill
        a leaf, as if the person had stayed there, so that a single end makes a leaf.
        """
        labelled = []

        def seen(part: slice) -> Floats:
            rows = [demo.feature_rows[part] for demo in self.trajectories]
            return stacked(self.chosen, np.concatenate(rows))

        ends, between = seen(slice(-1, None)), seen(slice(1, -1))
        again = any(demo.can_start_at_end for demo in self.trajectories)
        nominal = [column.feature.kind is FeatureKind.NOMINAL for column in self.chosen]
        for demo in self.demonstrations:
            start = stacked(self.chosen, demo.feature_rows[:1])
            same, elsewhere = ends == start, between == start
            only = same.any(axis=0) & ~elsewhere.any(axis=0) & nominal
            may_be_end = same.all(axis=1).any() or (again and only.any())
            labels = [0] * len(demo.actions) + [MEMBER]
            first = int(may_be_end and len(labels) > 1)
            asked = len(labels) - (self.ends_with_task and demo.terminated)
            at = np.arange(len(labels))[first:asked]
            at = np.append(at, at[-1:].repeat(self.min_leaf - 1))
            labelled.append((demo.feature_rows[at], np.array(labels)[at].tolist()))
        return Examples.of(labelled)


def make_dataset(demonstrations: Sequence[Demonstration], domain: ActableDomain) -> Dataset:
    """
    Collect the examples of one option.

    :param demonstrations: checked demonstrations of one participant and option; their order and
        duplicates do not matter, and judged runs are ignored.
    :raises NotLearnableError: there is no trajectory, or there are several options or people.
    :raises DomainError: a chosen feature or an action is not in the domain.
    """
    groups = group_by_option(shown(demonstrations))
    if len(groups) > 1:
        raise NotLearnableError(
            'demonstrations of several options or people: '
            + ', '.join(f'{option} by {person}' for person, option in groups)
        )
    demos = next(iter(groups.values()), [])
    if not any(demo.kind is Kind.TRAJECTORY for demo in demos):
        raise NotLearnableError(
            f'{len(demos)} "not here" and no demonstration yet: show the option at least once'
        )
    for name in {name for demo in demos for name in demo.actions}:
        action_index(domain, name)
    newest = demos[-1]
    chosen = feature_columns(domain, newest.chosen_features)
    sensed = any(column.feature.kind is FeatureKind.CONTINUOUS for column in chosen)
    return Dataset(
        tuple(without_idle_steps(demo, domain, chosen) for demo in demos),
        tuple(action.name for action in domain.actions),
        tuple(chosen),
        feature_encoding(domain, newest.chosen_features),
        newest.method,
        LEAF_SIZE if sensed and not can_simulate(domain) else 1,
        isinstance(domain, ReplayedDomain)
        and all(demo.terminated for demo in demos if demo.kind is Kind.TRAJECTORY),
    )


def learn_option(
    demonstrations: Sequence[Demonstration], domain: ActableDomain, seed: int
) -> LearnedOption:
    """
    Learn an option; the order of the demonstrations does not matter.

    :param demonstrations: checked demonstrations of one participant and option.
    :raises NotLearnableError: as ``make_dataset``.
    """
    return fit_option(make_dataset(demonstrations, domain), domain, seed)


def fit_option(data: Dataset, domain: ActableDomain, seed: int) -> LearnedOption:
    """
    Learn an option from a data set with one or more trajectories.

    All three trees, or forests, are fitted to the examples; with the method ``goal``, the policy
    tree is fitted to planned actions.
    """
    first, trajectories = data.demonstrations[0], len(data.trajectories)
    option = LearnedOption(
        name=first.option_name,
        participant=first.participant,
        domain=domain.name,
        domain_parameters=parameters_json(domain),
        actions=data.actions,
        features=data.features,
        encoding=data.encoding,
        policy=_fit(data, data.policy, range(len(domain.actions)), seed),
        initiation=_fit(data, data.initiation, MEMBERSHIP, seed),
        termination=_fit(data, data.termination, MEMBERSHIP, seed),
        n_demonstrations=trajectories,
        n_not_here=len(data.demonstrations) - trajectories,
        max_steps=domain.max_steps or MAX_STEPS,
        uuids=tuple(demo.uuid for demo in data.demonstrations),
        method=data.method,
        most_visits=_most_visits(data, domain) if isinstance(domain, ReplayedDomain) else 0,
    )
    return option if data.method != GOAL else _with_planned_policy(option, data, domain)


def _most_visits(data: Dataset, domain: ActableDomain) -> int:
    """Return the maximum number of rows that look the same in one demonstration."""
    return max(
        max(Counter(looks_of(demo.feature_rows, domain)).values()) for demo in data.trajectories
    )


def _with_planned_policy(
    option: LearnedOption, data: Dataset, domain: ActableDomain
) -> LearnedOption:
    """
    Return the option with a policy planned to reach an end like the demonstrated ones.

    The policy tree uses all features, because it is not learned, but stores the planned actions.
    """
    assert is_enumerable(domain)  # ``check_method``
    rows, chosen = domain.feature_table(), data.chosen
    paths = paths_to_goal(domain, data.trajectories, chosen, option.ends(rows))
    actions = preferred_actions(domain, data.trajectories, chosen, paths)
    known = paths.value > 0
    if not known.any():  # the chosen features do not distinguish the demonstrated ends
        known = ~known
    encoding = feature_encoding(domain, [feature.name for feature in domain.features])
    X = encode_rows(encoding, rows[known])
    policy = fit_tree(X, actions[known], range(len(domain.actions)), 0)
    return replace(option, policy=policy, policy_encoding=encoding)


def _fit(data: Dataset, examples: Examples, classes: Sequence[int], seed: int) -> Tree:
    """Fit one of the three parts to its examples, with reproducible tie-breaking per option."""
    demo = data.demonstrations[0]
    rng = generator(seed, 'tree', demo.participant, demo.option_name)
    X = encode_rows(data.encoding, examples.rows)
    return fit_tree(
        X,
        examples.labels,
        classes,
        int(rng.integers(2**31)),
        n_trees=N_TREES if data.method == FOREST else 1,
        min_leaf=1 if examples is data.initiation else data.min_leaf,
        min_gain=SLIP_GAIN if examples is data.policy and data.min_leaf > 1 else 0.0,
    )


def fold_of(data: Dataset, seed: int) -> Ints:
    """
    Return (D,): the fold of each demonstration, with ten folds or one per demonstration.

    Demonstrations are ranked by draws keyed by seed, option and uuid, and dealt out in that order,
    separately for trajectories and "not here" answers, so fold sizes differ by at most one.
    """
    demos = data.demonstrations
    draws = np.array(
        [generator(seed, 'fold', demo.option_name, demo.uuid).random() for demo in demos]
    )
    not_here = np.array([demo.kind is Kind.NOT_HERE for demo in demos])
    folds = np.empty(len(demos), dtype=np.int64)
    folds[np.lexsort((draws, not_here))] = np.arange(len(demos)) % FOLDS
    return folds


def fit_leave_fold_out(
    data: Dataset, folds: Ints, domain: ActableDomain, seed: int
) -> list[LearnedOption]:
    """Return the options learned without fold 0, 1, ...; requires two or more trajectories."""
    return [fit_option(data.of(folds != fold), domain, seed) for fold in range(folds.max() + 1)]
