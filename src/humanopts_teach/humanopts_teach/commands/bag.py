"""``humanopts bag``: looks into a recorded bag, with no ROS."""

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
import json
import os
from pathlib import Path
import sys

from humanopts_env.domains.base import StateError
from humanopts_teach.bags.demonstrations import read_domain
from humanopts_teach.bags.errors import BagError
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.commands import bag_check, bag_export, bag_play
from humanopts_teach.commands.bar import progress_bar, Tell
from humanopts_teach.commands.errors import CommandError
from humanopts_teach.evaluation.bag_evaluation import (
    BagEvaluation,
    evaluate_bag,
    EvaluationError,
)
from humanopts_teach.evaluation.bag_games import check_games, with_games
from humanopts_teach.evaluation.difference import compare, difference_text, read_lesson
from humanopts_teach.evaluation.summary import SummaryError
from humanopts_teach.report.bag_parts import bag_parts
from humanopts_teach.report.write import write_evaluation_report


def run(arguments: argparse.Namespace) -> int:
    """Do what the bag subcommand says."""
    commands = {
        'info': _info,
        'check': bag_check.run,
        'eval': _eval,
        'diff': _diff,
        'play': bag_play.run,
        'export': bag_export.run,
    }
    try:
        return commands[arguments.bag_command](arguments)
    except (BagError, EvaluationError) as error:
        raise CommandError(str(error)) from error


def _info(arguments: argparse.Namespace) -> int:
    with progress_bar() as tell:
        info = summarise(open_bag(arguments.bag, tell))
    print(json.dumps(info.to_dict(), indent=2) if arguments.json else info.to_text())
    return 0


def _eval(arguments: argparse.Namespace) -> int:
    if arguments.html:
        _check_report(arguments.html, len(arguments.bags))
    with progress_bar() as tell:
        bags = [open_bag(path, tell) for path in arguments.bags]
        for bag in bags if arguments.games else ():
            check_games(read_domain(bag))
        found = [_evaluated(bag, arguments.games, tell) for bag in bags]
    _print(arguments.json, bags, found)
    for bag, evaluation in zip(bags, found):
        whose = f'{bag.path}: ' if len(bags) > 1 else ''
        for warning in evaluation.warnings:
            print(f'humanopts bag eval: {whose}{warning}', file=sys.stderr)
    if arguments.html:
        with progress_bar() as tell:
            bags[0].on_read = partial(tell, text='reading for the report')
            parts = bag_parts(bags[0])
        try:
            write_evaluation_report(arguments.html, found[0], parts.frames, parts.topics)
        except (StateError, SummaryError) as error:
            raise CommandError(f'no report: {error}') from error
        print(f'report: {arguments.html}', file=sys.stderr)
    return 0


def _check_report(path: Path, bags: int) -> None:
    """Refuse a report before the work for it."""
    if bags > 1:
        raise CommandError('--html reports on one bag: give one')
    if path.is_dir():
        raise CommandError(f'cannot write {path}: it is a folder')
    if not path.parent.is_dir():
        raise CommandError(f'cannot write {path}: there is no such folder')
    if not os.access(path.parent, os.W_OK):
        raise CommandError(f'cannot write {path}: the folder is not writable')


def _evaluated(bag: Bag, games: int, tell: Tell) -> BagEvaluation:
    evaluation = evaluate_bag(bag, tell)
    if games:
        evaluation = with_games(
            evaluation, games, lambda text, share: tell(round(1000 * share), 1000, text)
        )
    return evaluation


def _diff(arguments: argparse.Namespace) -> int:
    with progress_bar() as tell:
        bags = [open_bag(path, tell) for path in (arguments.a, arguments.b)]
        lessons = [read_lesson(bag, tell) for bag in bags]
    found = compare(*lessons)
    for bag, lesson in zip(bags, lessons):
        for warning in lesson.evaluation.warnings:
            print(f'humanopts bag diff: {bag.path}: {warning}', file=sys.stderr)
    listed = {'same': not found, 'differences': [asdict(difference) for difference in found]}
    print(json.dumps(listed, indent=2) if arguments.json else difference_text(found))
    return 1 if found else 0


def _print(as_json: bool, bags: Sequence[Bag], found: Sequence[BagEvaluation]) -> None:
    """Print one evaluation by itself, several as a list."""
    if as_json:
        listed = [
            {'bag': str(bag.path), **evaluation.to_dict()} for bag, evaluation in zip(bags, found)
        ]
        print(json.dumps(listed if len(bags) > 1 else found[0].to_dict(), indent=2))
        return
    texts = [
        f'bag {bag.path}\n{evaluation.to_text()}' if len(bags) > 1 else evaluation.to_text()
        for bag, evaluation in zip(bags, found)
    ]
    print('\n\n'.join(texts))
