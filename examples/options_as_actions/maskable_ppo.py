"""
Learn when to run which taught option, with a deep network: MaskablePPO of sb3-contrib.

It needs another package:
  .venv/bin/pip install sb3-contrib
  .venv/bin/python examples/options_as_actions/maskable_ppo.py humanopts/PacMan-v0 runs/pacman
"""

import argparse
from pathlib import Path

import gymnasium
from gymnasium.wrappers import FlattenObservation
from humanopts_env import OptionsEnv
from humanopts_learner.options.files import load_options
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor


def main() -> None:
    """Print the mean return before and after learning."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('env', help='id of the Gymnasium environment')
    parser.add_argument('folder', type=Path, help='folder of a lesson, with its options')
    parser.add_argument('--runs', type=int, default=20_000, help='runs of options to learn from')
    given = parser.parse_args()
    options, damaged = load_options(given.folder / 'options')
    if damaged or not options:
        parser.error(f'{given.folder / "options"} has no options, or damaged ones')
    env = FlattenObservation(OptionsEnv(gymnasium.make(given.env), options, primitives=True))
    # PPO discounts per run of an option, not per step: a run counts as one step.
    model = MaskablePPO('MlpPolicy', Monitor(env), gamma=0.99, seed=1)
    print('mean return before', evaluate_policy(model, model.get_env(), 50)[0])
    model.learn(given.runs)
    print('mean return after', evaluate_policy(model, model.get_env(), 50)[0])


if __name__ == '__main__':
    main()
