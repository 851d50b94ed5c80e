"""Texts in the language of the participant: every text has a German one."""

import ast
from collections.abc import Iterable, Iterator
from dataclasses import fields, is_dataclass, replace
from itertools import count
from keyword import iskeyword
from pathlib import Path
import random
import re

from humanopts_env.board import Board
from humanopts_env.domains.base import Domain
from humanopts_env.domains.capabilities import (
    board_of,
    explanation,
    feature_groups,
    step_effect,
)
from humanopts_env.domains.formulas import plain_name
from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_learner.options.conflicts import SAY_AGAIN
from humanopts_learner.summary import (
    AGREEMENT,
    Criterion,
    IMITATION,
    INITIATION,
    NO_REFUSAL,
    OptionSummary,
    RETURN,
    SUCCESS,
    TERMINATION,
)
from humanopts_teach.dialogue.panel import Key, Page, TypedText
from humanopts_teach.dialogue.study import StudyApp
from humanopts_teach.dialogue.view import view
from humanopts_teach.language import (
    _,
    LanguageError,
    languages,
    ngettext,
    Number,
    speaking,
    spoken,
    translated,
)
from humanopts_teach.lesson.requests import World
from humanopts_teach.study.plan import Part, PartKind
from humanopts_teach.study.questions import Questionnaire
from humanopts_teach.study.record import OpenRecord
from polib import POEntry, pofile
import pytest
from teach_support.desk import Desk
import yaml

TEACH = Path(__file__).parents[1] / 'humanopts_teach'
SOURCE = TEACH.parents[1]
# Modules that compose texts of messages. They do not know languages.
MESSAGES = (
    'humanopts_env/humanopts_env/domains/formulas.py',
    'humanopts_env/humanopts_env/game.py',
    'humanopts_learner/humanopts_learner/options/checks.py',
    'humanopts_learner/humanopts_learner/options/conflicts.py',
    'humanopts_learner/humanopts_learner/ros/runner.py',
    'humanopts_learner/humanopts_learner/summary.py',
    *(
        f'humanopts_teach/humanopts_teach/lesson/{name}.py'
        for name in ('advice', 'attempt', 'lesson', 'next_start', 'notebook', 'recorders', 'store')
    ),
    'humanopts_teach/humanopts_teach/ros/teleop.py',
)
# Calls with texts that no participant reads.
INTERNAL = {'setting', 'generator', 'get_logger', 'EntryError', '_explained', 'append'}
JARGON = {
    'en': re.compile(
        r'\b(options?|polic(y|ies)|initiation|termination|imitation|arbitration|episodes?'
        r'|primitive|rewards?|col|\w*_id|learner|node|budget|features?|states?|action sets?'
        r'|fallbacks?|uncovered|bins|held-out|balanced|returns?'
        r'|recorder|bag|\w+_server|client|topics|trees)\b',
        re.I,
    ),
    'de': re.compile(
        r'\b(Option(en)?|Policy|Initiation|Termination|Imitation|Episoden?|primitiv\w*|Knoten'
        r'|Budget|Features?|Zustände?|Return|Recorder|Bag|Server|Client|Topics?|Lerner|Bäume'
        r'|Entscheidungsbäume)\b',
        re.I,
    ),
}
TLX = TEACH / 'study/nasa_tlx.yaml'
GERMAN = TEACH / 'locale/de.po'
NAME = 'hol'  # of the button that is taught
MEASURED = OptionSummary(
    NAME,
    'p1',
    criteria=(
        *(Criterion.of(name, 0.5, 0.95, count=9) for name in (SUCCESS, AGREEMENT)),
        *(Criterion.of(name, 0.5, 0.1) for name in (IMITATION, RETURN, INITIATION, TERMINATION)),
    ),
    more_needed=4,
    mean_return_policy=0.5,
    conflicts=('taxi row 3, passenger in taxi no: now south, in demonstration 4 north',) * 2,
    advice=('Add "taxi col": it tells where the option ends.',),
)
SETTLED = replace(
    MEASURED,
    criteria=(
        Criterion.of(SUCCESS, 1.0, 0.95),
        replace(Criterion.of(INITIATION, None, 0.1), obstacle=NO_REFUSAL),
    ),
    conflicts=(),
    advice=(SAY_AGAIN,),
)
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
    """Yield the texts that an expression may be; the placeholders of an f-string get names."""
    match node:
        case ast.Constant(str() as text):
            more = count()
            yield re.sub(
                r'\{\}', lambda each: f'{{steps{next(more) or ""}}}', text.replace('%d', '{count}')
            )
        case ast.IfExp():
            yield from (*texts_of(node.body), *texts_of(node.orelse))
        case ast.JoinedStr():
            names = dict[str, str]()
            for part in node.values:
                if isinstance(part, ast.FormattedValue):
                    code = ast.unparse(part.value)
                    words = re.findall('[A-Za-z_]+', re.sub("'[^']*'", '', code))
                    word = next((each for each in reversed(words) if not iskeyword(each)), 'x')
                    taken = word in names.values() and code not in names
                    names.setdefault(code, f'{word}{len(names)}' if taken else word)
            yield ''.join(
                part.value.replace('{}', '{steps}')
                if isinstance(part, ast.Constant)
                else f'{{{names[ast.unparse(part.value)]}}}'
                for part in node.values
            )


def wrapped() -> Iterator[tuple[str, str | tuple[str, str]]]:
    """Yield each place in the code and the text, or singular and plural, translated there."""
    for item in yaml.safe_load(TLX.read_text('utf-8'))['items']:
        yield from (('nasa_tlx.yaml', item[key]) for key in ('text', 'low', 'high'))
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
            elif node.func.id == 'pgettext':
                yield place, ' '.join(text for each in node.args for text in texts_of(each))
            elif node.func.id == 'ngettext':
                one, more = (next(texts_of(each)) for each in node.args[:2])
                yield place, (one, more)


def messages() -> Iterator[tuple[str, str]]:
    """Yield each place and text of the modules that compose what nodes send to people."""
    for name in MESSAGES:
        tree = ast.parse((SOURCE / name).read_text('utf-8'))
        skipped = {
            id(each.value)
            for each in ast.walk(tree)
            if isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant)
        }
        for node in ast.walk(tree):
            own = isinstance(node, ast.Call) and ast.unparse(node.func).split('.')[-1] in INTERNAL
            if own or isinstance(node, ast.JoinedStr | ast.AnnAssign) or id(node) in skipped:
                children = ast.walk(node) if own else ast.iter_child_nodes(node)
                skipped |= {
                    id(each)
                    for each in children
                    if own
                    or id(node) in skipped
                    or (isinstance(node, ast.JoinedStr) or each is node.annotation)
                }
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant | ast.JoinedStr) and id(node) not in skipped:
                for text in texts_of(node):
                    words = re.sub(r'\{\w+\}', '', text)
                    if re.search('[a-z]{2}', words) and ' ' in text.strip():
                        yield f'{name}:{node.lineno}', text


def forms(entry: POEntry) -> list[str]:
    return [*entry.msgstr_plural.values()] or [entry.msgstr]


def catalogue(path: Path = GERMAN) -> dict[str | tuple[str, str], POEntry]:
    """Return the entries of a PO file by text, by context and text, or by singular and plural."""
    found = dict[str | tuple[str, str], POEntry]()
    for entry in pofile(str(path)):
        text = f'{entry.msgctxt} {entry.msgid}' if entry.msgctxt else entry.msgid
        found[(text, entry.msgid_plural) if entry.msgid_plural else text] = entry
    return found


def test_every_text_has_a_german_one() -> None:
    known, missing = catalogue(), dict[str | tuple[str, str], str]()
    for place, text in (*wrapped(), *messages()):
        entry = known.get(text)
        if entry is None or not entry.translated():
            missing[text] = place
    entries = [f'#: {place}\nmsgid {text!r}\nmsgstr ""' for text, place in missing.items()]
    assert not missing, f'add to {GERMAN}:\n' + '\n\n'.join(entries)


def test_participants_read_no_jargon() -> None:
    """A term that only researchers know is replaced in every language of participants."""
    english = catalogue(GERMAN.with_name('en.po'))
    assert english.keys() <= catalogue().keys(), 'texts of en.po that the code does not have'
    for key, german in catalogue().items():
        for language, message in (('en', english.get(key)), ('de', german)):
            for text in forms(message) if message else [german.msgid, german.msgid_plural]:
                words = re.sub(r'\{\w+[^}]*\}', '', text)
                assert not (term := JARGON[language].search(words)), f'{text!r} has {term}'


def domain_texts(name: str) -> Iterator[str]:
    """Yield what a game says about itself and in 400 random steps."""
    domain, rng = make_domain(name), generator(1, 'texts of a game')
    for feature in domain.features:
        yield from (plain_name(feature.name), feature.question, *feature.values)
    for action in domain.actions:
        yield from (action.name, action.description)
    yield from (group.words for group in feature_groups(domain))
    yield from (text for _sign, text in explanation(domain))
    state = domain.reset(rng)
    for step in range(400):
        shown = domain.features[step % len(domain.features)].name
        for board in (board_of(domain, state), board_of(domain, state, [shown])):
            yield from (*(mark.name for mark in board.marks), *board.notes)
        action = int(rng.integers(len(domain.actions)))
        result = domain.step(state, action, rng)
        yield step_effect(domain, state, action, result.state).text
        over = result.terminated or step % 60 == 59
        state = domain.reset(rng) if over else result.state


@pytest.mark.parametrize('name', ['taxi', 'rooms', 'pacman', 'gymnasium:FrozenLake-v1'])
def test_games_are_described_in_german(name: str) -> None:
    same = {'in', 'taxi', 'pac', 'man', 'start'}
    with speaking('de'):
        for text in {*domain_texts(name)}:
            english, german = (
                {*re.findall('[a-zäöüß]{2,}', each.lower())} for each in (text, translated(text))
            )
            assert english & german <= same, f'{text!r} is translated as {translated(text)!r}'


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
        'msgid "{share:.0f} % of it"\nmsgstr "davon {share:.0f} %"\n',
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
        ('msgid "a {b}"\nmsgstr "a {c}"\n', "'a {c}' has other placeholders than 'a {b}'"),
        ('msgid "a"\nmsgstr "a {"\n', 'has other placeholders'),
        ('msgid "a {b}"\nmsgstr "a {b:x}"\n', 'has other placeholders'),
        ('nonsense\n', 'cannot be read as a PO file'),
        ('msgid ""\nmsgstr "Plural-Forms: nplurals=2; plural=f(n);\\n"\n', 'cannot be read'),
    ],
)
def test_a_file_that_cannot_be_used(text: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(LanguageError, match=re.escape(why)), speaking(own(tmp_path, text)):
        pass


@pytest.mark.parametrize(('language', 'text'), [('', '-0.5'), ('en', '-0.5'), ('de', '-0,5')])
def test_numbers_have_the_decimal_mark_of_the_language(language: str, text: str) -> None:
    with speaking(language):
        assert f'{Number(-0.5):.3g}' == translated('-0.5') == text
        assert translated('-0.5 m') == f'{text} m'
        assert f'{Number(-0.5):g} and {Number(4):.0f}' == f'{text} and 4'
        assert translated('version 0.5.1') == 'version 0.5.1'


@pytest.mark.parametrize('name', ['fr', 'missing.po', '../de'])
def test_an_unknown_language(name: str) -> None:
    with pytest.raises(LanguageError, match=r'unknown language|cannot read'), speaking(name):
        pass


def texts(shown: object) -> Iterator[str]:
    """Yield the texts of a screen, but not pages, which the plan has in its own language."""
    match shown:
        case str():
            yield shown
        case Key():
            yield from shown[1:]
        case Board():
            yield from (*(mark.name for mark in shown.marks), *shown.notes)
        case Page() | TypedText():
            return
        case _ if is_dataclass(shown):
            for field in fields(shown):
                if field.name not in ('language', 'key', 'tone'):
                    yield from texts(getattr(shown, field.name))
        case Iterable():
            for each in shown:
                yield from texts(each)


def words(*given: str) -> set[str]:
    """Return the words of texts without placeholders."""
    joined = re.sub(r'\{\w*[^}]*\}', '', ' '.join(given)).lower()
    return {*re.findall('[a-zäöüß]{3,}', joined)}


def english_words() -> set[str]:
    """Return the words that occur in English texts only."""
    known = catalogue()
    english = words(*(text for key in known for text in ([key] if isinstance(key, str) else key)))
    german = words(*(text for entry in known.values() for text in forms(entry)))
    return english - german - {NAME}


def parts() -> list[Part]:
    """Return one part of each kind, each with an own limit of keys."""
    asked = Questionnaire.model_validate(yaml.safe_load(TLX.read_text('utf-8')), strict=False)
    kinds = PartKind.PLAY, PartKind.BUTTONS, PartKind.QUESTIONS, *[PartKind.TEACH] * 5
    return [
        Part(
            kind=kind,
            key=f'{number}',
            condition='a',
            domain='taxi',
            most=2,
            minutes=60.0,
            questions=asked if kind is PartKind.QUESTIONS else None,
        )
        for number, kind in enumerate(kinds)
    ]


def test_what_is_kept_does_not_depend_on_the_language(taxi: Domain, tmp_path: Path) -> None:
    kept = list[list[str]]()
    for language in ('', 'en', 'de'):
        path = tmp_path / f'{language}.jsonl'
        app = StudyApp(parts()[3:4], OpenRecord(path, clock=lambda: 0.0), 'p1', World(), seed=1)
        app.language = language
        desk = Desk(taxi, tmp_path / language / 'demonstrations', app=app)
        desk.advance().advance()
        desk.press('1').type(NAME).press('y', 'o', 'enter', 'left', 'up', 'enter', 'n', 'escape')
        app.last_requests()
        desk.store.close()
        files = [path, *(tmp_path / language / 'demonstrations').glob('*.jsonl')]
        kept.append([each.read_text('utf-8') for each in files])
    assert kept[0] == kept[1] == kept[2]
    assert len(kept[0]) == 2
    assert kept[0][1].count('"demonstration"') == 2


@pytest.mark.parametrize('language', ['en', 'de'])
def test_every_screen_of_a_study_is_in_the_language_of_the_participant(
    language: str, taxi: Domain, tmp_path: Path
) -> None:
    """Keys are pressed at random; the lesson and the game behind them are real."""
    rng, seen, foreign = random.Random(2), set[str](), english_words()
    assert {'the', 'option', 'step', 'you', 'demonstration'} <= foreign
    for part in parts():
        record = OpenRecord(tmp_path / f'{part.key}.jsonl')
        app = StudyApp([part], record, 'p1', World(), seed=1)
        app.language = language
        desk = Desk(taxi, tmp_path / part.key, app=app, budget=30)
        desk.exam, desk.reports = 2, {NAME: MEASURED}
        desk.advance().advance()
        if part.kind is PartKind.TEACH:
            desk.press('1').type(NAME).press('y', 'y', 'n', 'y', 'n')
        for number in range(200):
            if app.ended:
                break
            shown = view(app)
            seen.update(texts(shown))
            if number == 100:
                desk.reports[NAME] = SETTLED
            if app.screen.takes_text and rng.random() < 0.9:
                desk.press('ctrl-u').type(NAME)
            elif app.run is not None and rng.random() < 0.3:
                desk.machine('south').run_ends(f'{NAME}: it was cut off (1 step, reward -1).')
            else:
                keys = {key for key, *_words in shown.keys} - {'ctrl-c'}
                stays = keys - {'escape', 'q', 'Q'} if rng.random() < 0.9 else keys
                desk.press(rng.choice(sorted(stays) or ['enter']))
        app.last_requests()
        desk.store.close()
    # The names of features, and numbers, are typed in formulas.
    names = re.compile('|'.join(feature.name for feature in taxi.features if '_' in feature.name))
    found = sorted(names.sub('', text) for text in seen if text.strip())
    assert len(found) > 150
    wrong = [
        text
        for text in found
        if (
            JARGON['en'].search(text)
            if language == 'en'
            else words(text) & foreign or re.search(r'(?<![<>=] )\d\.\d', text)
        )
    ]
    assert not wrong, '\n'.join(wrong)
