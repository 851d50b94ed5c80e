"""Tables as lines of text, for terminals."""

from collections.abc import Mapping, Sequence

from humanopts_ros.limits import shown

_WIDEST = 200  # characters in a cell


def table(rows: Sequence[Mapping[str, object]]) -> str:
    """
    Lay out rows in columns, numbers to the right; empty where there are no rows.

    Of a text that is too long for a cell its begin and its end are shown.

    :param rows: the values of each by the heads of the columns.
    """
    if not rows:
        return ''
    right = [isinstance(value, int | float) for value in rows[0].values()]
    cells = [[shown(str(value), _WIDEST) for value in row.values()] for row in rows]
    return '\n'.join(aligned([list(rows[0]), *cells], right))


def aligned(rows: Sequence[Sequence[str]], right: Sequence[bool]) -> list[str]:
    """
    Return lines with the columns aligned.

    :param right: whether each column is aligned to the right.
    """
    widths = [max(map(len, column)) for column in zip(*rows)]
    return [
        '  '.join(
            cell.rjust(width) if to_right else cell.ljust(width)
            for cell, width, to_right in zip(row, widths, right, strict=True)
        ).rstrip()
        for row in rows
    ]
