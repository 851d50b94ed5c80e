"""The board of a state as coloured text."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from humanopts_env.domains.base import Domain
from rich.cells import cell_len
from rich.text import Text


def board_text(
    domain: Domain[Any], state: Any, shown: Collection[str] | None = None
) -> tuple[Text, Text]:
    """
    Draw a state in the domain's colours.

    :param shown: names of the features that may be revealed; None: all.
    :return: the board, and the lines below it, which may be wider.
    """
    lines = domain.render(state, shown).split('\n')
    width = cell_len(lines[0])
    end = next((n for n, line in enumerate(lines) if cell_len(line) != width), len(lines))
    styles = domain.glyph_styles
    return _coloured(lines[:end], styles), _coloured(lines[end:], styles, alone=True)


def _coloured(lines: Sequence[str], styles: Mapping[str, str], *, alone: bool = False) -> Text:
    """
    Return the lines with the domain's colours.

    :param alone: colour only characters that are no part of a word.
    """
    plain = '\n'.join(lines)
    text = Text(plain)
    around = f' {plain} '
    for at, character in enumerate(plain):
        in_word = alone and (around[at].isalpha() or around[at + 2].isalpha())
        if character in styles and not in_word:
            text.stylize(styles[character], at, at + 1)
    return text
