"""The codebook: meaning, unit and level of measurement of each column of the tables of a study."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

from humanopts_ros.text_files import read_yaml
import pandas as pd

_APOSTROPHE = (
    'an apostrophe before =, +, -, @, a tab or a line break is not part of a text: it keeps '
    'spreadsheets from running the text as a formula'
)


@dataclass(frozen=True)
class Column:
    """The description of a column."""

    meaning: str
    unit: str  # empty: none
    level: str  # id, nominal, ordinal, scale or text

    @property
    def label(self) -> str:
        """Meaning and unit."""
        return f'{self.meaning} ({self.unit})' if self.unit else self.meaning


@cache
def codebook() -> dict[str, dict[str, Column]]:
    """Return the columns of each table, by name, common columns first."""
    tables = read_yaml(Path(__file__).parent / 'codebook.yaml')
    common = tables.pop('every table')
    return {
        table: {name: Column(*given) for name, given in {**common, **columns}.items()}
        for table, columns in tables.items()
    }


def codebook_table() -> pd.DataFrame:
    """Return a row for each column of each table."""
    rows = [
        {'file': f'{table}.csv', 'column': name, **vars(column)}
        for table, columns in codebook().items()
        for name, column in columns.items()
    ]
    found = pd.DataFrame(rows)
    found.loc[found['level'] == 'text', 'meaning'] += f'; {_APOSTROPHE}'
    return found
