"""Consent: keys count only for what has been displayed long enough; refusing leaves nothing."""

from collections.abc import Iterable

from humanopts_teach.dialogue.consent import ConsentApp
from humanopts_teach.study.plan import Part, PartKind
from humanopts_teach.terminal.drawing import frame
import pytest

PAGES = [
    Part(kind=PartKind.PAGE, key='consent/1', text='# Welcome', reading=2.0),
    Part(kind=PartKind.CONSENT, key='consent', text='# Do you agree?', reading=2.0),
]


class Person:
    """Reads a dialogue at a terminal, or in a browser that reports the frames it displays."""

    def __init__(self, *, browser: bool) -> None:
        self.app, self.now, self.browser = ConsentApp(PAGES), 100.0, browser
        self.frame = self.app.drawn()

    def draw(self, seconds: float) -> None:
        """Draw a frame; it is displayed, and time passes."""
        self.frame = self.app.drawn()
        self.press([], 0.0)
        self.press([], seconds)

    def press(self, keys: Iterable[str], seconds: float = 0.0) -> None:
        self.now += seconds
        self.app.advance(self.now)
        self.app.type(keys, self.frame if self.browser else None)
        self.app.advance(self.now)

    def see(self) -> str:
        return ' '.join(' '.join(frame(self.app, 80, 24)).split())


@pytest.mark.parametrize('browser', [False, True])
def test_keys_count_only_two_seconds_after_a_page_was_displayed(browser: bool) -> None:
    person = Person(browser=browser)
    person.press(['enter', 'y'], 60.0)  # nothing has been displayed yet
    assert 'Welcome' in person.see()
    person.draw(1.9)
    person.press(['enter'])
    assert 'Please read this first; Enter was ignored.' in person.see()
    person.press(['enter', 'y', 'n'], 0.2)  # the answers are typed ahead of the question
    assert 'Do you agree?' in person.see()
    person.press(['y'], 10.0)  # on the frame before it
    assert person.app.agreed is None
    person.draw(2.1)
    person.press(['enter', 'y'])
    assert (person.app.agreed, person.app.ended) == (True, True)


def test_leaving_is_no_answer() -> None:
    person = Person(browser=False)
    person.press(['ctrl-c'])
    assert (person.app.agreed, person.app.ended) == (None, True)


def test_a_long_page_is_scrolled_at_once_to_its_end() -> None:
    text = '\n\n'.join(f'Paragraph {number}.' for number in range(30))
    app = ConsentApp([Part(kind=PartKind.CONSENT, key='consent', text=text, reading=2.0)])
    app.drawn()
    app.type([])
    app.advance(1.0)
    assert '... ↓ shows more' in frame(app, 80, 24)
    for _ in range(20):
        app.type(['down'])
        app.advance(1.0)
    lines = frame(app, 80, 24)
    assert 'Paragraph 29.' in lines
    assert '↑ goes back up' in lines
    assert len(lines) == 24
    assert not app.message.text
