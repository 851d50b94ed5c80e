"""Lessons of a reproduction against those over the graph; bags in place of simulated people."""

from collections.abc import Iterable
import csv
import json
from pathlib import Path
import signal
from typing import Any

from graph_support.command import Command, DemoRun
from humanopts_env.domains.registry import make_domain
from humanopts_learner.demonstrations import Demonstration, judged, shown
from humanopts_teach.bags.contents import read_demonstrations
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.cli import main
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.simulated_teacher import TeacherSettings
import pytest

from experiments.people import options_of, owners, PERSON, read_bag_lessons, Study


def without_time(demonstrations: Iterable[Demonstration]) -> list[dict[str, Any]]:
    """Return the demonstrations; only the clock differs between two lessons."""
    once = {d.uuid: json.loads(d.to_json()) for d in demonstrations}
    return [{**values, 'seconds': 0} for values in once.values()]


def test_lesson_in_one_process_is_that_over_the_graph(demo: DemoRun) -> None:
    live = read_demonstrations(open_bag(demo.bag))
    domain, seed = make_domain('taxi'), 1
    settings = demo.summary['teaching']
    names = tuple(dict.fromkeys(d.option_name for d in live))

    taught = teach(
        domain,
        TeacherSettings(
            names,
            participant=live[0].participant,
            session=live[0].session,
            error_rate=settings['teacher_error_rate'],
            seed=seed,
        ),
        LessonRules(settings['strategy'], settings['budget'], seed),
    )
    assert taught.cut_short == ''
    assert without_time(taught.demonstrations) == without_time(shown(live))
    assert without_time(taught.judged) == without_time(judged(live))
    assert [option.name for option in taught.options] == list(names)


def test_bags_stand_in_for_simulated_people(demo: DemoRun, tmp_path: Path) -> None:
    bag = demo.bag
    arguments = ['reproduce', 'fig2', '--jobs', '1', '--bags', str(bag)]
    assert main([*arguments, '--out', str(tmp_path)]) == 0
    with (tmp_path / 'fig2-people.csv').open(encoding='utf-8') as file:
        rows = {row['option']: row for row in csv.DictReader(file)}
    for block in demo.summary['options']:
        row = rows[block['option_name']]
        assert float(row['last accuracy of policy']) == block['policy_accuracy']
    page = (tmp_path / 'report.html').read_text('utf-8')
    assert str(bag.resolve()) in page
    assert '<b>simulated</b>' not in page


def test_options_from_a_bag_are_those_that_were_taught(demo: DemoRun) -> None:
    (person,) = owners(Study(bags=tuple(read_bag_lessons(demo.bag))), 'taxi')[PERSON]
    taught = options_of(person, make_domain('taxi'))
    blocks = demo.summary['options']
    assert [option.name for option in taught.options] == [block['option_name'] for block in blocks]
    assert taught.demonstrations == sum(block['n_demonstrations'] for block in blocks)
    assert taught.minutes is not None
    assert 0 < taught.minutes < 5


@pytest.mark.parametrize(
    'interrupt',
    [
        pytest.param(signal.SIG_DFL, id='shell', marks=pytest.mark.slow),
        pytest.param(signal.SIG_IGN, id='script'),
    ],
)
def test_ctrl_c_says_how_to_go_on_and_leaves_no_process(
    tmp_path: Path, domain_id: int, interrupt: signal.Handlers
) -> None:
    arguments = ['reproduce', 'fig2', '--out', tmp_path / 'out', '--participants', 1, '--jobs', 2]
    command = Command(arguments, tmp_path, domain_id, interrupt)
    try:
        command.until(lambda: len(command.running()) >= 2, 'two processes compute')
        command.send(signal.SIGINT)
        assert command.ended(30) == 130, command.errors
        assert 'continues from here' in command.errors
        assert 'Traceback' not in command.errors
        command.gone(20)  # the tracker of resources ends after the others
    finally:
        command.close()
