"""
Learn options from a table of demonstrations, plan with them, and draw both.

Run it from the repository:  .venv/bin/python examples/own_table/learn_from_table.py
"""

import argparse
from pathlib import Path
from typing import Any

from humanopts_env import EnumerableDomain, make_domain
from humanopts_learner import (
    Demonstration,
    demonstrations_from_table,
    judge,
    judge_plan,
    learn_option,
    LearnedOption,
    plan,
    save_option,
    Thresholds,
)
import matplotlib

matplotlib.use('Agg')
import matplotlib.pyplot as plt
import numpy as np

HERE = Path(__file__).parent
ARROWS = {'up': (0, -1), 'down': (0, 1), 'left': (-1, 0), 'right': (1, 0)}
SWEEPS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 30)


def learn_options(
    demonstrations: list[Demonstration], domain: EnumerableDomain
) -> list[LearnedOption]:
    """Learn each option of the table, and print its criteria."""
    options = []
    for name in dict.fromkeys(demo.option_name for demo in demonstrations):
        shown = [demo for demo in demonstrations if demo.option_name == name]
        option = learn_option(shown, domain, seed=1)
        judgement = judge(shown, domain, Thresholds(), seed=1, option=option)
        for criterion in judgement.criteria:
            value = ''
            if criterion.measurable:
                side = 'least' if criterion.at_least else 'most'
                value = f' {criterion.value:.3f} (at {side} {criterion.threshold:.3g})'
            print(f'{name}: {criterion.name}{value}: {criterion.verdict}')
        options.append(option)
    return options


def draw_option(axes: Any, domain: EnumerableDomain, option: LearnedOption) -> None:
    """Draw the policy as arrows, the initiation set (grey) and the end states (red)."""
    cells = domain.board_slices()[0].states  # (rows, cols) state indices; -1: a wall
    rows, floor = domain.feature_table(), cells >= 0
    starts, ends = option.can_start(rows), option.ends(rows)
    colours = np.zeros((*cells.shape, 3))
    colours[floor] = 1.0
    colours[floor & ends[cells]] = (1.0, 0.8, 0.8)
    colours[floor & starts[cells]] = 0.8
    axes.imshow(colours)
    for row, col in np.argwhere(floor & starts[cells]):
        action = option.action(rows[cells[row, col]][None])[0]
        right, down = ARROWS[domain.actions[action].name]
        start = col - 0.3 * right, row - 0.3 * down
        axes.arrow(*start, 0.3 * right, 0.3 * down, head_width=0.3, color='black')
    axes.set(title=option.name, xticks=[], yticks=[])


def draw_sweeps(
    axes: Any, domain: EnumerableDomain, options: dict[str, list[LearnedOption]]
) -> None:
    """Draw the progress of value iteration with each set of options."""
    for label, used in options.items():
        means = [plan(domain, used, max_sweeps=n).solution.values.mean() for n in SWEEPS]
        axes.plot(SWEEPS, means, marker='o', label=label)
    axes.set(title='value iteration', xlabel='sweeps', ylabel='mean value of the states')
    axes.legend()


def main() -> None:
    """Learn, plan, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--table', type=Path, default=HERE / 'demonstrations.csv')
    parser.add_argument('--out', type=Path, default=Path('runs/own_table'))
    args = parser.parse_args()

    rooms = make_domain('rooms')
    demonstrations = demonstrations_from_table(args.table, rooms, features=['row', 'col'])
    options = learn_options(demonstrations, rooms)
    for option in options:
        path = save_option(args.out / 'options', option, demonstrations=[])
        print(f'wrote {path}')

    policy = plan(rooms, options)
    played = judge_plan(policy, seed=1, episodes=100)
    print(f'mean discounted return of the plan: {played.discounted.mean:.3f}')

    figure, panels = plt.subplots(1, len(options) + 1, figsize=(12, 4), layout='constrained')
    for panel, option in zip(panels, options):
        draw_option(panel, rooms, option)
    draw_sweeps(panels[-1], rooms, {'with the options': options, 'primitive actions': []})
    figure.savefig(args.out / 'options.png', dpi=100)
    print(f'wrote {args.out / "options.png"}')


if __name__ == '__main__':
    main()
