"""Pages in Chromium for people who do not see them, or use only the keyboard."""

from collections.abc import Callable
from pathlib import Path

from graph_support.terminal import run_to_judge
import pytest
from selenium.webdriver.common.keys import Keys
from teach_support.chromium import DESKTOP, Person, PICKUP, served, severe, Visit, Window, windows

pytestmark = [pytest.mark.chromium, pytest.mark.live, pytest.mark.timeout(300)]
__all__ = ['windows']


def focus(window: Window) -> str | None:
    """Return the title of the button with the focus."""
    return window.driver.switch_to.active_element.get_attribute('title')


def tab_to(window: Window, title: str) -> None:
    """Press Tab until a button has the focus."""
    for _ in range(30):
        window.press(Keys.TAB)
        if focus(window) == title:
            return
    pytest.fail(f'Tab does not reach {title}')


def test_a_lesson_by_keyboard_and_no_finding_of_axe(
    tmp_path: Path, windows: Callable[..., Window]
) -> None:
    with served(tmp_path, 'taxi', '--learn', 'goal', '--seats', 1) as pages:
        window = windows(DESKTOP)
        visit = Visit(window, 'lesson')
        window.driver.get(pages.address)
        window.see('Who is teaching?')
        visit.look('sign-in')
        window.press('not a code', Keys.ENTER)
        window.see('is not a valid code')
        visit.look('sign-in-wrong')
        window.driver.get(f'{pages.address}/no%20code')
        visit.look('wrong-code')
        window.driver.get(f'{pages.address}/anna/x')
        visit.look('wrong-page')
        assert len(severe(window)) == 3  # both have status 404, and no icon
        person = Person(window, pages.address, 'anna', keys=True)
        window.see('What next?')
        visit.look('menu')
        window.press('?')
        window.see('Fetch the passenger')
        visit.look('game')
        window.press(Keys.ESCAPE)
        window.see('What next?')
        other = windows(DESKTOP)  # waits meanwhile
        other.driver.get(f'{pages.address}/ben')
        other.see('You are number 1 in line')
        waiting = Visit(other, 'lesson')
        waiting.look('waiting')
        other.driver.get(f'{pages.address}/anna')
        other.see('is active in another window')
        waiting.look('other-window')
        other.driver.get('about:blank')
        window.press(Keys.ENTER)
        window.see('What is the option called?')
        visit.look('name')
        window.press(PICKUP, Keys.ENTER)
        window.see('question 1 of')
        visit.look('question')
        person.answer_questions()
        visit.look('start')
        window.press(Keys.ENTER)
        start, found, asked = 1, '', set[str]()
        while not run_to_judge(found):
            if f'next: start {start} ' in found:
                if not asked and person.option.can_start(person.state()):
                    asked.add('step')
                    visit.look('before-a-step')
                    person.step()
                    visit.look('after-a-step')
                    tab_to(window, 'south')
                    window.press(Keys.ENTER)
                    window.see(f'start {start}, step 2 ')
                    assert focus(window) == 'south'  # its button was replaced meanwhile
                    window.press('u')
                    window.see(f'start {start}, step 1 ')
                    window.press('u')
                    window.see(f'next: start {start} ')
                    window.driver.refresh()  # no button has the focus: Enter means done
                    window.see(f'next: start {start} ')
                person.show(start)
                start += 1
            found = window.text()
        visit.look('run-to-judge')
        person.judge()
        visit.look('finished')
        window.press(Keys.ESCAPE)
        window.see('What next?')
        window.press('q')
        window.see('Everything taught is saved.')
        visit.look('farewell')
        waiting.report()
        visit.report()
        assert severe(window) == []
