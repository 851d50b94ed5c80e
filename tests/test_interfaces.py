"""The interface files explain themselves: every field and constant says what it means."""

from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / 'src' / 'humanopts_interfaces'
FILES = sorted(
    path for kind in ('msg', 'srv', 'action') for path in (FOLDER / kind).glob(f'*.{kind}')
)
NUMBERED = ['std_msgs/Header header', 'string publisher_id', 'uint64 sequence']


def declarations(path: Path) -> list[tuple[str, str]]:
    """Return what each line of a file declares, and its comment."""
    parts = [line.partition('#') for line in path.read_text(encoding='utf-8').splitlines()]
    return [(code.strip(), text.strip()) for code, _, text in parts if code.strip(' -')]


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_every_field_and_constant_has_a_comment(path: Path) -> None:
    assert [code for code, comment in declarations(path) if not comment] == []


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_every_file_says_first_what_it_is_for(path: Path) -> None:
    assert path.read_text(encoding='utf-8').startswith('# ')


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_what_is_published_on_its_own_is_numbered(path: Path) -> None:
    if 'Published by' in path.read_text(encoding='utf-8').partition('\n\n')[0]:
        assert [code for code, _ in declarations(path)][:3] == NUMBERED
