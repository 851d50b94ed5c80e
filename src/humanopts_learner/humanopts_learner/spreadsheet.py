"""
Text in CSV files that people open in a spreadsheet.

A spreadsheet takes a cell that begins with =, +, -, @ or a control character for a formula, and
runs it. Text of this kind gets an apostrophe in front, which spreadsheets read as "this is text".
So does text that has one there already: ``from_cell`` gives back every text as it was.
"""

import re
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

_FORMULA = re.compile(r"'*[=+\-@＝＋－＠\t\r\n]")  # noqa: RUF001  # some take the wide forms too
EXCEL = 'utf-8-sig'  # with a byte order mark, without which Excel takes a file for Latin-1


def to_cell(value: Any) -> Any:
    """Return a value as it is written into a cell: numbers are left as they are."""
    return f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value


def from_cell(text: str) -> str:
    """Return the text that ``to_cell`` was given."""
    return text[1:] if text.startswith("'") and _FORMULA.match(text) else text


def csv_of(frame: 'pd.DataFrame') -> str:
    """Return a table as CSV, with all text, in its head too, as it is written into cells."""
    cells = frame.rename(columns=to_cell)
    for name in cells.select_dtypes(exclude=['number', 'bool']):
        cells[name] = cells[name].map({value: to_cell(value) for value in cells[name].unique()})
    # With these ends of lines (RFC 4180), pandas quotes text that holds either character.
    return str(cells.to_csv(index=False, lineterminator='\r\n'))
