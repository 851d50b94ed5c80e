"""Demonstrations by rule, and options learned from them."""

from collections.abc import Sequence
from typing import Any
import uuid

from humanopts_env.domains.base import action_index, Domain
from humanopts_env.domains.registry import make_domain, parameters_json, reference_options
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import LearnedOption

FETCH, DELIVER = 'go to passenger and pickup', 'go to destination and dropoff'
TAXI = make_domain('taxi')


def walk(
    start: str,
    actions: Sequence[str],
    option: str,
    features: Sequence[str],
    domain: Domain[Any] = TAXI,
    **fields: Any,
) -> Demonstration:
    """Show an option from a state by a list of actions; "not here" where it is empty."""
    rng = generator(0, 'scripted', option, start, *actions, str(sorted(fields.items())))
    states, rewards, terminated = [domain.decode(start)], [], False
    for action in actions:
        outcome = domain.step(states[-1], action_index(domain, action), rng)
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
        'option_name': option,
        'number': 1,
        'chosen_features': tuple(features),
        'feature_names': tuple(feature.name for feature in domain.features),
        'features': tuple(tuple(domain.feature_values(s).tolist()) for s in states),
        'states': tuple(domain.encode(state) for state in states),
        'actions': tuple(actions),
        'rewards': tuple(rewards),
        'terminated': terminated,
    }
    return Demonstration(**{**values, **fields})


def expert(option: str, count: int, domain: Domain[Any] = TAXI, **fields: Any) -> list[Any]:
    """Show an option of the reference by shortest ways from random states."""
    reference = reference_options(domain)[option]
    rng = generator(7, 'scripted expert', option)
    demos = []
    for number, start in enumerate(domain.sample_states(rng, count), start=1):
        actions, state = [], start
        while reference.can_start(state):
            action = reference.optimal_actions(state)[0]
            actions.append(domain.actions[action].name)
            state = domain.step(state, action, rng).state
        text = domain.encode(start)
        numbered = {'number': number, **fields}
        demos.append(walk(text, actions, option, reference.features, domain, **numbered))
    return demos


def taught(participant: str = 'p1') -> list[LearnedOption]:
    """Return both options of the paper's task, learned well."""
    return [
        learn_option(expert(name, 60, participant=participant), TAXI, 0)
        for name in (FETCH, DELIVER)
    ]
