"""
Taxi on large grids, with two options that are optimal by construction.

With the paper's rewards a legal pickup costs nothing, so on large grids the best policy never
delivers: far from the destination it picks up and puts down for ever, at half the cost of
driving. Here a pickup costs 1 as every other step does, so the best policy delivers from every
state, and the two options of the paper lose nothing.
"""

from dataclasses import replace
from functools import cached_property
import importlib
import time

from humanopts_env.domains.base import Transitions
from humanopts_env.domains.reference import TabularReferenceOption
from humanopts_env.domains.registry import parameters_json
from humanopts_env.domains.tabular import read_only
from humanopts_env.domains.taxi import Taxi
from humanopts_env.domains.taxi_reference import reference_options
from humanopts_learner.options.decision_tree import encode_rows, feature_encoding, fit_tree, Tree
from humanopts_learner.options.option import LearnedOption, MEMBERSHIP, OptionTables
from humanopts_learner.planning.action_sets import TabledOption
import numpy as np
from numpy.typing import NDArray

OPTIONS = ('go to passenger and pickup', 'go to destination and dropoff')


class PricedTaxi(Taxi):
    """Taxi in which a legal pickup costs 1, as every step but the delivery does."""

    @cached_property
    def _transitions(self) -> Transitions:
        paper = super()._transitions
        reward = np.where(paper.reward == 0.0, -1.0, paper.reward)
        return replace(paper, reward=read_only(reward))


class TaxiCase:
    """A square grid and everything that its solvers are given, prepared once."""

    def __init__(self, side: int) -> None:
        """
        Prepare a grid.

        :raises DomainError: the side is not from 4 to 1000.
        """
        self.domain = PricedTaxi(side, side)
        self.domain.transitions(), self.domain.over(), self.domain.feature_table()
        began = time.perf_counter()
        references = reference_options(self.domain)
        self.optimal_seconds = time.perf_counter() - began  # for the shortest ways of all six
        self._references = [references[name] for name in OPTIONS]

    @cached_property
    def optimal(self) -> tuple[TabledOption, ...]:
        """The two options as tables of shortest ways."""
        return tuple(
            TabledOption(
                option.name,
                self.domain.n_states,
                OptionTables(option.optimal.argmax(axis=1), option.initiation, option.termination),
            )
            for option in self._references
        )

    @cached_property
    def learned(self) -> tuple[LearnedOption, ...]:
        """The two options as trees, fitted to what the shortest ways say in every state."""
        return self._fitted[0]

    @property
    def learned_seconds(self) -> float:
        """What the trees cost: the shortest ways, and fitting."""
        return self.optimal_seconds + self._fitted[1]

    @cached_property
    def _fitted(self) -> tuple[tuple[LearnedOption, ...], float]:
        importlib.import_module('sklearn.tree')  # which the first fit would, on the clock
        began = time.perf_counter()
        learned = tuple(self._learn(option) for option in self._references)
        return learned, time.perf_counter() - began

    def _learn(self, option: TabularReferenceOption) -> LearnedOption:
        domain, encoding = self.domain, feature_encoding(self.domain, option.features)

        def fit(
            where: NDArray[np.bool_], labels: NDArray[np.integer], classes: tuple[int, ...]
        ) -> Tree:
            rows = domain.feature_table()[where]
            return fit_tree(encode_rows(encoding, rows), labels[where], classes, seed=0)

        actions = tuple(action.name for action in domain.actions)
        policy = option.optimal.argmax(axis=1)
        return LearnedOption(
            name=option.name,
            participant='every state',
            domain=domain.name,
            domain_parameters=parameters_json(domain),
            actions=actions,
            features=option.features,
            encoding=encoding,
            policy=fit(option.initiation, policy, tuple(range(len(actions)))),
            initiation=fit(~domain.over(), option.initiation.astype(np.intp), MEMBERSHIP),
            termination=fit(option.judged, option.termination.astype(np.intp), MEMBERSHIP),
            n_demonstrations=0,
            n_not_here=0,
            max_steps=domain.n_states,
            uuids=(),
        )
