"""Tables as text, for terminals."""

from collections.abc import Mapping, Sequence

from humanopts_ros.limits import shown
from rich.console import Console
from rich.table import Table
from rich.text import Text

_MAX_CELL = 200  # characters


def table(rows: Sequence[Mapping[str, object]], left: Sequence[str] | None = None) -> str:
    """
    Lay out rows in columns; empty where there are no rows.

    Of a text that is too long for a cell its begin and its end are shown.

    :param rows: the values of each by the heads of the columns.
    :param left: heads of the columns that are aligned to the left; None: all but numbers.
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
