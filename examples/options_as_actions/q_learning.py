"""
Learn when to run which taught option: tabular SMDP Q-learning, next to primitive actions.

Teach first, or let a simulated teacher do it; then run this from the repository:
  ./humanopts demo taxi --out runs/demo
  .venv/bin/python examples/options_as_actions/q_learning.py humanopts/Taxi-v0 runs/demo
"""

import argparse
from pathlib import Path

import gymnasium
from humanopts_env import OptionsEnv
from humanopts_env.domains.formulas import feature_columns
from humanopts_env.domains.registry import domain_from_json
from humanopts_learner.options.files import load_options
from humanopts_learner.qlearning import EnvLearner


def main() -> None:
    """Print the number of solved episodes in each ten, and the mean number of steps."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('env', help='id of the Gymnasium environment')
    parser.add_argument('folder', type=Path, help='folder of a lesson, with its options')
    parser.add_argument('--episodes', type=int, default=100)
    parser.add_argument('--seed', type=int, default=1)
    given = parser.parse_args()
    options, damaged = load_options(given.folder / 'options')
    if damaged or not options:
        parser.error(f'{given.folder / "options"} has no options, or damaged ones')
    domain = domain_from_json(options[0].domain, options[0].domain_parameters)
    names = {name for option in options for name in option.features}
    columns = feature_columns(domain, names)  # the Q-table covers the features of the options
    for chosen in (options, []):
        env = OptionsEnv(gymnasium.make(given.env), chosen, primitives=not chosen)
        print(f'actions: {", ".join(env.option_names)}')
        learner = EnvLearner(env, columns)
        for first in range(0, given.episodes, 10):
            played = learner.play(10, given.seed + first, learn=True)
            solved, steps = played.terminated.sum(), played.steps.mean()
            print(f'after {first + 10} episodes: {solved} of 10 solved in {steps:.0f} steps')


if __name__ == '__main__':
    main()
