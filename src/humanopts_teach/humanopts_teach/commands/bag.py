"""``humanopts bag``: looks into a recorded bag, with no ROS."""

import argparse
import json
import sys

from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.bags.summary import BagInfo
from humanopts_teach.commands.errors import CommandError
from humanopts_teach.evaluation.bag_evaluation import (
    BagEvaluation,
    evaluate_bag,
    EvaluationError,
    with_games,
)
from humanopts_teach.evaluation.summary import SummaryError
from humanopts_teach.report.bag_parts import bag_parts
from humanopts_teach.report.write import write_evaluation_report
from rich.console import Console
from rich.progress import Progress


def run(arguments: argparse.Namespace) -> int:
    """Do what the bag subcommand says."""
    commands = {'info': _info, 'eval': _eval}
    try:
        return commands[arguments.bag_command](arguments)
    except (BagError, EvaluationError) as error:
        raise CommandError(str(error)) from error


def _info(arguments: argparse.Namespace) -> int:
    info = summarise(open_bag(arguments.bag))
    _print(arguments.json, info)
    return 0


def _eval(arguments: argparse.Namespace) -> int:
    if arguments.html and not arguments.html.parent.is_dir():
        raise CommandError(f'cannot write {arguments.html}: there is no such folder')
    bag = open_bag(arguments.bag)
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task('reading', total=None)
        evaluation = evaluate_bag(
            bag,
            lambda done, total, text: progress.update(
                task, completed=done, total=total, description=text
            ),
        )
        if arguments.games:
            evaluation = with_games(
                evaluation,
                arguments.games,
                lambda text, share: progress.update(
                    task, completed=share, total=1.0, description=text
                ),
            )
    _print(arguments.json, evaluation)
    for warning in evaluation.warnings:
        print(f'humanopts bag eval: {warning}', file=sys.stderr)
    if arguments.html:
        parts = bag_parts(bag)
        try:
            write_evaluation_report(arguments.html, evaluation, parts.frames, parts.topics)
        except SummaryError as error:
            raise CommandError(str(error)) from error
        print(f'report: {arguments.html}', file=sys.stderr)
    return 0


def _print(as_json: bool, found: BagInfo | BagEvaluation) -> None:
    print(json.dumps(found.to_dict(), indent=2) if as_json else found.to_text())
