"""The screen for combining features into a new one, with an immediate view of its value."""

from collections.abc import Sequence
from dataclasses import dataclass
import re
from typing import NamedTuple

from humanopts_env.domains.base import FeatureKind
from humanopts_env.domains.formulas import derive, feature_columns, FormulaError, MAX_LENGTH
from humanopts_teach.dialogue import keys
from humanopts_teach.dialogue.app import App, Screen
from humanopts_teach.dialogue.entry import INTERRUPT, PAGE
from humanopts_teach.dialogue.keys import Command, Do
from humanopts_teach.dialogue.panel import Block, Choices, GAP, Line, Panel, Tone
from humanopts_teach.language import _, N_, Number, translated
from humanopts_teach.lesson.requests import DefineOption
import numpy as np

# Texts before, between and after the chosen features.
_KINDS = {
    N_('difference'): ('', ' - ', ''),
    N_('distance'): ('hypot(', ', ', ')'),
    N_('angle'): ('atan2(', ', ', ')'),
    N_('comparison with a number'): ('', ' > '),
    N_('equality'): ('', ' == '),
}
_EXAMPLES = ('a - b', 'hypot(a, b)', 'atan2(a, b)', 'a > 0.5', "a == b, a == 'text'")
_UNFINISHED = re.compile(r'(^|[-+*/<>=!(,])\s*$')  # a feature or a value must follow
_WORD = re.compile(r'[A-Za-z_]\w*$')
_NUMBER = re.compile(r'-?\d+')
_COMPARED = re.compile(r'(\w+) *[<>=!]=? *$')


class _Item(NamedTuple):
    """A proposed continuation of the formula."""

    text: str
    note: str
    typed: str  # resulting formula
    rest: tuple[str, ...]


@dataclass
class CombineScreen(Screen):
    """
    A formula, typed or assembled from a list, with its value in the current state.

    :ivar rest: texts to insert after each of the next chosen features.
    :ivar at: index of the selected proposal.
    """

    back: Do
    typed: str = ''
    takes_text = True
    rest: tuple[str, ...] = ()
    at: int = 0

    def panel(self, app: App) -> Panel:
        name, news = self._formula(app)
        blocks: list[Block] = [
            Line(_('A new feature from existing ones'), strong=True),
            GAP,
            Line(f'> {self.typed}█', strong=True, more=(Line('…'.join(self.rest), Tone.QUIET),)),
            Line(news, Tone.NEWS if name else Tone.QUIET),
            GAP,
        ]
        if items := self._items(app):
            blocks.append(Choices([(item.text, item.note) for item in items], self.at, keys.RIGHT))
        if len(items) > PAGE:
            blocks.append(
                Line(
                    _('{number} of {count}').format(number=self.at + 1, count=len(items)),
                    Tone.QUIET,
                )
            )
        return Panel(blocks)

    def commands(self, app: App) -> Sequence[Command]:
        name = self._formula(app)[0]
        items, enter = self._items(app), None

        def go(step: int) -> Do | None:
            def move(app: App) -> None:
                self.at = (self.at + step) % len(items)

            return move if len(items) > 1 else None

        def choose(app: App) -> None:
            self._type(*items[self.at][2:])

        def add(app: App) -> None:
            request = DefineOption(app.world.lesson.option_name, derived_features=(name,))
            app.ask(request, then=lambda answer: self.back(app))

        if name:
            enter = add
        elif items and _UNFINISHED.search(self.typed):
            enter = choose
        return [
            Command([keys.UP], _('move'), go(-1), label='↑ ↓'),
            Command([keys.DOWN], _('move down'), go(1), label=''),
            Command([keys.RIGHT], _('choose'), choose if items else None),
            Command([keys.ENTER], _('add it') if name else _('choose'), enter),
            Command(
                [keys.BACKSPACE], _('erase'), self._erase if self.typed or self.rest else None
            ),
            Command([keys.CLEAR], _('erase all'), lambda app: self._type(''), label=''),
            Command([keys.ESCAPE], _('cancel'), self.back),
            INTERRUPT,
        ]

    def other_key(self, key: str, app: App) -> None:
        if len(key) == 1 and key.isprintable() and len(self.typed) < MAX_LENGTH:
            self._type(self.typed + key, self.rest if key.isidentifier() else ())

    def _erase(self, app: App) -> None:
        self._type(self.typed[:-1], self.rest if self.typed else ())

    def _type(self, typed: str, rest: tuple[str, ...] = ()) -> None:
        self.typed, self.rest, self.at = typed, rest, 0

    def _formula(self, app: App) -> tuple[str, str]:
        """Return the name of the feature, and its value and range; or '' and a hint."""
        if not self.typed.strip():
            what = _('the first feature') if self.rest else _('how to combine features')
            return '', _('Choose {what}, or type a formula.').format(what=what)
        try:
            column = derive(app.domain, self.typed)
        except FormulaError as error:
            word = _WORD.search(self.typed)
            names = [feature.name for feature in app.domain.features]
            begun = word and word[0] not in names and any(n.startswith(word[0]) for n in names)
            return '', '' if begun or _UNFINISHED.search(self.typed) else translated(f'{error}')
        feature = column.feature
        if feature.name in app.world.lesson.derived_features:
            return '', _('{name} is already a feature').format(name=feature.name)
        row = app.world.game.features
        value = (
            _('now {value}').format(value=translated(column.text(np.array(row))))
            if row
            else _('no state yet')
        )
        if feature.kind is FeatureKind.CONTINUOUS:
            value += _(', between {low:.4g} and {high:.4g}').format(
                low=Number(feature.low), high=Number(feature.high)
            )
        return feature.name, value

    def _items(self, app: App) -> list[_Item]:
        """Return proposals: ways to combine features, values to compare with, and features."""
        if not self.typed and not self.rest:
            return [
                _Item(_(kind), example, pieces[0], pieces[1:])
                for (kind, pieces), example in zip(_KINDS.items(), _EXAMPLES)
            ]
        row, lesson = np.array(app.world.game.features), app.world.lesson
        word, compared = _WORD.search(self.typed), _COMPARED.search(self.typed)
        begun = word[0] if word else ''
        rest, found = self.rest or ('',), list[_Item]()
        names = [feature.name for feature in app.domain.features]
        for column in feature_columns(app.domain, [*names, *lesson.derived_features]):
            feature, value = column.feature, column.text(row) if row.size else ''
            if compared and feature.name == compared[1]:
                texts = [t if _NUMBER.fullmatch(t) else repr(t) for t in feature.values]
                texts = texts or value.split()[:1]  # without the unit
                found = [*(_Item(text, '', text, ()) for text in texts), *found]
            name = feature.name if feature.name in names else f'({feature.name})'
            if name.startswith(begun):
                found.append(_Item(name, translated(value), name + rest[0], rest[1:]))
        before = self.typed.removesuffix(begun)
        return [item._replace(typed=before + item.typed) for item in found]
