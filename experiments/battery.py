"""
Plans in a world that can only be acted in: when to deliver, and when to charge the battery.

This goes beyond the paper. The world is ``examples/own_robot/street.py``; the learner knows
only what the node publishes. In a trial, a simulated person shows two options, *deliver* and
*charge*, neither of which looks at the battery. Then the machine drives ``EPISODES`` episodes, and
what it chooses afterwards is compared with a hand-written rule and with random choice.

The options run as in a live game (``humanopts_learner.run``), and their runs are assembled from
states, goals and results as in the node ``planner``.
"""

from collections.abc import Callable, Sequence
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any
from uuid import NAMESPACE_OID, uuid5

from humanopts_env.domains.base import Action, Feature
from humanopts_env.domains.described import DescribedDomain, SeenState
from humanopts_env.game import Transition
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.option_runs import OptionRun, RunCollector
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.columns import suggest_column
from humanopts_learner.run import Run
import numpy as np

NAME = 'battery'
TITLE = 'Plans in a world that can only be acted in'
SEEDS = 20
EPISODES = 100  # of driving, before each plan
JUDGED = 100  # episodes that each policy is judged by
SHOWN = 8  # demonstrations of each option
LOW = 40.0  # charge below which the person charges, %
RULE = 'hand-written rule'
RANDOM = 'random choice'
DELIVER, CHARGE = 'deliver', 'charge'
WAYS = {DELIVER: ('target_way', 'drop', 'delivered'), CHARGE: ('charger_way', 'plug', 'charged')}
HERE = 2.0
MODELS, Q_LEARNING = 'models of recorded runs', 'Q-learning while driving'
SYMBOLS, ASKED = 'symbols of the options', 'symbols and battery'
RATE, EXPLORE = 0.1, 0.2
NEAR, MORE = 0.95, 1.8  # goals: share of the rule, and times random choice
Choose = Callable[[SeenState, np.random.Generator], str]  # the next option


@cache
def world() -> Any:
    """Return the module of the world; an example is not installed."""
    path = Path(__file__).parents[1] / 'examples' / 'own_robot' / 'street.py'
    spec = spec_from_file_location('street', path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def described() -> DescribedDomain:
    """Return what the world says about itself."""
    street = world()
    return DescribedDomain(
        'street',
        {},
        [
            Feature.nominal(name, question, values)
            if values
            else Feature.continuous(name, question, 0.0, street.FULL, '%')
            for name, (question, values) in street.FEATURES.items()
        ],
        [Action(name, key, text) for name, (key, text) in street.ACTIONS.items()],
        street.GAMMA,
        street.MAX_STEPS,
    )


def state_of(street: Any) -> SeenState:
    """Return the state that the world publishes."""
    return SeenState(repr(street.features()), tuple(street.features()), street.empty)


def value_of(state: SeenState, name: str) -> float:
    """Return the value of a feature."""
    return state.features[[*world().FEATURES].index(name)]


def demonstrate(name: str, number: int, seed: int) -> Demonstration:
    """Show an option where the person would choose it: charging where the battery is low."""
    domain, street = described(), world().Street()
    street.reset(int(generator(seed, NAME, 'teacher', name, number).integers(2**31)))
    low, high = (0.5 * LOW, LOW) if name == CHARGE else (LOW, world().FULL)
    street.battery = street.chance.uniform(low, high)
    street.errand = street.chance.choice(world().ERRANDS)  # before this one
    way, action, errand = WAYS[name]
    states, actions, rewards = [state_of(street)], list[str](), list[float]()
    while street.errand != errand or not actions or value_of(states[-1], 'base_way') != HERE:
        done = world().ERRANDS[int(value_of(states[-1], 'errand'))] == errand
        home = done and value_of(states[-1], 'base_way') != HERE
        toward = world().WAYS[int(value_of(states[-1], 'base_way' if home else way))]
        actions.append(action if toward == 'here' else toward)
        rewards.append(street.step(actions[-1]))
        states.append(state_of(street))
    return Demonstration(
        Kind.TRAJECTORY,
        str(uuid5(NAMESPACE_OID, f'{name} {number} {seed}')),
        domain.name,
        '{}',
        'p1',
        's1',
        option_name=name,
        number=number,
        chosen_features=('base_way', way, 'errand'),
        feature_names=tuple(feature.name for feature in domain.features),
        features=tuple(state.features for state in states),
        states=tuple(state.text for state in states),
        actions=tuple(actions),
        rewards=tuple(rewards),
        can_start_at_end=True,
    )


def taught(seed: int) -> tuple[list[LearnedOption], str]:
    """Return the options, and the column that the demonstrations suggest."""
    shown = {
        name: [demonstrate(name, number, seed) for number in range(1, SHOWN + 1)] for name in WAYS
    }
    options = [learn_option(demos, described(), seed) for demos in shown.values()]
    return options, suggest_column(described(), options, shown)


def drive(
    options: Sequence[LearnedOption],
    choose: Choose,
    episodes: int,
    seed: int,
    on_run: Callable[[OptionRun], object] = lambda run: None,
) -> list[float]:
    """
    Drive episodes as ``run_policy`` does, and return the deliveries of each.

    :param on_run: called with each run of an option.
    """
    domain, street, named = described(), world().Street(), {each.name: each for each in options}
    collector, returns = RunCollector(domain), []
    for episode in range(1, episodes + 1):
        street.reset(int(generator(seed, NAME, 'start', episode).integers(2**31)))
        rng, total = generator(seed, NAME, 'choices', episode), 0.0
        step, state = 0, state_of(street)
        collector.on_state('', Transition(episode, 0, state.text, state.features))
        while not (street.empty or street.cut_off):
            option = named[choose(state, rng)]
            run = Run(option, domain, state, (episode, step), unstick=rng)
            end = None
            while end is None:
                action = domain.actions[run.next_action()].name
                reward, step = street.step(action), step + 1
                state, total = state_of(street), total + reward
                collector.on_state(
                    '',
                    Transition(episode, step, state.text, state.features, action, reward=reward),
                )
                end = run.observe(state, reward, street.empty, street.cut_off)
            for found in collector.on_result(end):
                on_run(found)
        returns.append(total)
    return returns
