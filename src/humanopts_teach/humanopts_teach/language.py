"""
The language of displayed texts: GNU gettext, one PO file per language.

The texts in the code are English, with technical terms. Participants of studies read another
language, or English in plain words (``en.po``). Published messages and files keep the texts of the
code, so that bags and tables do not depend on the language; ``translated`` translates such texts
for display.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, lru_cache, wraps
from gettext import GNUTranslations, NullTranslations
from io import BytesIO
from itertools import product
from pathlib import Path
import re
from typing import Concatenate, NamedTuple, ParamSpec, Protocol, TypeVar

from humanopts_ros.text_files import FileError, read_text

ENGLISH = 'en'  # in plain words, for participants of studies
_FOLDER = Path(__file__).parent / 'locale'
_FIELD = re.compile(r'\{(\w*)[^{}]*\}')  # a placeholder, with its format
_NAMES = {
    'name',
    'new',
    'option',
    'option_name',
    'participant',
    'similar',
    'who',
}  # placeholders of texts typed by people
P = ParamSpec('P')
R = TypeVar('R')
# Separators of joined texts: between sentences first, then within them.
_JOINTS = tuple(map(re.compile, ('((?<=[.!?]) )', r'( \(|\))', '([,:;] | -> )')))
_WITHIN_A_SENTENCE = '(?:(?![.!?] ).)*?'
_DECIMAL = re.compile(r'-?\d+\.\d+')
_VALUES = dict.fromkeys(('count', 'number'), r'-?\d+')


class LanguageError(Exception):
    """A language is unknown, or its file cannot be used; the message says why."""


class _Language(NamedTuple):
    tag: str  # BCP 47
    catalog: NullTranslations
    templates: tuple[tuple[re.Pattern[str], str], ...]  # English and translation; longest first


_SOURCE = _Language('en', NullTranslations(), ())
_spoken = ContextVar('_spoken', default=_SOURCE)


def languages() -> tuple[str, ...]:
    """Return the codes of the included languages."""
    return tuple(sorted(path.stem for path in _FOLDER.glob('*.po')))


@contextmanager
def speaking(language: str) -> Iterator[None]:
    """
    Set the language of this context: this thread or task, and the tasks that it creates.

    :param language: one of ``languages``, or the path or contents of a PO file; empty: the texts
        in the code, with technical terms.
    :raises LanguageError: the language is unknown, or its file cannot be used.
    """
    token = _spoken.set(read_language(language))
    try:
        yield
    finally:
        _spoken.reset(token)


class Speaker(Protocol):
    """An object with texts in its own language."""

    @property
    def language(self) -> str:
        """The language, as in ``speaking``."""


Spoken = TypeVar('Spoken', bound=Speaker)


def in_its_language(
    method: Callable[Concatenate[Spoken, P], R],
) -> Callable[Concatenate[Spoken, P], R]:
    """Run a method, or a function that takes a speaker, in the language of that speaker."""

    @wraps(method)
    def speaks(speaker: Spoken, /, *args: P.args, **given: P.kwargs) -> R:
        with speaking(speaker.language):
            return method(speaker, *args, **given)

    return speaks


def spoken() -> str:
    """Return the code (BCP 47) of the current language."""
    return _spoken.get().tag


def _(text: str) -> str:
    """Return a text in the current language, with placeholders not filled in yet."""
    return _spoken.get().catalog.gettext(text) if text else ''


def pgettext(context: str, text: str) -> str:
    """Return a text in the current language; the context selects one of its meanings."""
    return _spoken.get().catalog.pgettext(context, text)


def ngettext(one: str, more: str, count: int) -> str:
    """Return the text for a count in the current language, with ``{count}`` not filled in yet."""
    return _spoken.get().catalog.ngettext(one, more, count)


class Number(float):
    """A number for display; formatting uses the decimal mark of the current language."""

    def __format__(self, spec: str) -> str:
        """Return the number in a format of ``float``."""
        return super().__format__(spec).replace('.', pgettext('decimal mark', '.'))


def N_(text: str) -> str:  # noqa: N802, the usual name
    """Mark a text or f-string that is translated when it is displayed."""
    return text


def translated(text: str) -> str:
    """Return an English text, composed elsewhere, in the current language."""
    return _translated(_spoken.get(), text)


@lru_cache(4096)
def _translated(language: _Language, text: str) -> str:
    if _DECIMAL.fullmatch(text):
        return text.replace('.', language.catalog.pgettext('decimal mark', '.'))
    # As a sentence, the English text may have gained a capital letter and a full stop.
    stem = text.removesuffix('.')
    forms = dict.fromkeys((text, stem, text[:1].lower() + text[1:], stem[:1].lower() + stem[1:]))
    forms.pop('', None)
    for form in forms:
        if (found := language.catalog.gettext(form)) != form:
            return _in_place(text, form, found)
    for (pattern, template), form in product(language.templates, forms):
        if match := pattern.fullmatch(form):
            values = {
                name: value if name in _NAMES else _translated(language, value)
                for name, value in match.groupdict().items()
            }
            return _in_place(text, form, template.format_map(values))
    for joints in _JOINTS:
        pieces = joints.split(text)
        if len(pieces) > 1:
            pieces[::2] = [_translated(language, each) for each in pieces[::2]]
            return ''.join(pieces)
    words, space, value = text.rpartition(' ')  # the name of a feature, and its value
    return (space and f'{_translated(language, words)} {_translated(language, value)}') or text


def _in_place(text: str, form: str, found: str) -> str:
    """Return the translation of a form with the capital letter and full stop of the text."""
    first = found[:1] if form[0] == text[0] else found[:1].upper()
    return f'{first}{found[1:]}{text[len(form) :]}'


@cache
def read_language(language: str) -> _Language:
    """
    Read a language; results are cached.

    :raises LanguageError: the language is unknown, or its file cannot be used.
    """
    if not language:
        return _SOURCE
    if '\n' in language:
        return _parsed('the file of texts', language)
    if not language.endswith('.po') and language not in languages():
        names = ', '.join(languages())
        raise LanguageError(f'unknown language {language!r}; choose from {names}, or a .po file')
    path = Path(language) if language.endswith('.po') else _FOLDER / f'{language}.po'
    try:
        return _parsed(path.name, read_text(path))
    except FileError as error:
        raise LanguageError(str(error)) from None


def _parsed(name: str, text: str) -> _Language:
    """Parse the contents of a PO file."""
    import polib  # not needed for English

    try:
        catalog = polib.pofile(text)
        texts = GNUTranslations(BytesIO(catalog.to_binary()))
    except (OSError, ValueError, LookupError) as error:
        raise LanguageError(f'{name} cannot be read as a PO file: {error}') from None
    templates = dict[str, tuple[re.Pattern[str], str]]()
    for entry in catalog.translated_entries():
        sources, given = [entry.msgid], [entry.msgstr]
        if entry.msgid_plural:
            sources, given = [entry.msgid, entry.msgid_plural], [*entry.msgstr_plural.values()]
        known = {field[0] for field in _FIELD.finditer(sources[-1])}
        for source, text in zip([*sources, *sources[-1:] * len(given)], given):
            fields = {field[0] for field in _FIELD.finditer(text)}
            if not fields <= known or re.search('[{}]', _FIELD.sub('', text)):
                raise LanguageError(
                    f'{name}: {text!r} has other placeholders than {sources[-1]!r}'
                )
            if _FIELD.search(source):
                templates[source] = _pattern(source), _FIELD.sub(r'{\1}', text)
    longest = sorted(templates, key=lambda source: len(_FIELD.sub('', source)), reverse=True)
    tag = (catalog.metadata.get('Language') or 'und').replace('_', '-')
    return _Language(tag, texts, tuple(map(templates.__getitem__, longest)))


def _pattern(source: str) -> re.Pattern[str]:
    """Return a pattern that matches the texts of a template, with a group for each placeholder."""
    pattern, end, seen = '', 0, set[str]()
    for field in _FIELD.finditer(source):
        name = field[1]
        pattern += re.escape(source[end : field.start()])
        pattern += (
            f'(?P={name})'
            if name in seen
            else f'(?P<{name}>{_VALUES.get(name, _WITHIN_A_SENTENCE)})'
        )
        end = field.end()
        seen.add(name)
    return re.compile(pattern + re.escape(source[end:]), re.DOTALL)
