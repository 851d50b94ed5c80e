"""
Demonstrations from a table of one's own, and as a table: a row for each state (needs pandas).

======================  =========================================================================
column                  what it holds
======================  =========================================================================
``demonstration``       which demonstration the row belongs to: any number or name
``step``                0, 1, 2, ... within the demonstration
``state``               the state in the domain's notation; or, in its place, columns with the
                        names of features that determine the state
``action``              the action taken there; empty in the last row. One row without an action
                        is a "not here" answer: the option makes no sense in this state
``reward``              of the action; without this column, by the rules of the domain
``option``              optional: the name of the option
``participant``         optional: who showed it
``can_start_at_end``    optional, counts in the last row: the option could start again there; true,
                        yes or 1, or false, no, 0 or empty
======================  =========================================================================

Rows may be in any order, and columns with other names are left alone. A feature is written as the
domain words its value, or as its index; a continuous one as a number. The apostrophe before text
that a spreadsheet would take for a formula is not part of the text. A data frame means what its
cells say, whatever their type: 1, 1.0, True and 'TRUE' are the same flag.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
import math
from pathlib import Path
import re
from typing import Any, TYPE_CHECKING, TypeVar

from humanopts_env.domains.base import (
    Domain,
    EnumerableDomain,
    Feature,
    FeatureKind,
    is_enumerable,
)
from humanopts_learner.demonstrations import Demonstration, DemonstrationError, make_demonstration
from humanopts_learner.spreadsheet import EXCEL, from_cell
from humanopts_ros.limits import composed
import numpy as np

if TYPE_CHECKING:
    import pandas as pd

T = TypeVar('T')
AGAIN = 'can_start_at_end'
NEEDED = ('demonstration', 'step', 'action')
OPTIONAL = ('state', 'reward', 'option', 'participant', AGAIN)
FLAGS = {
    **dict.fromkeys(('true', 'yes', 'y', 't', '1', 'on'), True),
    **dict.fromkeys(('false', 'no', 'n', 'f', '0', 'off'), False),
}
# Text that pandas reads as "missing": so that a file means the same by path and as a data frame.
MISSING = ('', 'na', 'n/a', '#n/a', '<na>', 'nan', '-nan', 'null', 'none')
_WHOLE = re.compile(r'([+-]?[0-9]+)\.0*')  # how a column of numbers with a gap in it is written


@dataclass(frozen=True)
class _Row:
    """One row as text; what is missing is empty."""

    place: str  # in words
    cells: Mapping[str, str]

    def read(self, column: str, parse: Callable[[str], T]) -> T:
        """
        Return what a cell says.

        :raises DemonstrationError: it cannot be used; the text names row and column.
        """
        try:
            return parse(self.cells[column])
        except ValueError as error:
            raise DemonstrationError(f'{self.place}, column {column}: {error}') from error


def demonstrations_from_table(
    table: 'pd.DataFrame | Path | str',
    domain: Domain[Any],
    option_name: str = '',
    features: Sequence[str] | None = None,
    participant: str = 'anonymous',
) -> list[Demonstration]:
    """
    Read demonstrations from a table whose columns are described above.

    :param table: a data frame, or the path of a CSV file.
    :param option_name: where the table has no column ``option``.
    :param features: names of those that the option depends on; None: all of the domain.
    :param participant: where the table has no column ``participant``.
    :return: in order of first appearance, checked against the rules of the domain.
    :raises DemonstrationError: the table cannot be used; the text names row and column, or the
        demonstration.
    :raises OSError: there is no such file.
    """
    rows = _rows(table)
    columns = _checked_columns(rows[0], domain)
    if 'option' not in columns and not option_name:
        raise DemonstrationError('the table has no column option: give option_name')
    groups: dict[tuple[str, str, str], list[_Row]] = {}
    for row in rows:
        who = row.read('participant', _name) if 'participant' in columns else participant
        option = composed(row.read('option', _name) if 'option' in columns else option_name)
        groups.setdefault((who, option, row.read('demonstration', _name)), []).append(row)
    numbers: dict[tuple[str, str], int] = {}
    found = []
    for (who, option, name), group in groups.items():
        numbers[who, option] = numbers.get((who, option), 0) + 1
        try:
            steps = _in_order(group, domain)
            found.append(
                make_demonstration(
                    domain,
                    option,
                    [_state(row, domain) for row in steps],
                    [row.cells['action'] for row in steps[:-1]],
                    [row.read('reward', _number) for row in steps[:-1]]
                    if 'reward' in columns
                    else None,
                    features=features,
                    can_start_at_end=AGAIN in columns and _can_start_at_end(steps),
                    participant=who,
                    number=numbers[who, option],
                )
            )
        except ValueError as error:
            raise DemonstrationError(f'demonstration {name} of {option!r}: {error}') from error
    return found


def demonstrations_to_table(demonstrations: Sequence[Demonstration]) -> 'pd.DataFrame':
    """Return demonstrations as a table that ``demonstrations_from_table`` reads."""
    import pandas as pd

    return pd.DataFrame(
        {
            'participant': demo.participant,
            'option': demo.option_name,
            'demonstration': demo.uuid,
            'step': step,
            'state': state,
            'action': demo.actions[step] if step < len(demo.actions) else '',
            'reward': demo.rewards[step] if step < len(demo.actions) else None,
            'can_start_at_end': demo.can_start_at_end and step == len(demo.actions),
        }
        for demo in demonstrations
        for step, state in enumerate(demo.states)
    )


def _rows(table: 'pd.DataFrame | Path | str') -> list[_Row]:
    """
    Return the rows as text.

    :raises DemonstrationError: it is not a table, has no rows, or two columns of one name.
    """
    import pandas as pd

    if isinstance(table, str | Path):
        as_text: Any = {'dtype': str, 'keep_default_na': False, 'skip_blank_lines': False}
        try:
            lines = pd.read_csv(
                table, header=None, skipinitialspace=True, encoding=EXCEL, **as_text
            )
        except (ValueError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
            raise DemonstrationError(f'{table} is not a table: {error}') from error
        frame = lines.iloc[1:].set_axis(lines.iloc[0].fillna(''), axis=1)
        frame.index += 1  # as a spreadsheet counts them, with the head as row 1
    else:
        frame = table
    names = [from_cell(str(column)).strip() for column in frame.columns]
    if twice := [name for name in dict.fromkeys(names) if name and names.count(name) > 1]:
        raise DemonstrationError(f'the table has two columns {twice[0]}')
    filled = frame.astype(object).where(frame.notna(), '')
    rows = [
        _Row(f'row {label}', dict(zip(names, map(_text, values), strict=True)))
        for label, values in zip(frame.index, filled.itertuples(index=False, name=None))
    ]
    if not (rows := [row for row in rows if any(row.cells.values())]):
        raise DemonstrationError('the table has no rows')
    return rows


def _text(value: Any) -> str:
    """Return what a cell says: alike for numbers that a type writes in another way."""
    text = from_cell(str(value)).strip()
    whole = _WHOLE.fullmatch(text)
    return whole[1] if whole else text


def _checked_columns(row: _Row, domain: Domain[Any]) -> tuple[str, ...]:
    """
    Return the names of the columns.

    :raises DemonstrationError: one is missing, or meant and written otherwise.
    """
    columns = tuple(row.cells)
    known = (*NEEDED, *OPTIONAL, *(feature.name for feature in domain.features))
    for column in columns:
        meant = '_'.join(column.lower().replace('-', ' ').split())
        if meant in known and column not in known and meant not in columns:
            raise DemonstrationError(f'the table has a column {column!r}: call it {meant}')
    if missing := [name for name in NEEDED if name not in columns]:
        raise DemonstrationError(f'the table has no column {", ".join(missing)}')
    return columns


def _in_order(group: Sequence[_Row], domain: Domain[Any]) -> list[_Row]:
    """Return the rows of one demonstration by step: 0, 1, ..., with an action in all but one."""
    numbered = sorted(((row.read('step', _number), row) for row in group), key=lambda at: at[0])
    rows = [row for _, row in numbered]
    if [step for step, _ in numbered] != list(range(len(rows))):
        raise DemonstrationError(f'its steps are not 0 to {len(rows) - 1}, each once')
    actions = [_action(row, domain) for row in rows]
    if actions[-1] or not all(actions[:-1]):
        raise DemonstrationError('every row but the last names an action, and the last does not')
    return rows


def _action(row: _Row, domain: Domain[Any]) -> str:
    """
    Return the action of a row; empty: none is named.

    :raises DemonstrationError: there is no such action.
    """
    name = row.cells['action']
    if name in {action.name for action in domain.actions}:
        return name
    if name.lower() in MISSING:
        return ''
    known = ', '.join(action.name for action in domain.actions)
    raise DemonstrationError(f'{row.place}, column action: no action {name!r}; there is {known}')


def _can_start_at_end(steps: Sequence[_Row]) -> bool:
    """
    Return whether the last row says that the option can start again there.

    :raises DemonstrationError: a cell is not a flag, or only an earlier row says so.
    """
    flags = [row.read(AGAIN, _flag) for row in steps]
    if any(flags) and not flags[-1]:
        place = steps[flags.index(True)].place
        raise DemonstrationError(
            f'{place}, column {AGAIN}: it counts in the last row, which says no'
        )
    return flags[-1]


def _name(text: str) -> str:
    if not text:
        raise ValueError('it is empty')
    return text


def _number(text: str) -> float:
    try:
        value = math.nan if '_' in text else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f'{text!r} is not a number')
    return value


def _flag(text: str) -> bool:
    said = text.lower()
    if said in MISSING:
        return False
    if said not in FLAGS:
        raise ValueError(f'{text!r} is neither true nor false')
    return FLAGS[said]


def _state(row: _Row, domain: Domain[Any]) -> Any:
    if 'state' in row.cells:
        return row.read('state', domain.decode)
    if not any(feature.name in row.cells for feature in domain.features):
        raise DemonstrationError(f'the table has no column state, and no feature of {domain.name}')
    if not is_enumerable(domain):
        raise DemonstrationError(
            f'the table has no column state, and the states of {domain.name} cannot all be listed'
        )
    return _state_with(domain, row)


def _state_with(domain: EnumerableDomain[Any], row: _Row) -> Any:
    """Return the one state that has the features of a row, given in words or as indices."""
    alike, given = np.ones(domain.n_states, dtype=np.bool_), []
    for column, feature in enumerate(domain.features):
        if feature.name in row.cells:
            value = row.read(feature.name, partial(_value, feature=feature))
            alike &= domain.feature_table()[:, column] == value
            given.append(f'{feature.name} {row.cells[feature.name]}')
    found = np.flatnonzero(alike)
    if len(found) != 1:
        raise DemonstrationError(
            f'{row.place}: {len(found)} states have {", ".join(given)}, not one'
        )
    return domain.state_at(int(found[0]))


def _value(text: str, feature: Feature) -> float:
    words = feature.values
    if feature.kind is FeatureKind.CONTINUOUS:
        return _number(text)
    if text in words:
        return words.index(text)
    if tuple(words) == ('no', 'yes') and text.lower() in FLAGS:
        return int(FLAGS[text.lower()])
    if not (text.isascii() and text.isdecimal()) or int(text[:9]) >= len(words) or len(text) > 9:
        raise ValueError(f'there is no value {text!r}; there is {", ".join(words)}')
    return int(text)
