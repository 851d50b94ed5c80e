"""``bag info``: what was taught and done, what is missing, and what is attached."""

from dataclasses import replace
import json
import math
from pathlib import Path
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.ros.convert import domain_to_info, transition_to_message
from humanopts_interfaces.msg import (
    Criterion,
    LearningStatus,
    LessonState,
    OptionResult,
    OptionStatus,
    PlanResult,
    PolicyResult,
)
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_teach.bags.check import RECORDER
from humanopts_teach.bags.info import Attached, summarise
from humanopts_teach.cli import main
import pytest
from std_msgs.msg import String
from teach_support.bags import judged_run, numbered, play, write_messages

PICKUP = 'go to passenger and pickup'


def test_loss_is_counted_per_topic_and_publisher(tmp_path: Path) -> None:
    entries: list[tuple[str, Any]] = [('/a', numbered(n)) for n in (1, 2, 5, 6, 6)]
    entries += [('/a', numbered(n, '/game#2')) for n in (3, 4)]
    entries += [('/b', numbered(n)) for n in (1, 2, 3)]
    entries += [('/rosout', String(data='not numbered'))]
    info = summarise(write_messages(tmp_path / 'bag', entries, attached={'a/b.json': b'{}'}))
    assert [
        (s.topic, s.publisher, s.first, s.sent, s.recorded, s.missing, s.repeated)
        for s in info.streams
    ] == [
        ('/a', '/game#1', 1, 6, 4, 2, 1),
        ('/a', '/game#2', 3, 4, 2, 2, 0),
        ('/b', '/game#1', 1, 3, 3, 0, 0),
        ('/rosout', RECORDER, 1, 1, 1, 0, 0),
    ]
    assert [(t.name, t.messages, t.publishers, t.lost) for t in info.topics] == [
        ('/a', 7, 2, 4),
        ('/b', 3, 1, 0),
        ('/rosout', 1, None, None),
    ]
    assert info.attached == [Attached('a/b.json', 2, 'application/json')]
    assert 'missing: 4 messages' in info.to_text()


def test_the_text_is_short_with_long_names_and_many_streams(tmp_path: Path) -> None:
    entries = [('/a', numbered(2, f'{n}{"x" * 50_000}')) for n in range(60)]
    entries += [('/a', numbered(9, 'worst'))]
    info = summarise(write_messages(tmp_path / 'bag', entries, {'seed': '3'}))
    lines = replace(info, domains=['y' * 50_000]).to_text().splitlines()
    assert max(map(len, lines)) < 500
    rows = [line.split() for line in lines]
    assert ['seed', '3'] in rows
    worst = rows.index(['/a', 'worst', '9', '1', '8', '0', '0', '0'])
    assert rows[worst - 1][:2] == ['topic', 'publisher']
    assert lines[-1] == 'and 11 more streams'


def test_the_summary_counts_what_was_taught_and_done(
    tmp_path: Path, taxi: Domain, taxi_lesson: list[Demonstration]
) -> None:
    option = OptionStatus(option_name=PICKUP, participant='p1', exam_right=4, exam_runs=5)
    option.status = 'not learned: 4 of 5 runs in the exam were right'
    wrong = replace(taxi_lesson[0], uuid='taken back')
    runs = [judged_run(taxi_lesson[0], taxi_lesson, n, exam=True, right=n < 5) for n in (1, 5, 9)]
    entries: list[tuple[str, Any]] = [
        ('/domain_info', domain_to_info(taxi)),
        *(('/demonstrations', demonstration_to_message(d)) for d in [*taxi_lesson, *runs]),
        ('/demonstrations', demonstration_to_message(replace(runs[2], withdrawn=True))),
        ('/demonstrations', demonstration_to_message(taxi_lesson[0])),  # repeated
        ('/demonstrations', demonstration_to_message(wrong)),
        ('/demonstrations', demonstration_to_message(replace(wrong, withdrawn=True))),
        ('/learning_status', LearningStatus(options=[option])),
        *(('/lesson_state', LessonState(participant=who, session='s2')) for who in ('', 'p1')),
        *(('/game_state', transition_to_message(m)) for m in play(taxi, ['north'])),
        *(('/option_results', OptionResult(status=code)) for code in (1, 1, 5, 12)),
        ('/plan_results', PlanResult(status=1)),
        ('/policy_results', PolicyResult(status=1, interruptions=3, execution_changes=1)),
        ('/policy_results', PolicyResult(status=2, interruptions=2)),
    ]
    info = summarise(write_messages(tmp_path / 'bag', entries))
    pickup = next(row for row in info.options if row.option == PICKUP)
    demos = [demo for demo in taxi_lesson if demo.option_name == PICKUP]
    assert (pickup.demonstrations + pickup.not_here, pickup.withdrawn) == (len(demos), 1)
    assert pickup.steps == sum(len(demo.actions) for demo in demos)
    assert (pickup.judged, pickup.exam_right, pickup.exam_runs, pickup.learned) == (2, 4, 5, False)
    assert pickup.seconds == sum(demo.seconds for demo in demos)
    assert (info.participants, info.sessions) == (['p1'], ['s1', 's2'])
    assert info.results == {
        'option runs': {'reached': 2, 'interrupted': 1, 'stopped_by_plan': 1},
        'plans': {'converged': 1},
        'policy runs': {'done': 1, 'canceled': 1},
    }
    assert (info.interruptions, info.execution_changes) == (5, 1)
    assert (info.episodes, info.episodes_ended) == (1, 0)
    assert (info.messages, info.missing) == (len(entries), 0)
    assert info.duration == (len(entries) - 1) * 10**9
    found = json.loads(json.dumps(info.to_dict(), allow_nan=False))
    assert found['options'][0]['option'] == PICKUP
    lines = info.to_text().splitlines()
    assert 'option runs: interrupted 1, reached 2, stopped_by_plan 1' in lines
    assert f'{PICKUP!r} by p1: {option.status}' in lines


def test_info_of_several_bags_shows_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [str(tmp_path / name) for name in 'ab']
    for count, path in enumerate(paths, start=1):
        write_messages(Path(path), [('/x', numbered(n)) for n in range(1, count + 1)])
    assert main(['bag', 'info', *paths]) == 0
    heads = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [words for words in heads if words[:1] == ['bag']] == [['bag', path] for path in paths]
    assert main(['bag', 'info', '--json', *paths]) == 0
    several = json.loads(capsys.readouterr().out)
    assert [(found['path'], found['messages']) for found in several] == list(zip(paths, (1, 2)))
    assert main(['bag', 'info', '--json', paths[1]]) == 0
    assert json.loads(capsys.readouterr().out) == several[1]


def test_criteria_have_a_history_and_the_time_they_were_first_met(tmp_path: Path) -> None:
    statuses = []
    for shown, value in [(1, math.nan), (2, 0.3), (2, 0.3), (3, 0.05), (4, 0.2)]:
        criterion = Criterion(name='initiation', value=value, threshold=0.1)
        criterion.measurable, criterion.met = value == value, value <= 0.1
        option = OptionStatus(participant='p1', option_name=PICKUP, n_demonstrations=shown)
        option.criteria = [criterion]
        statuses.append(('/learning_status', LearningStatus(options=[option])))
    info = summarise(write_messages(tmp_path / 'bag', statuses))
    assert [(row.demonstrations, row.value, row.seconds, row.met) for row in info.criteria] == [
        (1, None, 0.0, False),
        (2, 0.3, 1.0, False),
        (3, 0.05, 3.0, True),
        (4, 0.2, 4.0, False),
    ]
    lines = [line for line in info.to_text().splitlines() if 'initiation' in line]
    first, last = (line.split('initiation')[1].split() for line in lines)
    assert first == ['0.1', '3', '0', '3.0', '0.05', 'yes']
    assert last == ['0.1', '4', '0', '4.0', '0.2', 'no']
