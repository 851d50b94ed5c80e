"""Accuracies over all states, and over a sample where they cannot be listed."""

from dataclasses import replace
from functools import cache
from typing import Any

from humanopts_env.arrays import Rows
from humanopts_env.domains.base import Domain
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.reference import judge_states, ReferenceOption
from humanopts_env.domains.registry import parameters_json, reference_options
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.taxi import Taxi
from humanopts_env.games import feature_rows
from humanopts_env.seeding import generator
from humanopts_learner import (
    classification_accuracy,
    Demonstration,
    learn_option,
    LearnedOption,
    policy_accuracy,
)
from humanopts_learner.options.accuracy import average_returns
from humanopts_learner.options.decision_tree import encode_rows, feature_encoding, fit_tree
from humanopts_learner.options.learned_option import (
    MEMBERSHIP,
    OptionError,
    options_from_references,
)
import numpy as np
import pytest

pytestmark = pytest.mark.heavy

TAXI, ROOMS, PACMAN = Taxi(), Rooms(), PacMan()
FETCH, FOOD, AVOID = 'go to passenger and pickup', 'go to the closest food', 'avoid ghost'


@cache
def sampled(domain: Domain, count: int) -> tuple[list[Any], Rows]:
    """Return sampled states, and their features (count, F)."""
    states = domain.sample_states(generator(9, 'fitted'), count)
    return states, feature_rows(domain, states)


def fitted(domain: Domain, reference: ReferenceOption, count: int = 2000) -> LearnedOption:
    """Return an option whose trees are fitted to what the reference says of sampled states."""
    states, rows = sampled(domain, count)
    said = judge_states(reference, states, len(domain.actions))
    encoding = feature_encoding(domain, reference.features)
    X = encode_rows(encoding, rows)
    acts = said.initiation
    return LearnedOption(
        name=reference.name,
        participant='p',
        domain=domain.name,
        domain_parameters=parameters_json(domain),
        actions=tuple(action.name for action in domain.actions),
        features=tuple(reference.features),
        encoding=encoding,
        policy=fit_tree(X[acts], said.optimal[acts].argmax(axis=1), range(4), 0),
        initiation=fit_tree(X, said.initiation.astype(np.intp), MEMBERSHIP, 0),
        termination=fit_tree(X, said.termination.astype(np.intp), MEMBERSHIP, 0),
        n_demonstrations=1,
        n_not_here=0,
        max_steps=100,
        uuids=('u',),
    )


def test_a_sample_measures_what_all_states_do(
    fetching: list[Demonstration], plain_taxi: Domain
) -> None:
    """Taxi with and without its tables, within four standard errors of a share of 1,500."""
    reference = reference_options(TAXI)[FETCH]
    option = learn_option(fetching[:12], TAXI, 0)
    exact = policy_accuracy(option, TAXI, reference)
    assert 0.5 < exact < 0.95
    assert policy_accuracy(option, plain_taxi, reference) == pytest.approx(exact, abs=0.05)
    careless = replace(option, initiation=option.termination)
    assert classification_accuracy(option, plain_taxi, reference) == (1.0, 1.0)
    assert classification_accuracy(careless, plain_taxi, reference)[0] == 0.0


def test_accuracy_is_the_share_of_states_that_are_right(fetching: list[Demonstration]) -> None:
    reference = reference_options(TAXI)[FETCH]
    option, rows = learn_option(fetching, TAXI, 0), TAXI.feature_table()
    states = np.flatnonzero(reference.initiation)
    good = reference.optimal[states, option.action(rows[states])].mean()
    assert policy_accuracy(option, TAXI, reference) == pytest.approx(good)
    assert 0.5 < good < 1
    assert classification_accuracy(option, TAXI, reference) == (1.0, 1.0)
    careless = learn_option([replace(d, can_start_at_end=True) for d in fetching], TAXI, 0)
    judged = reference.judged & ~TAXI.over()
    share = reference.initiation[judged].mean()
    assert classification_accuracy(careless, TAXI, reference)[0] == pytest.approx(share)


def test_where_an_option_ends_is_judged_only_where_it_can_be() -> None:
    """
    Counted on the board, for the north-west room's way to its north doorway.

    It can be in 25 cells of the room, in the room's other doorway, in the north doorway, and,
    slipping out of the other doorway, in one cell beyond: it ends in the last three.
    """
    name = 'north-west room to north doorway'
    reference = reference_options(ROOMS)[name]
    (option,) = options_from_references(ROOMS, [reference])
    assert classification_accuracy(option, ROOMS, reference) == (1.0, 1.0)
    X = encode_rows(option.encoding, ROOMS.feature_table())
    endless = replace(
        option, termination=fit_tree(X, np.zeros(len(X), dtype=np.intp), MEMBERSHIP, 0)
    )
    assert classification_accuracy(endless, ROOMS, reference)[1] == pytest.approx(25 / 28)


@pytest.mark.parametrize('name', reference_options(PACMAN))
def test_an_option_that_follows_the_reference_is_accurate(name: str) -> None:
    """In Pac-Man, each by its own features; one that goes the other way is not."""
    reference = reference_options(PACMAN)[name]
    option = fitted(PACMAN, reference)
    assert policy_accuracy(option, PACMAN, reference) >= 0.9
    assert min(classification_accuracy(option, PACMAN, reference)) >= 0.98
    wrong = replace(option, policy=replace(option.policy, counts=option.policy.counts[:, ::-1]))
    assert policy_accuracy(wrong, PACMAN, reference) <= 0.4


def average_return(
    option: LearnedOption | None, domain: Domain, reference: ReferenceOption
) -> float:
    """Return the average return of one policy."""
    return average_returns([option], domain, reference)[0]


def test_average_return_is_that_of_runs_to_the_references_end(
    fetching: list[Demonstration], plain_taxi: Domain
) -> None:
    """Counted by hand: every step costs 1 but the pickup; a run that gets stuck has 100."""
    reference = reference_options(TAXI)[FETCH]
    begun = reference.initiation & ~TAXI.over()
    best = average_return(None, TAXI, reference)
    assert best == pytest.approx(-(reference.distance[begun] - 1).mean())
    option = learn_option(fetching[:12], TAXI, 0)
    returns = []
    for index in np.flatnonzero(begun).tolist():
        state, total, rng = TAXI.state_at(index), 0.0, generator(0, 'no chance')
        for _ in range(100):
            action = int(option.action(TAXI.feature_values(state)[None])[0])
            outcome = TAXI.step(state, action, rng)
            state, total = outcome.state, total + outcome.reward
            if reference.ends(state):
                break
        returns.append(total)
    assert average_return(option, TAXI, reference) == pytest.approx(np.mean(returns))
    assert min(returns) == -100 < np.mean(returns) < best
    endless = replace(option, termination=option.initiation)  # where a run ends is not learned
    assert average_return(endless, TAXI, reference) == average_return(option, TAXI, reference)
    listed = average_return(option, plain_taxi, reference)
    assert listed == pytest.approx(np.mean(returns), abs=4 * np.std(returns) / 20)


def test_average_return_is_higher_for_a_better_policy() -> None:
    """In Pac-Man, with the same ghosts; nobody who goes for food beats the reference option."""
    reference = reference_options(PACMAN)[FOOD]
    option = fitted(PACMAN, reference)
    wrong = replace(option, policy=replace(option.policy, counts=option.policy.counts[:, ::-1]))
    best = average_return(None, PACMAN, reference)
    assert average_return(option, PACMAN, reference) == pytest.approx(best, abs=1.0)
    assert average_return(wrong, PACMAN, reference) < best - 2
    alone = [average_return(each, PACMAN, reference) for each in (option, wrong)]
    assert average_returns([option, None, wrong], PACMAN, reference) == [alone[0], best, alone[1]]
    again = PacMan()  # what is sampled depends on the name and the parameters of the game
    assert average_return(option, again, reference_options(again)[FOOD]) == alone[0]
    with pytest.raises(OptionError, match='was learned in'):
        policy_accuracy(option, PacMan('yard'), reference)
    domain = PacMan('%%%%%\n%P..%\n%%%%%')  # without a ghost to avoid
    options = reference_options(domain)
    option = fitted(domain, options[FOOD], 50)
    assert np.isnan(average_return(None, domain, options[AVOID]))
    assert np.isnan(policy_accuracy(option, domain, options[AVOID]))
    assert np.isnan(classification_accuracy(option, domain, options[AVOID])[1])
