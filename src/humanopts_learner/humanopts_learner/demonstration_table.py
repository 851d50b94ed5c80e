"""
Demonstrations from a table of one's own, and as a table: a row for each state (needs pandas).

======================  =========================================================================
column                  what it holds
======================  =========================================================================
``demonstration``       which demonstration the row belongs to: any number or name
``step``                0, 1, 2, ... within the demonstration
``state``               the state in the domain's notation; or, in its place, columns with the
                        names of features that tell the state
``action``              the action taken there; empty in the last row. One row without an action
                        is a "not here" answer: the option makes no sense in this state
``reward``              of the action; without this column, by the rules of the domain
``option``              optional: the name of the option
``participant``         optional: who showed it
``can_start_at_end``    optional, read in the last row: the option could start again there (true)
======================  =========================================================================

Rows may be in any order. A feature is written as the domain words its value, or as its index. The
apostrophe before text that a spreadsheet would take for a formula is not part of the text.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TYPE_CHECKING

from humanopts_env.domains.base import Domain, DomainError, EnumerableDomain, is_enumerable
from humanopts_learner.demonstrations import Demonstration, DemonstrationError, make_demonstration
from humanopts_learner.spreadsheet import from_cell
from humanopts_ros.limits import composed
import numpy as np

if TYPE_CHECKING:
    import pandas as pd

YES = ('true', 'yes', '1')
Row = Mapping[str, str]


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
    :raises DemonstrationError: the table cannot be used; the text names the demonstration.
    :raises OSError: there is no such file.
    """
    rows = _rows(table)
    missing = [name for name in ('demonstration', 'step', 'action') if name not in rows[0]]
    if missing:
        raise DemonstrationError(f'the table has no column {", ".join(missing)}')
    if 'option' not in rows[0] and not option_name:
        raise DemonstrationError('the table has no column option: give option_name')
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        who = row.get('participant', participant)
        option = composed(row.get('option', option_name))
        groups.setdefault((who, option, row['demonstration']), []).append(row)
    numbers: dict[tuple[str, str], int] = {}
    found = []
    for (who, option, name), group in groups.items():
        numbers[who, option] = numbers.get((who, option), 0) + 1
        try:
            steps = _in_order(group)
            found.append(
                make_demonstration(
                    domain,
                    option,
                    [_state(row, domain) for row in steps],
                    [row['action'] for row in steps[:-1]],
                    [float(row['reward']) for row in steps[:-1]] if 'reward' in rows[0] else None,
                    features=features,
                    can_start_at_end=steps[-1].get('can_start_at_end', '').lower() in YES,
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


def _rows(table: 'pd.DataFrame | Path | str') -> list[Row]:
    """Return the rows as text; a value that is missing is empty."""
    import pandas as pd

    if isinstance(table, str | Path):
        try:
            table = pd.read_csv(table, dtype=str, keep_default_na=False, skipinitialspace=True)
        except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
            raise DemonstrationError(f'{table} is not a table: {error}') from error
    if not len(table):
        raise DemonstrationError('the table has no rows')
    text = table.astype(object).where(table.notna(), '').astype(str)
    return [
        {from_cell(str(column)).strip(): from_cell(value).strip() for column, value in row.items()}
        for row in text.to_dict('records')
    ]


def _in_order(group: Sequence[Row]) -> list[Row]:
    """Return the rows of one demonstration by step: 0, 1, ..., with an action in all but one."""
    rows = sorted(group, key=lambda row: float(row['step']))
    steps = [float(row['step']) for row in rows]
    if steps != list(range(len(rows))):
        raise DemonstrationError(f'its steps are not 0 to {len(rows) - 1}, each once')
    if rows[-1]['action'] or not all(row['action'] for row in rows[:-1]):
        raise DemonstrationError('every row but the last names an action, and the last does not')
    return rows


def _state(row: Row, domain: Domain[Any]) -> Any:
    if 'state' in row:
        return domain.decode(row['state'])
    given = [feature for feature in domain.features if feature.name in row]
    if not given:
        raise DemonstrationError(f'the table has no column state, and no feature of {domain.name}')
    if not is_enumerable(domain):
        raise DemonstrationError(
            f'the table has no column state, and the states of {domain.name} cannot all be listed'
        )
    return _state_with(domain, {feature.name: row[feature.name] for feature in given})


def _state_with(domain: EnumerableDomain[Any], given: Mapping[str, str]) -> Any:
    """Return the one state that has these features, given in words or as indices."""
    alike = np.ones(domain.n_states, dtype=np.bool_)
    for column, feature in enumerate(domain.features):
        if feature.name in given:
            value = _value(given[feature.name], feature.values, feature.name)
            alike &= domain.feature_table()[:, column] == value
    found = np.flatnonzero(alike)
    if len(found) != 1:
        text = ', '.join(f'{name} {value}' for name, value in given.items())
        raise DemonstrationError(f'{len(found)} states have {text}, not one')
    return domain.state_at(int(found[0]))


def _value(text: str, words: Sequence[str], feature: str) -> int:
    if text in words:
        return words.index(text)
    if not text.removesuffix('.0').isdecimal() or int(float(text)) >= len(words):
        raise DomainError(f'{feature} has no value {text!r}; it has {", ".join(words)}')
    return int(float(text))
