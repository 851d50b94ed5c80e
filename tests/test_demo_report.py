"""The report of a demo: one page that needs nothing else, with the numbers of the summary."""

from html.parser import HTMLParser

from graph_support.command import DemoRun
from humanopts_teach.bags.contents import read_episodes
from humanopts_teach.bags.reader import open_bag
import pytest


class Page(HTMLParser):
    """The text of the table rows of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Begin a row or a cell."""
        if tag == 'tr':
            self.rows.append([])
        elif tag in ('td', 'th') and self.rows:
            self.rows[-1].append('')

    def handle_data(self, data: str) -> None:
        """Keep the text of table cells."""
        if self.rows and self.rows[-1] and self.lasttag in ('td', 'th', 'code'):
            self.rows[-1][-1] += data.strip()


@pytest.fixture(scope='module')
def report(demo: DemoRun) -> str:
    """The text of report.html."""
    return (demo.folder / 'report.html').read_text('utf-8')


def test_report_holds_all_its_figures(demo: DemoRun, report: str) -> None:
    learning, boards, planning, episode = (
        report.index(f'<h2 id="{part}">') for part in ('learning', 'boards', 'planning', 'episode')
    )
    assert report[learning:boards].count('<svg') >= 4  # two options
    assert report[boards:planning].count('<svg') >= 4  # two plans, two layouts
    assert report[planning:episode].count('<svg') >= 2  # time and return
    frames = report[episode:].count('<li class=')
    assert frames == len(list(read_episodes(open_bag(demo.bag)))[-1].transitions)


def test_numbers_of_the_report_are_those_of_the_summary(demo: DemoRun, report: str) -> None:
    rows = Page(report).rows
    for option in demo.summary['options']:
        for key, words in (
            ('n_demonstrations', 'demonstrations'),
            ('mean_return_demonstrations', 'mean return of the demonstrations'),
            ('mean_return_policy', 'mean return of the policy, same starts'),
            ('cv_error_initiation', 'initiation: held-out balanced error'),
            ('cv_error_termination', 'termination: held-out balanced error'),
        ):
            shown = _written(option[key])
            assert [words, shown, shown, 'equal'] in rows
    for plan in demo.summary['planning']:
        (row,) = [row for row in rows if row[:1] == [plan['action_set']]]
        expected = [plan['sweeps'], plan['mean_return'], plan['mean_discounted_return']]
        assert [row[5], row[8], row[9]] == [_written(value) for value in expected]
    topics = {row[0]: row for row in rows if row and row[0].startswith('/')}
    assert len(topics) == demo.summary['bag']['topics']
    total = sum(int(row[2].replace(',', '')) for row in topics.values())
    assert total == demo.summary['bag']['messages']
    assert {row[4] for row in topics.values()} <= {'0', '\N{EN DASH}'}


def _written(number: float) -> str:
    return f'{number:.4g}'.replace('-', '\N{MINUS SIGN}')
