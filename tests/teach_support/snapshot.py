"""Texts that are a claim by themselves: each is compared with a file that people read."""

import os
from pathlib import Path

FOLDER = Path(__file__).parents[1] / 'snapshots'


def check(name: str, text: str) -> None:
    """
    Compare a text with the file of this name.

    With UPDATE_SNAPSHOTS=1 the file is written instead; read what has changed before it is kept.
    """
    path, text = FOLDER / name, text.rstrip() + '\n'
    if os.environ.get('UPDATE_SNAPSHOTS'):
        path.write_text(text, encoding='utf-8')
    assert text == path.read_text('utf-8'), f'{path} differs; UPDATE_SNAPSHOTS=1 writes it'
