"""Tables as text, for terminals."""

from collections.abc import Mapping, Sequence

from humanopts_ros.limits import shown
from rich.console import Console
from rich.table import Table
from rich.text import Text

_MAX_CELL = 200  # maximum number of characters of a cell


def table(rows: Sequence[Mapping[str, object]], left: Sequence[str] | None = None) -> str:
    """
    Format rows as an aligned table; an empty string if there are no rows.

    A text too long for a cell is shortened to its beginning and end.

    :param rows: values of each row by column header.
    :param left: headers of left-aligned columns; None: all non-numeric columns.
    """
    if not rows:
        return ''
    if left is None:
        left = [head for head, value in rows[0].items() if not isinstance(value, int | float)]
    laid_out = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style='')
    for head in rows[0]:
        laid_out.add_column(Text(head), justify='left' if head in left else 'right', no_wrap=True)
    for row in rows:
        laid_out.add_row(*(Text(shown(str(value), _MAX_CELL)) for value in row.values()))
    console = Console(width=(_MAX_CELL + 2) * len(rows[0]), color_system=None)
    with console.capture() as captured:
        console.print(laid_out)
    return '\n'.join(line.rstrip() for line in captured.get().splitlines())
