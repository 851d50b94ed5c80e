"""``bag info``: what was taught and done, what is missing, and what is attached."""

from dataclasses import replace
import json
import math
from pathlib import Path
import re
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
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.bags.writer import BagWriter
from humanopts_teach.cli import main
import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from teach_support.bags import numbered, play, write_messages

PICKUP = 'go to passenger and pickup'


def test_gaps_made_by_hand_are_counted_per_topic_and_publisher(tmp_path: Path) -> None:
    entries: list[tuple[str, Any]] = [('/a', numbered(n)) for n in (1, 2, 5, 6, 6)]
    entries += [('/a', numbered(n, '/game#2')) for n in (3, 4)]
    entries += [('/b', numbered(n)) for n in (1, 2, 3)]
    entries += [('/rosout', String(data='not numbered'))]
    bag = write_messages(tmp_path / 'bag', entries)
    info = summarise(bag)
    rows = {
        (s.topic, s.publisher): (s.first, s.last, s.received, s.missing, s.duplicates)
        for s in info.streams
    }
    assert rows == {
        ('/a', '/game#1'): (1, 6, 4, 2, 1),
        ('/a', '/game#2'): (3, 4, 2, 2, 0),
        ('/b', '/game#1'): (1, 3, 3, 0, 0),
    }
    assert info.missing == 4
    assert [(t.name, t.messages, t.publishers, t.lost) for t in info.topics] == [
        ('/a', 7, 2, 4),
        ('/b', 3, 1, 0),
        ('/rosout', 1, None, None),
    ]
    assert 'missing: 4 messages' in info.to_text()


def test_however_long_names_are_and_however_many_the_text_is_short(tmp_path: Path) -> None:
    entries = [('/a', numbered(2, f'{n}{"x" * 50_000}')) for n in range(60)]
    entries += [('/a', numbered(9, 'worst'))]
    info = summarise(write_messages(tmp_path / 'bag', entries))
    text = replace(info, domains=['y' * 50_000]).to_text()
    assert max(map(len, text.splitlines())) < 500
    assert text.endswith('and 11 streams more')
    assert re.search(r'missing: 68 messages\n.*\n/a +worst +9 +1 +8 +0 +0 +0\n', text)


def test_the_summary_counts_what_was_taught_and_done(
    tmp_path: Path, taxi: Domain[Any], taxi_lesson: list[Demonstration]
) -> None:
    status = LearningStatus(
        options=[
            OptionStatus(
                option_name=PICKUP,
                participant='p1',
                criteria_met=True,
                criteria=[Criterion(value=math.nan)],
            )
        ]
    )
    wrong = replace(taxi_lesson[0], uuid='taken back')
    entries: list[tuple[str, Any]] = [
        ('/domain_info', domain_to_info(taxi)),
        *(('/demonstrations', demonstration_to_message(demo)) for demo in taxi_lesson),
        ('/demonstrations', demonstration_to_message(taxi_lesson[0])),  # repeated
        ('/demonstrations', demonstration_to_message(wrong)),
        ('/demonstrations', demonstration_to_message(replace(wrong, withdrawn=True))),
        ('/learning_status', status),
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
    assert pickup.demonstrations + pickup.not_here == len(demos)
    assert pickup.withdrawn == 1
    assert pickup.steps == sum(len(demo.actions) for demo in demos)
    assert pickup.criteria_met
    assert (info.participants, info.sessions) == (['p1'], ['s1', 's2'])
    assert info.results == {
        'option runs': {'reached': 2, 'interrupted': 1, 'stopped_by_plan': 1},
        'plans': {'converged': 1},
        'policy runs': {'done': 1, 'canceled': 1},
    }
    assert (info.interruptions, info.execution_changes) == (5, 1)
    assert (info.episodes, info.episodes_ended) == (1, 0)
    assert info.messages == len(entries)
    assert info.duration == (len(entries) - 1) * 10**9
    assert info.missing == 0
    assert (
        json.loads(json.dumps(info.to_dict(), allow_nan=False))['options'][0]['option'] == PICKUP
    )
    text = info.to_text()
    assert 'option runs: interrupted 1, reached 2, stopped_by_plan 1' in text
    assert 'policy runs: 5 options stopped by the plan, 1 changes of execution' in text
    assert PICKUP in text


def test_info_of_several_bags_shows_each(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [str(tmp_path / name) for name in 'ab']
    for count, path in enumerate(paths, start=1):
        write_messages(Path(path), [('/x', numbered(n)) for n in range(1, count + 1)])
    assert main(['bag', 'info', *paths]) == 0
    text = capsys.readouterr().out
    assert [line for line in text.splitlines() if line.startswith('bag ')] == [
        f'bag           {path}' for path in paths
    ]
    assert main(['bag', 'info', '--json', *paths]) == 0
    several = json.loads(capsys.readouterr().out)
    assert [(found['path'], found['messages']) for found in several] == list(zip(paths, (1, 2)))
    assert main(['bag', 'info', '--json', paths[1]]) == 0
    assert json.loads(capsys.readouterr().out) == several[1]


def test_info_tells_when_each_criterion_held_first_and_how_it_developed(tmp_path: Path) -> None:
    values = [(1, math.nan), (2, 0.3), (2, 0.3), (3, 0.05), (4, 0.2)]
    statuses = []
    for shown, value in values:
        measured = not math.isnan(value)
        criterion = Criterion(
            name='initiation',
            value=value,
            threshold=0.1,
            measurable=measured,
            met=measured and value <= 0.1,
        )
        option = OptionStatus(
            participant='p1', option_name=PICKUP, n_demonstrations=shown, criteria=[criterion]
        )
        statuses.append(LearningStatus(options=[option]))
    info = summarise(write_messages(tmp_path / 'bag', [('/learning_status', s) for s in statuses]))
    assert [(row.demonstrations, row.value, row.seconds) for row in info.criteria] == [
        *((1, None, 0.0), (2, 0.3, 1.0), (3, 0.05, 3.0), (4, 0.2, 4.0)),
    ]
    assert json.loads(json.dumps(info.to_dict(), allow_nan=False))['criteria'][2]['met']
    assert re.search(r'initiation +0\.1 +3 shown, 0 not here +3\.0 +0\.05 +0\.2\n', info.to_text())


def test_info_lists_attached_files_and_what_the_recorder_was_told(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'bag', {'lock_sha256': 'ab12', 'seed': '3'}) as writer:
        writer.add_topic('/game_state', 'humanopts_interfaces/msg/GameState')
        writer.write('/game_state', serialize_message(numbered(1)), 1)
        writer.attach('options/p1/fetch.json', b'{"a": 1}')
    info = summarise(open_bag(tmp_path / 'bag'))
    (row,) = info.attached
    assert (row.name, row.data_size, row.media_type) == (
        'options/p1/fetch.json',
        8,
        'application/json',
    )
    assert re.search(r'options/p1/fetch\.json +8 +application/json', info.to_text())
    assert re.search(r'lock sha256 +ab12\n', info.to_text())
