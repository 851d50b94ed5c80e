"""
Compare the best plan of the Pac-Man demo with the rule written by hand, on seeds of your own.

Run it from the repository, with a demo's folder:
  .venv/bin/python examples/plan_or_rule.py runs/demo --seeds 101 102 103 104
"""

import argparse
from pathlib import Path

from humanopts_env import make_domain
from humanopts_env.domains.registry import reference_options
from humanopts_learner.intervals import Interval, level_of_each
from humanopts_learner.options.files import load_options
from humanopts_teach.evaluation.games import every_baseline, GAMES, play_baseline, RULE_NAME

PLAN = 'human, 5 options, interrupted, 4-fold steps'


def main() -> None:
    """Print the gain in score of the plan over the rule, by kind of ghosts and seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('demo', type=Path, help='folder of a demo of Pac-Man')
    parser.add_argument('--seeds', type=int, nargs='+', default=[101, 102, 103, 104])
    parser.add_argument('--games', type=int, default=GAMES)
    parser.add_argument('--game-steps', type=int, default=800_000)
    given = parser.parse_args()
    options, damaged = load_options(given.demo / 'options')
    if damaged or len(options) != 5:
        parser.error(f'{given.demo / "options"} does not hold five whole options')
    order = list(reference_options(make_domain('pacman')))  # teaching order of the demo
    options.sort(key=lambda option: order.index(option.name))
    level = level_of_each(2 * len(given.seeds))  # simultaneous intervals for all lines
    for ghosts in ('random', 'chase'):
        domain = make_domain('pacman', {'ghosts': ghosts})
        ways = {way.name: way for way in every_baseline(domain, options, given.game_steps)}
        for seed in given.seeds:
            plan, rule = (
                play_baseline(domain, ways[name], seed, given.games)['scores']
                for name in (PLAN, RULE_NAME)
            )
            more = Interval.of_difference(plan, rule, level)
            print(
                f'ghosts={ghosts} seed {seed}: plan {plan.mean():.0f}, '
                f'rule {rule.mean():.0f}, more {more.mean:.0f} '
                f'({more.low:.0f} to {more.high:.0f})',
                flush=True,
            )


if __name__ == '__main__':
    main()
