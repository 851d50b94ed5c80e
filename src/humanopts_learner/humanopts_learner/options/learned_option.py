"""A learned option: its policy, initiation set and termination condition as decision trees."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from humanopts_env.arrays import Flags, Floats, Ints, Rows
from humanopts_env.domains.base import ActableDomain, Domain, DomainError, EnumerableDomain
from humanopts_env.domains.reference import ReferenceOption, TabularReferenceOption
from humanopts_env.domains.registry import parameters_json
from humanopts_env.games import Games, TableGames
from humanopts_learner.demonstrations import Count, METHODS, Text, TREES
from humanopts_learner.execution import draw_among, Loops
from humanopts_learner.option import Option
from humanopts_learner.options.decision_tree import (
    encode_rows,
    EncodedFeature,
    Encoder,
    feature_encoding,
    fit_tree,
    Tree,
)
import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict

HALF = 0.5  # minimum probability of membership in I, and of termination
MEMBER = 1  # class of I and beta
MEMBERSHIP = (0, MEMBER)
REFERENCE = 'reference'  # participant of options made from reference options
REFERENCE_MAX_STEPS = 200


class OptionError(ValueError):
    """An option cannot be used; the message says why."""


@dataclass(frozen=True)
class LearnedOption:
    """
    An option learned from one participant; rows contain all F features of its domain.

    It has three decision trees over the features that the person chose (paper, section 6). An
    automatic option has the same form, but no demonstrations.
    """

    __pydantic_config__ = ConfigDict(arbitrary_types_allowed=True, extra='forbid')

    name: Text
    participant: Text
    domain: Text  # registered name
    domain_parameters: Text  # JSON object, keys sorted
    actions: tuple[Text, ...]  # indexed by the classes of the policy
    features: tuple[Text, ...]  # chosen, in the domain's order
    encoding: tuple[EncodedFeature, ...]  # inputs of the trees
    policy: Tree
    initiation: Tree
    termination: Tree
    n_demonstrations: Count  # number of training trajectories
    n_not_here: Count
    max_steps: Count
    uuids: tuple[Text, ...]  # training demonstrations and "not here" answers
    method: Text = TREES  # learning method, one of METHODS
    policy_encoding: tuple[EncodedFeature, ...] = ()  # for the policy; empty: as for I and beta
    most_visits: Count = 0  # largest number of equal-looking rows in a demonstration; 0: unchecked

    def __post_init__(self) -> None:
        """Check that the trees fit the actions and the features."""
        if not self.policy_encoding:
            object.__setattr__(self, 'policy_encoding', self.encoding)
        if self.method not in METHODS:
            raise OptionError(f'{self.name!r} was learned by the unknown method {self.method!r}')
        if self.policy.classes != tuple(range(len(self.actions))):
            raise OptionError(f'the policy of {self.name!r} does not choose among its actions')
        trees = {'policy': self.policy, 'I': self.initiation, 'beta': self.termination}
        for part, tree in trees.items():
            encoding = self.policy_encoding if part == 'policy' else self.encoding
            if tree.n_features != len(encoding):
                raise OptionError(f'the tree of {part} of {self.name!r} has other features')
            if part != 'policy' and tree.classes != MEMBERSHIP:
                raise OptionError(f'the tree of {part} of {self.name!r} is not yes or no')
        if self.max_steps < 1:
            raise OptionError(f'{self.name!r} has max_steps {self.max_steps}, not 1 or more')

    def check_domain(self, domain: ActableDomain) -> None:
        """
        Check that the option was learned in this domain.

        :raises OptionError: the domain, or its parameters, features or actions differ.
        """
        if (self.domain, self.domain_parameters) != (domain.name, parameters_json(domain)):
            raise OptionError(
                f'{self.name!r} was learned in {self.domain} {self.domain_parameters}, and the '
                f'game is {domain.name} {parameters_json(domain)}'
            )
        try:
            known = [
                feature_encoding(domain, [encoded.feature for encoded in encoding])
                for encoding in (self.encoding, self.policy_encoding)
            ]
        except DomainError as error:
            raise OptionError(f'{self.name!r} cannot be used: {error}') from error
        names = tuple(action.name for action in domain.actions)
        if [self.encoding, self.policy_encoding] != known or self.actions != names:
            raise OptionError(
                f'the features or actions of {self.name!r} are not those of the game'
            )

    @cached_property
    def _for_policy(self) -> Encoder:
        return Encoder(self.policy_encoding, self.policy.tested)

    @cached_property
    def _for_initiation(self) -> Encoder:
        return Encoder(self.encoding, self.initiation.tested)

    @cached_property
    def _for_termination(self) -> Encoder:
        return Encoder(self.encoding, self.termination.tested)

    def action_probabilities(self, rows: Rows) -> Floats:
        """Return (N, A): pi of every action in each of the N states."""
        return self.policy.probabilities(self._for_policy(rows))

    def initiation_probability(self, rows: Rows) -> Floats:
        """Return (N,): the share of members of I among the examples in each state's leaf."""
        return self.initiation.probability_of(MEMBER, self._for_initiation(rows))

    def termination_probability(self, rows: Rows) -> Floats:
        """Return (N,): beta of each state."""
        return self.termination.probability_of(MEMBER, self._for_termination(rows))

    def action(self, rows: Rows) -> Ints:
        """Return (N,): the most likely action; on ties, the lowest index."""
        return self.policy.most_probable(self._for_policy(rows))

    def can_start(self, rows: Rows) -> Flags:
        """Return (N,): whether each state is in the initiation set."""
        return self.initiation_probability(rows) >= HALF

    def ends(self, rows: Rows) -> Flags:
        """Return (N,): whether the option ends in each state; ignored before its first step."""
        return self.termination_probability(rows) >= HALF


def loops_of(
    domain: ActableDomain,
    options: Sequence[Option],
    count: int,
    rng: np.random.Generator | None,
    n_actions: int = 0,
) -> Loops | None:
    """
    Return a detector of runs that repeat themselves.

    :param options: options by index.
    :param count: number of games.
    :param rng: as in ``Loops``.
    :param n_actions: number of primitive actions, which follow the options.
    :return: the detector; None: no option was taught in a domain where runs are checked.
    """
    most = [each.most_visits if isinstance(each, LearnedOption) else 0 for each in options]
    return Loops(domain, np.array(most + [0] * n_actions), count, rng) if any(most) else None


@dataclass(frozen=True, eq=False)
class TabularOption:
    """An option, in greedy mode, as arrays over the S states of a domain or a search space."""

    name: str
    max_steps: int
    action: Ints  # (S,)
    initiation: Flags  # (S,)
    termination: Flags  # (S,)

    @classmethod
    def of_reference(
        cls, reference: TabularReferenceOption, max_steps: int = REFERENCE_MAX_STEPS
    ) -> 'TabularOption':
        """Return a reference option, with the first of several optimal actions."""
        action = reference.optimal.argmax(axis=1)
        return cls(reference.name, max_steps, action, reference.initiation, reference.termination)


def tabulate(option: Option | TabularOption, domain: EnumerableDomain) -> TabularOption:
    """
    Evaluate an option in every state of its domain; a tabular option is returned unchanged.

    :raises OptionError: the option was learned in another domain, or as ``decisions``.
    """
    if isinstance(option, TabularOption):
        return option
    if isinstance(option, LearnedOption):
        option.check_domain(domain)
    initiation, action, termination = decisions(option, domain.feature_table(), domain)
    return TabularOption(option.name, option.max_steps, action, initiation, termination)


def decisions(option: Option, rows: Rows, domain: ActableDomain) -> tuple[Flags, Ints, Flags]:
    """
    Return (N,) each: whether an option can start, its action, and whether it ends.

    :raises OptionError: the option returns invalid arrays.
    """
    given = option.can_start(rows), option.action(rows), option.ends(rows)
    found: list[NDArray[Any]] = [np.asarray(each) for each in given]
    kinds = ('b', 'bools'), ('iu', 'integers'), ('b', 'bools')
    for name, each, (kind, needed) in zip(('can_start', 'action', 'ends'), found, kinds):
        if each.shape != (len(rows),) or each.dtype.kind not in kind:
            raise OptionError(
                f'{name} of option {option.name!r} must return an array of {len(rows)} {needed}, '
                'one for each row'
            )
    (can_start, action, ends), last = found, len(domain.actions) - 1
    if len(rows) and not 0 <= action.min() <= action.max() <= last:
        wrong = action[(action < 0) | (action > last)][0]
        raise OptionError(f'option {option.name!r} takes action {wrong}; they are 0 to {last}')
    return can_start, action, ends


class OptionTable:
    """
    O options over the S states of a domain.

    :ivar options: (O,) options.
    :ivar names: (O,) names.
    :ivar action: (O, S) primitive action.
    :ivar ends: (O, S) whether the option ends in the state, after one or more steps.
    :ivar available: (S, O) whether the option can be chosen.
    :ivar limits: (O,) maximum number of steps per run.
    """

    def __init__(self, options: Sequence[TabularOption], over: Flags | None = None) -> None:
        """
        Combine options in one table.

        :param over: (S,) whether the task is over, so that no option can be chosen.
        """
        self.options = tuple(options)
        self.names = tuple(option.name for option in options)
        self.action = np.array([option.action for option in options], dtype=np.intp)
        self.ends = np.array([option.termination for option in options])
        can_start = np.array([option.initiation for option in options])
        self.available = (can_start if over is None else can_start & ~over).T.copy()
        self.limits = np.array([option.max_steps for option in options], dtype=np.intp)

    def see(self, games: Games) -> 'SeenStates':
        """Observe games with listed states."""
        assert isinstance(games, TableGames)
        return SeenStates(self, games.state)


@dataclass(frozen=True, slots=True)
class SeenStates:
    """The states of N games, with the decisions of options in them."""

    table: OptionTable
    states: Ints  # (N,) indices

    def take(self, games: Ints) -> 'SeenStates':
        return SeenStates(self.table, self.states.take(games))

    def at_random(self, rng: np.random.Generator) -> Ints:
        """Return (N,): a uniformly random available option."""
        return draw_among(self.table.available.take(self.states, axis=0), rng)

    def action(self, option: Ints) -> Ints:
        actions = self.table.action
        found: Ints = actions.take(option * actions.shape[1] + self.states)
        return found

    def ends(self, option: Ints) -> Flags:
        ends = self.table.ends
        found: Flags = ends.take(option * ends.shape[1] + self.states)
        return found


def options_from_references(
    domain: EnumerableDomain, references: Iterable[ReferenceOption]
) -> list[LearnedOption]:
    """
    Return reference options as learned options, without a teacher.

    If several actions are optimal, the first is used. Learning from people never uses these
    options.

    :param references: reference options of this domain, as in ``registry.reference_options``.
    :raises DomainError: a reference option has no arrays, or its features do not determine them.
    """
    found = []
    for reference in references:
        if not isinstance(reference, TabularReferenceOption):
            raise DomainError(f'{reference.name!r} of {domain.name} has no tables')
        table = TabularOption.of_reference(reference)
        known = reference.initiation, reference.judged & ~domain.over(), reference.judged
        rows = domain.feature_table()
        found.append(option_from_table(domain, table, reference.features, rows, known))
    return found


def option_from_table(
    domain: Domain,
    table: TabularOption,
    features: Sequence[str],
    rows: Rows,
    known: tuple[Flags, Flags, Flags] | None = None,
    participant: str = REFERENCE,
) -> LearnedOption:
    """
    Return an option with trees that agree with the arrays in every state.

    :param features: names of the features that the trees use.
    :param rows: (S, F) all features of the S states of the arrays.
    :param known: (S,) states in which the action, the initiation set and the termination condition
        are known; None: all.
    :raises DomainError: the features do not determine the values.
    """
    encoding = feature_encoding(domain, features)
    X = encode_rows(encoding, rows)
    in_action, in_initiation, in_termination = known or (np.ones(len(rows), dtype=np.bool_),) * 3

    def tree(states: Flags, values: NDArray[Any], classes: Sequence[int]) -> Tree:
        seen, labels = X[states], values[states].astype(np.intp)
        fitted = fit_tree(seen, labels, classes, 0)
        if (fitted.most_probable(seen) != labels).any():
            raise DomainError(f'the features of {domain.name} do not determine {table.name!r}')
        return fitted

    return LearnedOption(
        name=table.name,
        participant=participant,
        domain=domain.name,
        domain_parameters=parameters_json(domain),
        actions=tuple(action.name for action in domain.actions),
        features=tuple(features),
        encoding=encoding,
        policy=tree(in_action, table.action, range(len(domain.actions))),
        initiation=tree(in_initiation, table.initiation, MEMBERSHIP),
        termination=tree(in_termination, table.termination, MEMBERSHIP),
        n_demonstrations=0,
        n_not_here=0,
        max_steps=table.max_steps,
        uuids=(),
    )
