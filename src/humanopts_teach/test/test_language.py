"""Texts in the language of the participant: every text has a German one."""

import ast
from collections.abc import Iterator
from pathlib import Path
import re

from babel.messages.catalog import Message
from babel.messages.pofile import read_po
from humanopts_teach.language import (
    _,
    LanguageError,
    languages,
    ngettext,
    speaking,
    spoken,
    translated,
)
import pytest

TEACH = Path(__file__).parents[1] / 'humanopts_teach'
GERMAN = TEACH / 'locale/de.po'
HEADER = (
    'msgid ""\nmsgstr ""\n"Language: de-AT\\n"\n"Content-Type: text/plain; charset=UTF-8\\n"\n'
)
PLURALS = HEADER + '"Plural-Forms: nplurals=2; plural=(n != 1);\\n"\n'


def own(folder: Path, text: str) -> str:
    """Write a PO file and return its path."""
    path = folder / 'own.po'
    path.write_text(PLURALS + text, 'utf-8')
    return str(path)


def texts_of(node: ast.expr) -> Iterator[str]:
    """Yield the texts that an argument may be; the placeholders of an f-string get names."""
    match node:
        case ast.Constant(str() as text):
            yield text
        case ast.IfExp():
            yield from (*texts_of(node.body), *texts_of(node.orelse))
        case ast.JoinedStr():
            yield ''.join(
                part.value
                if isinstance(part, ast.Constant)
                else f'{{{re.findall("[A-Za-z_]+", ast.unparse(part.value))[-1]}}}'
                for part in node.values
            )


def wrapped() -> Iterator[tuple[str, str | tuple[str, str]]]:
    """Yield each place in the code and the text, or singular and plural, translated there."""
    for path in sorted(TEACH.rglob('*.html')):
        for text in re.findall(r"\b_\('([^']*)'\)", path.read_text('utf-8')):
            yield path.name, text
    for path in sorted(TEACH.rglob('*.py')):
        for node in ast.walk(ast.parse(path.read_text('utf-8'))):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
                continue
            place = f'{path.relative_to(TEACH)}:{node.lineno}'
            if node.func.id in ('_', 'N_'):
                yield from ((place, text) for text in texts_of(node.args[0]))
            elif node.func.id == 'ngettext':
                one, more = (next(texts_of(each)) for each in node.args[:2])
                yield place, (one, more)


def catalogue() -> dict[str | tuple[str, str], Message]:
    with GERMAN.open('rb') as file:
        return {each.id: each for each in read_po(file) if each.id}


def test_every_text_has_a_german_one() -> None:
    known, missing = catalogue(), dict[str | tuple[str, str], str]()
    for place, text in wrapped():
        entry = known.get(text)
        if entry is None or entry.fuzzy or not all([entry.string, *entry.string]):
            missing[text] = place
    entries = [f'#: {place}\nmsgid {text!r}\nmsgstr ""' for text, place in missing.items()]
    assert not missing, f'add to {GERMAN}:\n' + '\n\n'.join(entries)


def test_german_file_can_be_used() -> None:
    assert 'de' in languages()
    with speaking('de'):  # also compares placeholders
        assert spoken() == 'de'
        assert _('yes') == 'ja'
        assert _('') == ''
    assert (spoken(), _('yes')) == ('en', 'yes')


def test_texts_of_messages_are_translated_when_displayed(tmp_path: Path) -> None:
    path = own(
        tmp_path,
        'msgid "the option {option} has {count} runs: {reason}."\n'
        'msgstr "{count} Läufe hat {option}: {reason}."\n'
        'msgid "too few"\nmsgstr "zu wenige"\n'
        'msgid "{share:.0f} % of it"\nmsgstr "davon {share:.1f} %"\n',
    )
    with speaking(path):
        assert spoken() == 'de-AT'
        text = 'the option too few has 3 runs: too few. Unknown. 40 % of it'
        assert translated(text) == '3 Läufe hat too few: zu wenige. Unknown. davon 40 %'
    assert translated('too few') == 'too few'


def test_plurals(tmp_path: Path) -> None:
    path = own(
        tmp_path,
        'msgid "one game"\nmsgid_plural "{count} games"\n'
        'msgstr[0] "ein Spiel"\nmsgstr[1] "{count} Spiele"\n',
    )
    with speaking(path):
        found = [ngettext('one game', '{count} games', n).format(count=n) for n in (1, 2)]
        assert found == ['ein Spiel', '2 Spiele']
        assert translated('5 games') == '5 Spiele'


@pytest.mark.parametrize(
    ('text', 'why'),
    [
        ('msgid "a {b}"\nmsgstr "a {c}"\n', "'a {c}' needs the placeholders of 'a {b}'"),
        ('msgid "a {b}"\nmsgstr "a"\n', "'a' needs the placeholders of 'a {b}'"),
        ('msgid "a"\nmsgstr "a {"\n', 'needs the placeholders'),
        ('nonsense\n', 'cannot be read as a PO file'),
    ],
)
def test_a_file_that_cannot_be_used(text: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(LanguageError, match=re.escape(why)), speaking(own(tmp_path, text)):
        pass


@pytest.mark.parametrize('name', ['fr', 'missing.po', '', '../de'])
def test_an_unknown_language(name: str) -> None:
    with pytest.raises(LanguageError, match=r'unknown language|cannot be read'), speaking(name):
        pass
