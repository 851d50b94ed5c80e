"""What differs between two lessons, from their bags alone."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
import json
from typing import Any

from humanopts_learner.demonstrations import Demonstration, each_once
from humanopts_teach.evaluation.bag_evaluation import BagEvaluation
from humanopts_teach.evaluation.measures import finite
from humanopts_teach.text_table import table

HEAD = ('what', 'of', 'A', 'B')
DEMONSTRATION = 'demonstration'
SECONDS = 'seconds of '  # what most demonstrations differ in: the text adds them up
MOST_SHOWN = 40  # characters of a value in the table; JSON has all of it
TREES = ('policy', 'initiation', 'termination')
# Fields of an OptionBlock that are compared separately, or as criteria.
_APART = {'name', 'features', 'cv_error_initiation', 'cv_error_termination'}


@dataclass(frozen=True)
class Difference:
    """One thing that differs; None: it is not in that bag."""

    what: str  # such as setting, option, demonstration or tree
    of: str  # the name of the part that differs, and of what it belongs to
    a: Any  # JSON data
    b: Any


def compare(a: BagEvaluation, b: BagEvaluation) -> list[Difference]:
    """Return all that differs, seconds of computing apart; empty: the lessons are the same."""
    one, other = _facts(a), _facts(b)
    found = []
    for (what, of), here in one.items():
        there = other.get((what, of))
        if there is None:
            continue  # that it is in one bag only is a difference of its own
        whose = f' of {_labelled(what, of, a)}' if of else ''
        for name in dict.fromkeys([*here, *there]):
            x, y = here.get(name), there.get(name)
            # Demonstrations that are in both bags are compared part by part, further on.
            in_both = (what, of) == (DEMONSTRATION, '') and None not in (x, y)
            if x != y and not in_both:
                found.append(Difference(what, name + whose, x, y))
    return found


def _labelled(what: str, of: str, evaluation: BagEvaluation) -> str:
    if what != DEMONSTRATION:
        return of
    demo = _by_uuid(evaluation)[of]
    return f'{of} (of {demo.option_name} by {demo.participant})'


def _by_uuid(evaluation: BagEvaluation) -> dict[str, Demonstration]:
    return {demo.uuid: demo for demo in each_once(evaluation.demonstrations)}


def _facts(evaluation: BagEvaluation) -> dict[tuple[str, str], dict[str, Any]]:
    """Return what is compared, as JSON data by name; a group is a kind and what it belongs to."""
    options = {f'{o.last.block.name} by {o.participant}': o.last for o in evaluation.options}
    settings = asdict(evaluation.settings)
    limits = settings.pop('thresholds')
    parameters = {f'domain {n}': v for n, v in evaluation.domain.parameters.items()}
    facts: dict[tuple[str, str], dict[str, Any]] = {
        ('setting', ''): {'domain': evaluation.domain.name, **parameters, **settings, **limits},
        ('participant', ''): dict.fromkeys(sorted(evaluation.people), True),
        ('option', ''): dict.fromkeys(options, True),
    }
    for name, learned in options.items():
        facts['features chosen', name] = {'features': list(learned.block.features)}
        facts['criteria', name] = {
            **{key: value for key, value in asdict(learned.block).items() if key not in _APART},
            'n_not_here': learned.option.n_not_here,
            **{f'criterion {c.name}': finite(c.value) for c in learned.judgement.criteria},
        }
        facts['tree', name] = {part: getattr(learned.option, part).to_dict() for part in TREES}
    shown = _by_uuid(evaluation)
    facts[DEMONSTRATION, ''] = {uuid: _brief(demo) for uuid, demo in shown.items()}
    for uuid, demo in shown.items():
        whole = json.loads(demo.to_json())
        facts[DEMONSTRATION, uuid] = {**whole, 'withdrawn': demo.withdrawn}
    plans = evaluation.named_plans
    facts['plan', ''] = dict.fromkeys(plans, True)
    for name, plan in plans.items():
        numbers = asdict(plan.row).items()
        facts['plan', name] = {key: v for key, v in numbers if not key.endswith('_seconds')}
    return facts


def _brief(demo: Demonstration) -> dict[str, Any]:
    return {
        'option': demo.option_name,
        'participant': demo.participant,
        'kind': demo.kind.value,
        'steps': len(demo.actions),
        'withdrawn': demo.withdrawn,
    }


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


def _shown(value: Any) -> str:
    if value is None:
        return '-'
    if isinstance(value, dict) and 'nodes' in value:
        return f'{len(value["nodes"])} nodes'
    if isinstance(value, bool):
        return 'yes' if value else 'no'
    text = f'{value:g}' if isinstance(value, float) else str(value)
    return text if len(text) <= MOST_SHOWN else text[: MOST_SHOWN - 3] + '...'
