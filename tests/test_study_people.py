"""A study with more people than seats, some of whom do not finish."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import as_completed, ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
import json
from pathlib import Path
import random
import re
import signal
import time

from graph_support.command import Command
from humanopts_teach.cli import main
from humanopts_teach.study.record import StudyFolder
from humanopts_teach.study.report import Results
from humanopts_teach.study.tables import read_study
import pandas as pd
import pytest
from socketio.exceptions import BadNamespaceError
from teach_support.page_client import PageClient

DAY = 25 * 3600.0  # s, longer than a place is held
PATIENCE = 1800.0  # s; most people wait for a seat
AGAIN = 5.0  # s
BLINK = 0.4  # s, more than the minimum display time of a question
PLAN = {
    'study': 'forty',
    'reading': 0,
    'consent': 'consent.md',
    'all': {'domain': 'taxi', 'learn': 'goal', 'buttons': 1, 'questions': 'asked.yaml'},
    'conditions': [{'name': 'a'}, {'name': 'b'}],
}
ASKED = {'items': [{'name': 'hard', 'text': 'How hard was it?', 'low': 'not', 'high': 'very'}]}
CONDITION = [('Finish teaching', ['5']), ('How hard', ['3', 'enter'])]
END = 'You have finished the study'
STEPS: list[tuple[str, Sequence[str]]] = [  # what is shown, and the keys
    ('Taking part', ['y']),
    ('Which button', [*'fetch', 'enter']),
    *CONDITION,
    *CONDITION,
]


@dataclass(frozen=True)
class Size:
    """The number of people of a study, besides one who refuses and one who returns."""

    seats: int
    places: int
    first: int  # come on the first day, and finish
    leave: int  # come on the first day, and drop out
    withdraw: int  # of the first
    second: int  # come on the second day, and finish; with those kept, an even number


FORTY = Size(seats=8, places=30, first=10, leave=8, withdraw=2, second=20)
FEW = Size(seats=2, places=6, first=2, leave=1, withdraw=1, second=3)
pytestmark = [pytest.mark.whole, pytest.mark.timeout(3600)]


class Page:
    """A page that is opened again when its connection is lost, as in a browser."""

    def __init__(self, address: str, path: str) -> None:
        self._address, self._path = address, path
        self._client = PageClient(address, path)

    def panel(self) -> str:
        """Return the HTML of the panel."""
        if not self._client.socket.connected:
            self.close()
            self._client = PageClient(self._address, self._path)
        return self._client.shows('panel')

    def press(self, *keys: str) -> None:
        """Press keys, or report that the frame is displayed; nothing happens offline."""
        with suppress(BadNamespaceError):
            self._client.press(*keys)

    def close(self) -> None:
        """Close the page."""
        self._client.socket.shutdown()


class People:
    """Those who take part; each has a page, and a thread that reads and presses keys."""

    def __init__(self, address: str, token: str) -> None:
        self.address, self.token = address, token
        self.waited: set[str] = set()  # codes of those who saw the waiting page
        self.failed = False

    def come(self, code: str, most: int = len(STEPS), first: int = 0) -> None:
        """
        Take part, and close the page.

        :param most: leave when this step is shown; all of them: at the end.
        :param first: number of steps done before.
        """
        with self._page(code) as page:
            self._read(page, code, STEPS[first][0])
            following = [*(words for words, _ in STEPS[first + 1 :]), END]
            for step, after in list(zip(STEPS[first:], following))[: most - first]:
                self._read(page, code, after, step)

    def decline(self, code: str) -> None:
        """Read the consent, and do not agree."""
        with self._page(code) as page:
            self._read(page, code, 'Nothing was saved', ('Taking part', ['n']))

    @contextmanager
    def _page(self, code: str) -> Iterator['Page']:
        """Open a page; the failure of one person ends the study of all."""
        try:
            with closing(Page(self.address, f'{self.token}/{code}')) as page:
                yield page
        except BaseException:
            self.failed = True
            raise

    def _read(
        self, page: Page, code: str, words: str, step: tuple[str, Sequence[str]] = ('', ())
    ) -> None:
        """
        Wait until a page shows something.

        :param step: what the page may show before, and the keys that lead on; they are pressed
            again if the page still shows it, such as after it was opened again.
        """
        deadline = time.monotonic() + PATIENCE
        before, keys = step
        pressed = -AGAIN
        while words not in (shown := page.panel()):
            if 'in line' in shown:
                self.waited.add(code)
            assert 'cannot continue' not in shown, f'{code}: {shown}'
            assert not self.failed
            assert time.monotonic() < deadline, f'no {words} for {code}: {shown}'
            if keys and before in shown and time.monotonic() - pressed > AGAIN:
                page.press()  # it is displayed
                time.sleep(BLINK)
                page.press(*keys)
                pressed = time.monotonic()
            time.sleep(0.1)

    @staticmethod
    def all_of(visits: Iterable[Callable[[], None]]) -> None:
        """Let people come at once, and wait until the last has left."""
        visits = list(visits)
        with ThreadPoolExecutor(len(visits)) as threads:
            for visit in as_completed([threads.submit(visit) for visit in visits]):
                visit.result()  # the first failure says why; it makes the others leave


def a_day_passes(study: Path, codes: Iterable[str]) -> None:
    """Set the records of those who have left back by more than a day: a device of this test."""
    for code in codes:
        (path,) = study.glob(f'*-{code}.jsonl')
        events = [json.loads(line) for line in path.read_text('utf-8').splitlines()]
        earlier = [event | {'time': event['time'] - DAY} for event in events]
        path.write_text(''.join(f'{json.dumps(event)}\n' for event in earlier), 'utf-8')


@pytest.mark.parametrize('size', [FEW, pytest.param(FORTY, marks=pytest.mark.slow)])
def test_people_who_wait_leave_withdraw_and_return_are_counted_and_balanced(
    tmp_path: Path, domain_id: int, size: Size
) -> None:
    for name, content in (
        ('plan.yaml', PLAN | {'participants': size.places}),
        ('asked.yaml', ASKED),
    ):
        (tmp_path / name).write_text(json.dumps(content))
    (tmp_path / 'consent.md').write_text('# Taking part\n')
    plan, study = tmp_path / 'plan.yaml', tmp_path / 'study'
    shared = ('--study', str(study))
    seats = ('--seats', size.seats, '--linger', 20)
    arguments = ('study', plan, '--browser', '--port', 0, *seats, *shared)
    command = Command(arguments, tmp_path, domain_id)
    most_graphs = 0

    def gone() -> bool:
        """Whether no participant's graph is running; also note the most that were."""
        nonlocal most_graphs
        graphs = sum('commands.seat_graph' in line for line in command.running().values())
        most_graphs = max(most_graphs, graphs)
        return graphs == 0

    try:
        command.until(lambda: 'Open ' in command.output, 'the address')
        found = re.search(r'Open (http://[^/]+)(/\S+) in a browser', command.output)
        assert found is not None
        people, moments = People(*found.groups()), random.Random(1)
        leaving = {f'left{n}': moments.randrange(2, len(STEPS)) for n in range(size.leave)}
        first = [lambda code=f'first{n}': people.come(code) for n in range(size.first)]
        first += [lambda code=code, most=most: people.come(code, most)
                  for code, most in leaving.items()]  # fmt: skip
        first += [lambda: people.decline('refuses'), lambda: people.come('returns', 4)]
        moments.shuffle(first)
        with ThreadPoolExecutor(1) as beside:
            visits = beside.submit(people.all_of, first)
            while not visits.done():
                gone()
                with suppress(TimeoutError):
                    visits.result(1.0)
            visits.result()
        assert len(people.waited) >= len(first) - 1 - size.seats
        assert most_graphs <= size.seats
        command.until(gone, 'the end of all graphs', 300.0)

        gone_for_good = [f'first{n}' for n in range(size.withdraw)]
        for code in gone_for_good:
            assert main(['study', 'withdraw', str(plan), code, '--yes', *shared]) == 0
            assert not list(study.glob(f'*{code}*'))
        a_day_passes(study, [*leaving, 'returns'])
        later = [lambda code=f'second{n}': people.come(code) for n in range(size.second)]
        people.all_of([*later, lambda: people.come('returns', first=4)])
        command.send(signal.SIGINT)
        assert command.ended(120) == 0, command.errors
    finally:
        print(command.errors)  # shown if the test fails
        command.close()

    data, problems = read_study(StudyFolder(study), time.time())
    assert problems == []
    flow = Results(data).flow
    came = size.first + size.leave + 2 + size.second
    assert (flow.assessed, flow.declined, flow.began) == (came, 1, came - 1)
    finished = size.first - size.withdraw + size.second + 1
    ends = flow.finished, flow.dropped_out, flow.withdrawn, flow.under_way
    assert ends == (finished, size.leave, size.withdraw, 0)
    assert main(['study', 'export', str(plan), *shared]) == 0
    tables = {name: pd.read_csv(study / 'tables' / f'{name}.csv', keep_default_na=False)
              for name in ('participants', 'conditions', 'answers', 'buttons')}  # fmt: skip
    who = tables['participants']
    assert set(who['participant']) == {
        *(f'first{n}' for n in range(size.withdraw, size.first)),
        *(f'second{n}' for n in range(size.second)),
        *leaving,
        'returns',
    }
    whole = who[who['state'] == 'finished']
    assert set(who[who['state'] == 'dropped out']['participant']) == set(leaving)
    orders = Counter(whole['order'])
    assert set(orders) == {'a b', 'b a'}
    assert abs(orders['a b'] - orders['b a']) <= 1
    assert len(tables['conditions']) == 2 * len(who)
    answers = tables['answers']
    assert set(answers[answers['participant'].isin(whole['participant'])].groupby(
        'participant').size()) == {2}  # fmt: skip
    assert set(whole['participant']) <= set(tables['buttons']['participant'])
    for path in study.rglob('*'):
        assert 'refuses' not in path.name
        assert not any(code in path.name for code in gone_for_good)
