"""``humanopts bag eval`` and ``diff``: what a bag alone says about what was taught."""

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
import json
import os
from pathlib import Path
import sys

from humanopts_env.domains.base import StateError
from humanopts_teach.bags.contents import read_domain
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.commands.bag import progress_bar, ProgressCallback
from humanopts_teach.commands.ending import CommandError
from humanopts_teach.evaluation.bag_evaluation import (
    BagEvaluation,
    check_games,
    evaluate_bag,
    with_games,
)
from humanopts_teach.evaluation.difference import compare, difference_text, read_lesson
from humanopts_teach.evaluation.summary import SummaryError
from humanopts_teach.evaluation.text import evaluation_text
from humanopts_teach.report.write import write_evaluation_report


def evaluate(paths: Sequence[Path], html: Path | None, games: int, *, as_json: bool) -> int:
    """
    Learn every option in some bags again, and plan with them.

    :param html: file of a report on the one bag; None: it is not asked for.
    :param games: that each way to play is also compared in; 0: there is no comparison.
    :raises BagError: a bag cannot be read, or not evaluated as asked.
    """
    if html:
        _check_report(html, len(paths))
    with progress_bar() as show:
        bags = [open_bag(path, show) for path in paths]
        for bag in bags if games else ():
            check_games(read_domain(bag))
        found = [_evaluated(bag, games, show) for bag in bags]
    _print(as_json, bags, found)
    for bag, evaluation in zip(bags, found):
        whose = f'{bag.path}: ' if len(bags) > 1 else ''
        for warning in evaluation.warnings:
            print(f'humanopts bag eval: {whose}{warning}', file=sys.stderr)
    if html:
        with progress_bar() as show:
            bags[0].on_read = partial(show, text='reading for the report')
            try:
                write_evaluation_report(html, found[0], bags[0])
            except (StateError, SummaryError) as error:
                raise CommandError(f'no report: {error}') from error
        print(f'report: {html}', file=sys.stderr)
    return 0


def show_differences(a: Path, b: Path, *, as_json: bool) -> int:
    """
    Print what differs between two lessons.

    :return: exit status, 1 where something does.
    :raises BagError: a bag cannot be read, or not evaluated.
    """
    with progress_bar() as show:
        bags = [open_bag(path, show) for path in (a, b)]
        lessons = [read_lesson(bag, show) for bag in bags]
    found = compare(*lessons)
    for bag, lesson in zip(bags, lessons):
        for warning in lesson.evaluation.warnings:
            print(f'humanopts bag diff: {bag.path}: {warning}', file=sys.stderr)
    listed = {'same': not found, 'differences': [asdict(difference) for difference in found]}
    print(json.dumps(listed, indent=2) if as_json else difference_text(found))
    return 1 if found else 0


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


def _evaluated(bag: Bag, games: int, show: ProgressCallback) -> BagEvaluation:
    evaluation = evaluate_bag(bag, show)
    if games:
        evaluation = with_games(evaluation, games, show)
    return evaluation


def _print(as_json: bool, bags: Sequence[Bag], found: Sequence[BagEvaluation]) -> None:
    """Print one evaluation by itself, several as a list."""
    if as_json:
        listed = [
            {'bag': str(bag.path), **evaluation.to_dict()} for bag, evaluation in zip(bags, found)
        ]
        print(json.dumps(listed if len(bags) > 1 else found[0].to_dict(), indent=2))
        return
    texts = [evaluation_text(evaluation) for evaluation in found]
    if len(bags) > 1:
        texts = [f'bag {bag.path}\n{text}' for bag, text in zip(bags, texts)]
    print('\n\n'.join(texts))
