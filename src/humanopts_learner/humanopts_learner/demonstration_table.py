"""
Conversion between demonstrations and tables with one row per state (requires pandas).

======================  =========================================================================
column                  content
======================  =========================================================================
``demonstration``       number or name of the demonstration
``step``                0, 1, 2, ... within the demonstration
``state``               state in the domain's notation; alternatively, columns named after
                        features that determine the state
``action``              action taken in the state; empty in the last row. A single row without an
                        action is a "not here" answer: the option does not apply in this state
``reward``              reward of the action; without this column, computed by the domain's rules
``option``              optional: name of the option
``participant``         optional: participant who demonstrated it
``can_start_at_end``    optional, used in the last row: whether the option could start again there;
                        true, yes or 1, or false, no, 0 or empty
======================  =========================================================================

Rows may be in any order, and columns with other names are ignored. A feature value is the domain's
word for the value or its index; a continuous value is a number. An apostrophe that keeps a
spreadsheet from reading text as a formula is not part of the text. The cell types of a data frame
do not matter: 1, 1.0, True and 'TRUE' are the same flag.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TYPE_CHECKING

from humanopts_env.domains.base import (
    Domain,
    Feature,
    FeatureKind,
    is_enumerable,
)
from humanopts_learner.demonstrations import (
    Demonstration,
    DemonstrationError,
    make_demonstration,
    shown,
)
from humanopts_learner.spreadsheet import EXCEL, from_cell
from humanopts_ros.limits import composed
from humanopts_ros.text_files import fault_in
import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

if TYPE_CHECKING:
    import pandas as pd

AGAIN = 'can_start_at_end'
NEEDED = ('demonstration', 'step', 'action')
OPTIONAL = ('state', 'reward', 'option', 'participant', AGAIN)
# Text that pandas reads as missing, so that a file and its data frame are equivalent.
MISSING = ('', 'na', 'n/a', '#n/a', '<na>', 'nan', '-nan', 'null', 'none')
_WHOLE = r'^([+-]?[0-9]+)\.0*$'  # format of a numeric column with missing values
_NUMBER = TypeAdapter(Annotated[float, Field(allow_inf_nan=False)]).validate_python
_FLAG = TypeAdapter(bool).validate_python  # true, yes, on, 1, and their opposites


def demonstrations_from_table(
    table: 'pd.DataFrame | Path | str',
    domain: Domain,
    option_name: str = '',
    features: Sequence[str] | None = None,
    participant: str = 'anonymous',
) -> list[Demonstration]:
    """
    Read demonstrations from a table with the columns described above.

    :param table: data frame, or path of a CSV file.
    :param option_name: option name if the table has no column ``option``.
    :param features: names of the features that the option depends on; None: all of the domain.
    :param participant: participant if the table has no column ``participant``.
    :return: demonstrations in order of first appearance, checked against the rules of the domain.
    :raises DemonstrationError: the table is invalid; the message names the row and column, or the
        demonstration.
    :raises OSError: the file does not exist.
    """
    rows = _rows(table)
    _check_columns(list(rows.columns), domain)
    if 'option' not in rows and not option_name:
        raise DemonstrationError('the table has no column option: give option_name')
    given = {'participant': participant, 'option': option_name}
    rows = rows.assign(**{name: value for name, value in given.items() if name not in rows})
    actions = [action.name for action in domain.actions]
    cells: dict[str, Callable[[str], Any]] = {
        'participant': _name,
        'option': lambda text: composed(_name(text)),
        'demonstration': _name,
        'step': _NUMBER,
        'action': partial(_action, known=actions),
        AGAIN: lambda text: text.lower() not in MISSING and _FLAG(text),
    }
    for column, parse in cells.items():
        if column in rows:
            rows[column] = _read(rows, column, parse)
    counts: Counter[tuple[str, str]] = Counter()
    found = []
    groups: Any = rows.groupby(['participant', 'option', 'demonstration'], sort=False)
    for (who, option, name), group in groups:
        counts[who, option] += 1
        steps = group.sort_values('step')
        try:
            found.append(
                make_demonstration(
                    domain,
                    option,
                    _states(steps, domain),
                    _actions(steps),
                    _read(steps[:-1], 'reward', _NUMBER) if 'reward' in steps else None,
                    features=features,
                    can_start_at_end=AGAIN in steps and _can_start_at_end(steps),
                    participant=who,
                    number=counts[who, option],
                )
            )
        except ValueError as error:
            raise DemonstrationError(f'demonstration {name} of {option!r}: {error}') from error
    return found


def demonstrations_to_table(demonstrations: Sequence[Demonstration]) -> 'pd.DataFrame':
    """Return demonstrations, without judged runs, for ``demonstrations_from_table``."""
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
        for demo in shown(demonstrations)
        for step, state in enumerate(demo.states)
    )


def _rows(table: 'pd.DataFrame | Path | str') -> 'pd.DataFrame':
    """
    Return the non-empty rows as text, labelled with their row numbers in a spreadsheet.

    :raises DemonstrationError: the file is not a table, has no rows, or repeats a column name.
    """
    import pandas as pd

    if isinstance(table, pd.DataFrame):
        frame = table
    else:
        as_text: Any = {'dtype': str, 'keep_default_na': False, 'skip_blank_lines': False}
        try:
            lines = pd.read_csv(
                table, header=None, skipinitialspace=True, encoding=EXCEL, **as_text
            )
        except ValueError as error:  # including errors of pandas
            raise DemonstrationError(f'{table} is not a table: {error}') from error
        frame = lines.iloc[1:].set_axis(lines.iloc[0].fillna(''), axis=1)
        frame.index += 1  # numbering as in a spreadsheet, with the header in row 1
    names = [from_cell(str(column)).strip() for column in frame.columns]
    if twice := [name for name, count in Counter(names).items() if name and count > 1]:
        raise DemonstrationError(f'the table has two columns {twice[0]}')
    text = frame.astype(object).where(frame.notna(), '').set_axis(names, axis=1)
    text = text.map(lambda value: from_cell(str(value)).strip()).replace(_WHOLE, r'\1', regex=True)
    if (text := text[(text != '').any(axis=1)]).empty:
        raise DemonstrationError('the table has no rows')
    return text


def _check_columns(columns: Sequence[str], domain: Domain) -> None:
    """
    Check the names of the columns.

    :raises DemonstrationError: a column is missing or misspelled.
    """
    known = (*NEEDED, *OPTIONAL, *(feature.name for feature in domain.features))
    for column in columns:
        meant = '_'.join(column.lower().replace('-', ' ').split())
        if meant in known and column not in known and meant not in columns:
            raise DemonstrationError(f'the table has a column {column!r}: call it {meant}')
    if missing := [name for name in NEEDED if name not in columns]:
        raise DemonstrationError(f'the table has no column {", ".join(missing)}')


def _read(rows: 'pd.DataFrame', column: str, parse: Callable[[str], Any]) -> list[Any]:
    """
    Return the parsed cells of a column.

    :raises DemonstrationError: a cell is invalid; the message names the row and column.
    """
    found = []
    for place, text in rows[column].items():
        try:
            found.append(parse(text))
        except ValueError as error:
            why = fault_in(error) if isinstance(error, ValidationError) else error
            raise DemonstrationError(f'row {place}, column {column}: {why}') from error
    return found


def _name(text: str) -> str:
    if not text:
        raise ValueError('it is empty')
    return text


def _action(text: str, known: Sequence[str]) -> str:
    """Return the action in a cell; empty: no action."""
    if text in known:
        return text
    if text.lower() in MISSING:
        return ''
    raise ValueError(f'unknown action {text!r}; choose from {", ".join(known)}')


def _actions(steps: 'pd.DataFrame') -> list[str]:
    """
    Return the actions of one demonstration.

    :raises DemonstrationError: the steps are not 0, 1, ..., an action is missing, or the last row
        has one.
    """
    if list(steps['step']) != list(range(len(steps))):
        raise DemonstrationError(f'its steps are not 0 to {len(steps) - 1}, each once')
    *actions, last = steps['action']
    if last or not all(actions):
        raise DemonstrationError('every row but the last names an action, and the last does not')
    return actions


def _can_start_at_end(steps: 'pd.DataFrame') -> bool:
    """
    Return whether the option can start again in the last row.

    :raises DemonstrationError: the flag is set only in an earlier row.
    """
    flags = steps[AGAIN]
    if flags.any() and not flags.iloc[-1]:
        place = flags.idxmax()
        raise DemonstrationError(
            f'row {place}, column {AGAIN}: it counts in the last row, which says no'
        )
    return bool(flags.iloc[-1])


def _states(steps: 'pd.DataFrame', domain: Domain) -> list[Any]:
    """
    Return the states of one demonstration, from their notation or from their features.

    :raises DemonstrationError: states are missing, or not determined by the given features.
    """
    if 'state' in steps:
        return _read(steps, 'state', domain.decode)
    named = {at: each for at, each in enumerate(domain.features) if each.name in steps}
    if not named:
        raise DemonstrationError(f'the table has no column state, and no feature of {domain.name}')
    if not is_enumerable(domain):
        raise DemonstrationError(
            f'the table has no column state, and the states of {domain.name} cannot all be listed'
        )
    values = [_read(steps, each.name, partial(_value, each)) for each in named.values()]
    states = []
    for place, wanted in zip(steps.index, zip(*values)):
        found = np.flatnonzero((domain.feature_table()[:, list(named)] == wanted).all(axis=1))
        if len(found) != 1:
            words = steps.loc[place]
            given = ', '.join(f'{each.name} {words[each.name]}' for each in named.values())
            raise DemonstrationError(f'row {place}: {len(found)} states have {given}, not one')
        states.append(domain.state_at(int(found[0])))
    return states


def _value(feature: Feature, text: str) -> float:
    """Return the value of a feature, given as a word or as its index."""
    words = feature.values
    if feature.kind is FeatureKind.CONTINUOUS:
        return float(_NUMBER(text))
    if text in words:
        return words.index(text)
    if tuple(words) == ('no', 'yes'):
        return float(_FLAG(text))
    index = int(text) if text.isascii() and text.isdecimal() else len(words)
    if index >= len(words):
        raise ValueError(f'unknown value {text!r}; choose from {", ".join(words)}')
    return index
