"""A study in Chromium, on a phone with touch: every page of a participant, and who is let in."""

from collections.abc import Callable, Iterator
import time

from humanopts_teach.study.record import Record, StudyFolder
import pytest
from selenium.webdriver.common.keys import Keys
from teach_support.chromium import (
    DESKTOP,
    PHONE,
    served_by,
    severe,
    shared_window,
    Visit,
    Window,
    windows,
)

pytestmark = [pytest.mark.chromium, pytest.mark.live, pytest.mark.timeout(300)]
__all__ = ['shared_window', 'windows']
READING = 4.0  # s, longer than a machine that is busy takes to answer
SITE = 'https://panel.invalid'
PLAN = f"""
study: words
participants: 3
reading: {READING}
consent: consent.md
welcome: welcome.md
thanks: thanks.md
recruiting:
  code: PROLIFIC_PID
  columns: [STUDY_ID, SESSION_ID]
  completed: {SITE}/done?id={{code}}
  declined: {SITE}/declined
conditions:
  - {{name: goal, domain: taxi, learn: goal, free_play: 5, buttons: 1, teach: 5,
     questions: asked.yaml, task: Bring the passenger to the flag.}}
"""
ASKED = """
points: 5
items:
  - {name: liked, text: Did you like it?, low: not at all, high: very much}
  - {name: hand, kind: choice, text: Which hand do you write with?, options: [left, right]}
  - {name: knew, kind: choices, text: What did you know before?, options: [Taxi, Pac-Man]}
  - {name: age, kind: number, text: How old are you?, least: 18, most: 99, unit: years}
  - {name: more, kind: text, text: Is there anything else?, optional: true}
"""
PAGES = {
    'consent.md': '# Taking part\n\nYou teach a taxi.\n---\n## Your data\n\n\\<b>No names.\n',
    'welcome.md': '# Welcome\n\nThere are four parts.\n',
    'thanks.md': '# Thank you\n',
    'plan.yaml': PLAN,
    'asked.yaml': ASKED,
}

CLOCK = """
window.reactions = {};
let heading = '', since = 0;
new MutationObserver(() => {
  const now = document.querySelector('h1')?.textContent ?? '';
  if (now === heading) return;
  heading = now;
  requestAnimationFrame(() => { since = performance.now(); });
}).observe(document.documentElement, { childList: true, subtree: true });
document.addEventListener('click', (event) => {
  const keys = event.target.closest('[data-keys]')?.dataset.keys ?? '';
  if (keys.includes('enter')) window.reactions[heading] = (performance.now() - since) / 1000;
}, true);
"""


@pytest.fixture(scope='module')
def study(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, StudyFolder]]:
    """The address and the folder of a study that is served meanwhile."""
    folder = tmp_path_factory.mktemp('study')
    for name, text in PAGES.items():
        (folder / name).write_text(text, 'utf-8')
    data = folder / 'data'
    arguments = ('study', folder / 'plan.yaml', '--study', data, '--browser', '--seats', 2)
    with served_by(arguments, folder) as pages:
        yield pages.address, StudyFolder(data)


def record_of(folder: StudyFolder, code: str) -> Record:
    (record,) = (each for each in folder.records()[0] if each.code == code)
    return record


def choose(window: Window, words: str) -> None:
    """Choose an answer once the question was displayed long enough, and see it chosen."""
    time.sleep(0.5)
    window.click(words)
    chosen = '[aria-checked=true]'
    window.until(lambda: window.driver.find_elements('css selector', chosen), f'{words} chosen')


def test_a_participant_on_a_phone_from_the_invitation_to_the_completion(
    study: tuple[str, StudyFolder], windows: Callable[..., Window]
) -> None:
    address, folder = study
    window = windows(PHONE)
    visit = Visit(window, 'study')
    window.driver.get(f'{address}?PROLIFIC_PID=pia&STUDY_ID=s1&SESSION_ID=t1')
    window.see('You teach a taxi.')
    visit.look('consent')
    time.sleep(READING)
    window.click('continue')
    window.see('Your data')
    window.click('I agree to take part')  # not read yet
    window.see('Please read this first')
    assert folder.records() == ([], [])
    visit.look('consent-early')
    assert '<b>No names.' in window.text()
    time.sleep(READING + 0.3)
    window.click('I agree to take part')
    window.see('There are four parts.')
    visit.look('welcome')
    time.sleep(READING + 0.3)
    window.click('continue')
    window.see('Get to know the game')
    window.see('Bring the passenger to the flag.')
    visit.look('play')
    window.click('continue with the study')
    window.see('easier and faster to win')
    visit.look('button')
    window.write('fetch')
    window.click('OK')
    window.see('What next?')
    visit.look('menu')
    window.driver.execute_script(CLOCK)
    window.click('Finish teaching')
    window.see('Did you like it?')
    visit.look('rating')
    choose(window, '4')
    window.click('accept')
    window.see('Which hand')
    visit.look('choice')
    choose(window, 'left')
    window.click('accept')
    window.see('What did you know before?')
    visit.look('choices')
    choose(window, 'Pac-Man')
    window.click('accept')
    window.see('How old are you?')
    visit.look('number')
    time.sleep(0.5)
    window.write('33')
    window.click('OK')
    window.see('Is there anything else?')
    visit.look('text')
    time.sleep(0.5)
    window.click('OK')  # it may be skipped
    window.see('Thank you')
    time.sleep(READING + 0.3)
    window.click('continue')
    window.see('You have finished the study.')
    visit.look('end')
    reactions = window.driver.execute_script('return reactions')
    assert '/data' not in window.text()
    assert severe(window) == []
    window.click('back to the site that invited you')
    window.until(lambda: window.driver.current_url == f'{SITE}/done?id=pia', 'the completion')
    record = record_of(folder, 'pia')
    assert record.over
    seconds = {each.item: each.seconds for each in record.of('answer')}
    for item, words in (('hand', 'Which hand do'), ('knew', 'What did you know')):
        (measured,) = (each for heading, each in reactions.items() if words in heading)
        assert seconds[item] == pytest.approx(measured, abs=0.3)  # 0.02 unless the machine is busy
    (client,) = record.of('client')
    assert 'Chrome' in client.browser
    assert (client.width, client.height) == PHONE
    assert client.columns == {'STUDY_ID': 's1', 'SESSION_ID': 't1'}
    window.driver.get(f'{address}/pia')
    window.see('You have finished the study.')
    visit.report()


def test_who_declines_leaves_nothing_and_goes_back_to_the_plans_address(
    study: tuple[str, StudyFolder], windows: Callable[..., Window]
) -> None:
    address, folder = study
    before = sorted(folder.path.rglob('*'))
    window = windows(DESKTOP)
    window.driver.get(f'{address}/nele?lang=de')
    window.see('You teach a taxi.')
    time.sleep(READING + 0.3)
    window.press(Keys.ENTER)
    window.see('Ich nehme nicht teil')
    assert window.driver.find_element('tag name', 'html').get_attribute('lang') == 'de'
    visit = Visit(window, 'decline')
    time.sleep(READING + 0.3)
    window.press('n')
    window.see('Es wurde nichts gespeichert.')
    visit.look('declined')
    window.press(Keys.ENTER)
    window.until(lambda: window.driver.current_url == f'{SITE}/declined', 'the address')
    new = {path.name for path in {*folder.path.rglob('*')} - {*before}}
    assert new <= {'log.jsonl', 'study.lock', '.lock'}
    assert 'nele' not in (folder.path / 'log.jsonl').read_text()
    visit.report()


def test_codes_are_assigned_by_one_server(
    study: tuple[str, StudyFolder], windows: Callable[..., Window]
) -> None:
    address, folder = study
    machines = [windows(DESKTOP), windows(PHONE)]
    for window in machines:
        window.driver.get(f'{address}?assign')
    codes = []
    for window in machines:
        window.see('You teach a taxi.')
        codes.append(window.driver.current_url.rpartition('/')[2].partition('?')[0])
        time.sleep(READING + 0.3)
        window.click('continue')
        window.see('Your data')
        time.sleep(READING + 0.3)
        window.click('I agree to take part')
    for window in machines:
        window.see('There are four parts.')
    records = [record_of(folder, code) for code in codes]
    assert len({record.number for record in records}) == 2
    assert len({record.place for record in records}) == 2
    machines[1].driver.refresh()
    machines[1].see('There are four parts.')


@pytest.mark.parametrize(
    ('query', 'sentence'),
    [
        ('?PROLIFIC_PID=%3Cscript%3Ealert(1)%3C/script%3E', 'is not a valid code'),
        ('?PROLIFIC_PID=', 'is not a valid code'),
        ('?PROLIFIC_PID=zoe&STUDY_ID=' + 201 * 'x', 'The value of STUDY_ID'),
        ('?PROLIFIC_PID=zoe&STUDY_ID=%00', 'The value of STUDY_ID'),
        ('?lang=../de', 'unknown language; choose from de, en.'),
        ('/%3Cscript%3E', 'is not a valid code'),
        ('/zoe/more', 'There is no such page.'),
    ],
)
def test_an_address_with_something_else_gets_one_sentence(
    query: str, sentence: str, study: tuple[str, StudyFolder], shared_window: Window
) -> None:
    shared_window.driver.get(study[0] + query)
    shared_window.see(sentence)
    assert not shared_window.driver.find_elements('css selector', 'script')
    assert shared_window.findings() == []
