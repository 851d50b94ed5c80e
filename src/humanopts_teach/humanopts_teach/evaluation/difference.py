"""What differs between two lessons, from their bags alone."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
import json
from typing import Any

from humanopts_learner.demonstrations import Demonstration, each_once
from humanopts_teach.bags.contents import read_demonstrations
from humanopts_teach.bags.reader import Bag
from humanopts_teach.bags.summary import table
from humanopts_teach.evaluation.bag_evaluation import (
    BagEvaluation,
    evaluate_bag,
    OptionEvaluation,
    ProgressCallback,
)
from humanopts_teach.evaluation.summary import finite

HEAD = ('what', 'of', 'A', 'B')
DEMONSTRATION = 'demonstration'
SECONDS = 'seconds of '  # what most demonstrations differ in: the text adds them up
MOST_SHOWN = 40  # characters of a value in the table; JSON has all of it
TREES = ('policy', 'initiation', 'termination')
# Of an OptionBlock: compared by themselves, or told as criteria.
_APART = {'name', 'features', 'cv_error_initiation', 'cv_error_termination'}


@dataclass(frozen=True)
class Difference:
    """One thing that differs; None: it is not in that bag."""

    what: str  # such as setting, option, demonstration or tree
    of: str  # which, in words
    a: Any  # JSON data
    b: Any


@dataclass(frozen=True)
class Lesson:
    """A bag, evaluated."""

    evaluation: BagEvaluation
    demonstrations: Mapping[str, Demonstration]  # by uuid


def read_lesson(bag: Bag, progress: ProgressCallback | None = None) -> Lesson:
    """
    Learn everything in a bag again.

    :raises BagError: it is not a readable bag.
    :raises EvaluationError: it holds no demonstration to learn from.
    """
    evaluation = evaluate_bag(bag, progress)
    return Lesson(evaluation, {demo.uuid: demo for demo in each_once(read_demonstrations(bag))})


def compare(a: Lesson, b: Lesson) -> list[Difference]:
    """Return all that differs, seconds of computing apart; empty: the lessons are the same."""
    one, other = a.evaluation, b.evaluation
    found = _differences('setting', '', _settings(one), _settings(other))
    people = [sorted({option.participant for option in side.options}) for side in (one, other)]
    found += _differences('participant', '', *(dict.fromkeys(p, True) for p in people))
    here, there = _options(one), _options(other)
    found += _differences('option', '', dict.fromkeys(here, True), dict.fromkeys(there, True))
    for name in (name for name in here if name in there):
        found += _option(name, here[name], there[name])
    found += _demonstrations(a.demonstrations, b.demonstrations)
    plans, others = _plans(one), _plans(other)
    found += _differences('plan', '', dict.fromkeys(plans, True), dict.fromkeys(others, True))
    for name in (name for name in plans if name in others):
        found += _differences('plan', name, plans[name], others[name])
    return found


def difference_text(found: Sequence[Difference]) -> str:
    """Return a table for a terminal."""
    if not found:
        return 'the lessons are the same'
    lone = [d for d in found if d.what == DEMONSTRATION and None in (d.a, d.b)]
    options = Counter((_option_of(d.a or d.b), d.b is None) for d in lone)
    timed = [d for d in found if d.what == DEMONSTRATION and d.of.startswith(SECONDS)]
    rows = [[d.what, d.of, _shown(d.a), _shown(d.b)] for d in found if d not in [*lone, *timed]]
    if timed:
        sums = (sum(seconds) for seconds in zip(*((d.a, d.b) for d in timed)))
        rows.append([DEMONSTRATION, f'{SECONDS}{len(timed)}, added up', *map(_shown, sums)])
    for name in dict.fromkeys(name for name, _ in options):
        counts = (f'{options[name, in_a]} that are only here' for in_a in (True, False))
        rows.append([DEMONSTRATION, f'of {name}', *counts])
    return table(HEAD, rows)


def _option_of(demo: Mapping[str, Any]) -> str:
    gone = ', taken back' if demo['withdrawn'] else ''
    return f'{demo["option"]} by {demo["participant"]}{gone}'


def _settings(evaluation: BagEvaluation) -> dict[str, Any]:
    settings = evaluation.settings.to_dict()
    parameters = {f'domain {n}': v for n, v in evaluation.domain.parameters.items()}
    limits = settings.pop('thresholds')
    return {'domain': evaluation.domain.name, **parameters, **settings, **limits}


def _options(evaluation: BagEvaluation) -> dict[str, OptionEvaluation]:
    return {
        f'{option.block.name} by {option.participant}': option for option in evaluation.options
    }


def _option(name: str, a: OptionEvaluation, b: OptionEvaluation) -> list[Difference]:
    """Compare what was chosen, how well it was learned, and the trees."""
    chosen = [{'features': list(side.block.features)} for side in (a, b)]
    numbers = [_numbers(side) for side in (a, b)]
    trees = [{part: getattr(side.option, part).to_dict() for part in TREES} for side in (a, b)]
    return [
        *_differences('features chosen', name, *chosen),
        *_differences('criteria', name, *numbers),
        *_differences('tree', name, *trees),
    ]


def _numbers(side: OptionEvaluation) -> dict[str, Any]:
    values = {field.name: getattr(side.block, field.name) for field in fields(side.block)}
    return {
        **{key: value for key, value in values.items() if key not in _APART},
        'n_not_here': side.option.n_not_here,
        **{f'criterion {c.name}': finite(c.value) for c in side.judgement.criteria},
    }


def _demonstrations(
    a: Mapping[str, Demonstration], b: Mapping[str, Demonstration]
) -> list[Difference]:
    """Compare demonstrations; one that is in one bag only is told as a whole."""
    lone = [{uuid: _brief(demo) for uuid, demo in side.items()} for side in (a, b)]
    both = [uuid for uuid in a if uuid in b]
    for side in lone:
        for uuid in both:
            del side[uuid]
    found = _differences(DEMONSTRATION, '', *lone)
    for uuid in both:
        which = f'{uuid} (of {a[uuid].option_name} by {a[uuid].participant})'
        found += _differences(DEMONSTRATION, which, *(_whole(side[uuid]) for side in (a, b)))
    return found


def _whole(demo: Demonstration) -> dict[str, Any]:
    return {**json.loads(demo.to_json()), 'withdrawn': demo.withdrawn}


def _brief(demo: Demonstration) -> dict[str, Any]:
    return {
        'option': demo.option_name,
        'participant': demo.participant,
        'kind': demo.kind.value,
        'steps': len(demo.actions),
        'withdrawn': demo.withdrawn,
    }


def _plans(evaluation: BagEvaluation) -> dict[str, dict[str, Any]]:
    rows = zip(evaluation.plan_names, evaluation.planning)
    return {
        name: {key: v for key, v in row.to_dict().items() if not key.endswith('_seconds')}
        for name, row in rows
    }


def _differences(
    what: str, of: str, a: Mapping[str, Any], b: Mapping[str, Any]
) -> list[Difference]:
    """Return where two mappings differ, in order."""
    return [
        Difference(what, f'{name} of {of}' if of else name, a.get(name), b.get(name))
        for name in dict.fromkeys([*a, *b])
        if a.get(name) != b.get(name)
    ]


def _shown(value: Any) -> str:
    if value is None:
        return '-'
    if isinstance(value, dict) and 'nodes' in value:
        return f'{len(value["nodes"])} nodes'
    if isinstance(value, bool):
        return 'yes' if value else 'no'
    text = f'{value:g}' if isinstance(value, float) else str(value)
    return text if len(text) <= MOST_SHOWN else text[: MOST_SHOWN - 3] + '...'
