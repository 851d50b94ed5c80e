"""Demonstrations by rule, and options learned from them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any
import uuid

from humanopts_env.domains.base import action_index, Domain
from humanopts_env.domains.pacman.reference import AVOID_GHOST, CLOSEST_FOOD, NEAREST_PILL
from humanopts_env.domains.registry import make_domain, parameters_json, reference_options
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption, options_from_references
import numpy as np

FETCH, DELIVER = 'go to passenger and pickup', 'go to destination and dropoff'
TAXI = make_domain('taxi')
TOUR, USE = 'tour', 'pickup/dropoff'
LAST = ['north'] * 2 + ['east'] * 2 + ['south'] * 4 + ['west']  # by G to B
WAYS = {
    '4,0': ['north'] * 4 + ['east'] + ['south'] * 2 + ['east'] + LAST,
    '4,1': ['north'] * 2 + ['east'] + LAST,
    '4,2': ['north'] * 2 + LAST,
    '3,3': ['north'] * 3 + LAST[3:],
    '0,1': ['south'] * 2 + ['east'] + LAST,
}
Chooser = Callable[[int, Any], str | None]  # (actions taken, state) to the next; None: done


def show(
    domain: Domain, start: Any, choose: Chooser, rng: np.random.Generator, **fields: Any
) -> Demonstration:
    """
    Show an option from a state; "not here" where nothing is chosen.

    :param rng: of the chance in the episode, then of the uuid.
    :param fields: of the demonstration, at least ``option_name`` and ``chosen_features``.
    """
    states, actions, rewards, terminated = [start], [], [], False
    while not terminated and (action := choose(len(actions), states[-1])) is not None:
        outcome = domain.step(states[-1], action_index(domain, action), rng)
        actions.append(action)
        states.append(outcome.state)
        rewards.append(outcome.reward)
        terminated = outcome.terminated
    values: dict[str, Any] = {
        'kind': Kind.TRAJECTORY if actions else Kind.NOT_HERE,
        'uuid': str(uuid.UUID(bytes=rng.bytes(16), version=4)),
        'domain': domain.name,
        'domain_parameters': parameters_json(domain),
        'participant': 'p1',
        'session': 's1',
        'number': 1,
        'feature_names': tuple(feature.name for feature in domain.features),
        'features': tuple(tuple(domain.feature_values(s).tolist()) for s in states),
        'states': tuple(domain.encode(state) for state in states),
        'actions': tuple(actions),
        'rewards': tuple(rewards),
        'terminated': terminated,
    }
    return Demonstration(**{**values, **fields})


def walk(
    start: str,
    actions: Sequence[str] | Chooser,
    option: str,
    features: Sequence[str],
    domain: Domain = TAXI,
    **fields: Any,
) -> Demonstration:
    """Show an option from a state by actions; "not here" where there are none."""
    names = () if callable(actions) else actions
    choose = actions if callable(actions) else lambda taken, _: next(iter(names[taken:]), None)
    rng = generator(0, 'scripted', option, start, *names, str(sorted(fields.items())))
    fields = {'option_name': option, 'chosen_features': tuple(features), **fields}
    return show(domain, domain.decode(start), choose, rng, **fields)


def by_reference(option: str, domain: Domain) -> Chooser:
    """Return the choices of a person who takes the first of the best actions."""
    reference = reference_options(domain)[option]

    def choose(taken: int, state: Any) -> str | None:
        if not reference.can_start(state) or (taken and reference.ends(state)):
            return None
        return domain.actions[reference.optimal_actions(state)[0]].name

    return choose


def expert(option: str, count: int, domain: Domain = TAXI, **fields: Any) -> list[Any]:
    """Show an option of the reference by shortest ways from random states."""
    reference, choose = reference_options(domain)[option], by_reference(option, domain)
    rng = generator(7, 'scripted expert', option)
    demos = []
    for number, start in enumerate(domain.sample_states(rng, count), start=1):
        text = domain.encode(start)
        numbered = {'number': number, **fields}
        demo = walk(text, choose, option, reference.features, domain, **numbered)
        again = bool(demo.actions) and reference.can_start(domain.decode(demo.states[-1]))
        demos.append(replace(demo, can_start_at_end=again))
    return demos


@cache
def taught(participant: str = 'p1') -> tuple[LearnedOption, ...]:
    """Return both options of the paper's task, learned well."""
    return tuple(
        learn_option(expert(name, 60, participant=participant), TAXI, 0)
        for name in (FETCH, DELIVER)
    )


def taught_pacman(domain: Domain) -> list[LearnedOption]:
    """Return three options of the paper in a maze, learned well enough to play."""
    return [
        learn_option(expert(name, 40, domain), domain, 0)
        for name in (CLOSEST_FOOD, AVOID_GHOST, NEAREST_PILL)
    ]


def touring() -> list[LearnedOption]:
    """
    Return options that are worth interrupting, and what helps with passengers.

    A tour of the landmarks drives past the passenger, and ends at B.
    """
    demos = [
        walk(f'taxi {cell} passenger G destination B', way, TOUR, ['taxi_row', 'taxi_col'])
        for cell, way in WAYS.items()
    ]
    known = reference_options(TAXI)
    ready = options_from_references(TAXI, [known[USE], known[DELIVER]])
    return [learn_option(demos, TAXI, 0), *(replace(o, participant='p1') for o in ready)]
