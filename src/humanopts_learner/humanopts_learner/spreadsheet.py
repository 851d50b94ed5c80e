"""
Escaping of text in CSV files for spreadsheets.

A spreadsheet evaluates a cell that begins with =, +, -, @ or a control character as a formula.
``to_cell`` prefixes such text with an apostrophe, which marks it as text. It also prefixes text
with apostrophes before such a character, so that ``from_cell`` restores every text exactly.
"""

import re
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

_FORMULA = re.compile(r"'*[=+\-@＝＋－＠\t\r\n]")  # noqa: RUF001  # some accept full-width forms
EXCEL = 'utf-8-sig'  # with a byte order mark; without it, Excel assumes Latin-1


def to_cell(value: Any) -> Any:
    """Return a value escaped for a cell; numbers stay unchanged."""
    return f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value


def from_cell(text: str) -> str:
    """Return the original text; inverse of ``to_cell``."""
    return text[1:] if text.startswith("'") and _FORMULA.match(text) else text


def csv_of(frame: 'pd.DataFrame') -> str:
    """Return a table as CSV, with all text escaped for cells, including the header."""
    cells = frame.rename(columns=to_cell)
    for name in cells.select_dtypes(exclude=['number', 'bool']):
        cells[name] = cells[name].map({value: to_cell(value) for value in cells[name].unique()})
    # With these line endings (RFC 4180), pandas quotes text that contains either character.
    return str(cells.to_csv(index=False, lineterminator='\r\n'))
