"""Bags of what the test says, and what is in them."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
import os
from pathlib import Path
from typing import Any
import uuid

from graph_support.scripted import DELIVER, FETCH
from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Command, Game, Source, Transition
from humanopts_env.ros.convert import domain_to_info, transition_to_message
from humanopts_interfaces.msg import ActionCommand, GameState, LessonState
from humanopts_learner.demonstrations import Demonstration, Kind, version_of
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_ros.senders import SENDERS
from humanopts_teach.bags.provenance import software
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.bags.writer import BagWriter, Limits, NO_LIMITS
from humanopts_teach.bags.writer import GAME as GAME_RECORD
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.simulated_teacher import TeacherSettings
from mcap.reader import make_reader
from rclpy.serialization import serialize_message

START = 10**18  # ns since the epoch
GAME = 'humanopts_interfaces/msg/GameState'
QOS = {
    'history': 'keep_all',
    'depth': 0,
    'reliability': 'reliable',
    'durability': 'volatile',
    'deadline': {'sec': 9223372036, 'nsec': 854775807},
    'lifespan': {'sec': 9223372036, 'nsec': 854775807},
    'liveliness': 'automatic',
    'liveliness_lease_duration': {'sec': 9223372036, 'nsec': 854775807},
    'avoid_ros_namespace_conventions': False,
}


def state(step: int) -> bytes:
    """Return the bytes of a game state."""
    filler = os.urandom(40).hex()  # does not compress
    return serialize_message(GameState(episode=1, step=step, state=filler, sequence=step + 1))


def write_states(
    path: Path, count: int, flush_every: int = 10, limits: Limits = NO_LIMITS
) -> BagWriter:
    """Write game states, one a millisecond, into a bag that stays open."""
    writer = BagWriter(path, {'seed': '7'}, limits=limits)
    writer.add_topic('/game_state', GAME, [QOS], 'RIHS01_ab')
    for step in range(count):
        time = START + step * 10**6
        writer.write('/game_state', state(step), time, time - 5)
        if (step + 1) % flush_every == 0:
            writer.flush()
    return writer


def steps(path: Path) -> list[int]:
    """Return the steps in a bag, in the order of reading."""
    return [recorded.message.step for recorded in open_bag(path).messages()]


def write_messages(
    path: Path,
    entries: Iterable[tuple[str, Any]],
    facts: Mapping[str, str] | None = None,
    *,
    start: int = 0,
    period: int = 10**9,
    flush: int = 20,
    limits: Limits = NO_LIMITS,
    attached: Mapping[str, bytes] | None = None,
) -> Bag:
    """
    Write (topic, message) pairs, signed and numbered per topic unless they are, and open the bag.

    :param start: time before the first message, ns.
    :param period: between messages, ns.
    :param flush: messages in a chunk.
    """
    numbers: dict[str, int] = {}
    with BagWriter(path, facts, limits) as writer:
        for count, (topic, message) in enumerate(entries, start=1):
            package, kind = type(message).__module__.split('.')[:2]
            writer.add_topic(topic, f'{package}/{kind}/{type(message).__name__}')
            if hasattr(message, 'publisher_id') and not message.sequence:
                numbers[topic] = numbers.get(topic, 0) + 1
                sender = SENDERS.get(topic.rpartition('/')[2], 'game')
                message.publisher_id = f'{topic.rpartition("/")[0]}/{sender}#1'
                message.sequence = numbers[topic]
            time = start + count * period
            writer.write(topic, serialize_message(message), time, time - 5)
            if count % flush == 0:
                writer.flush()
        for name, content in (attached or {}).items():
            writer.attach(name, content, times=(5, 6))
    return open_bag(path)


def numbered(sequence: int, publisher: str = '/game#1') -> GameState:
    """Return a message with a number."""
    return GameState(publisher_id=publisher, sequence=sequence, state='s')


def play(domain: Domain, actions: list[str]) -> list[Transition]:
    """Play one episode."""
    game = Game(domain)
    first = game.reset('', 3, Source.MACHINE).transition
    assert first is not None
    moments = [first]
    for action in actions:
        number = len(moments)
        game.command(Command('/x#1', number, Source.MACHINE, 1, number - 1, action))
        moments.append(game.transition)
    return moments


def write_lesson(path: Path) -> Path:
    """
    Record a short lesson of two options on Taxi, which then play the demonstrations.

    The facts are those of a launch.
    """
    domain = make_domain('taxi')
    teacher = TeacherSettings(options=(FETCH, DELIVER), participant='p1')
    shown = teach(domain, teacher, enough=lambda demos, _: len(demos) >= 8).demonstrations
    facts = {
        'domain': domain.name,
        'domain_parameters': '{}',
        'namespace': '/',
        'seed': '1',
        'budget': '12',
        'strategy': 'failures',
        'participant': 'p1',
        'success': '0.95',
        'return_share': '0.1',
        'initiation_error': '0.05',
        'termination_error': '0.05',
        'exam': '5',
        'teacher_error_rate': '0.0',
    }
    sent: list[tuple[str, Any]] = [('/domain_info', domain_to_info(domain))]
    sent.append(('/lesson_state', LessonState(participant='p1', session='s1')))
    sent += [('/demonstrations', demonstration_to_message(demo)) for demo in shown]
    game, number = Game(domain), 0
    for demo in filter(lambda demo: demo.actions, shown):
        game.reset(demo.states[0], 1, Source.MACHINE)
        sent.append(('/game_state', transition_to_message(game.transition)))
        for action in demo.actions:
            number += 1
            at = game.transition
            sender = '/option_server#1', number
            game.command(Command(*sender, Source.MACHINE, at.episode, at.step, action))
            command = ActionCommand(action=action, option_name=demo.option_name)
            command.publisher_id, command.sequence = sender
            sent.append(('/action', command))
            sent.append(('/game_state', transition_to_message(game.transition)))
    write_messages(path, sent, {**software(), **facts})
    return path


def judged_run(
    like: Demonstration, learned_from: Iterable[Demonstration], number: int, **verdict: bool
) -> Demonstration:
    """
    Return a run of the machine, as long as a demonstration, that a person judged.

    :param learned_from: what the option that ran was learned from.
    :param verdict: right, exam and stopped; False if not given.
    """
    version = version_of(learned_from)
    name = str(uuid.uuid5(uuid.NAMESPACE_OID, f'{like.uuid} {version} {number}'))
    run = replace(like, kind=Kind.JUDGED, uuid=name, number=number, option_version=version)
    return replace(run, can_start_at_end=False, machine_steps=0, **verdict)


def without(bag: Path, copy: Path, type_name: str, omit: Callable[[Any], bool]) -> Path:
    """Copy a bag without the messages of a type that match."""
    opened = open_bag(bag)
    with BagWriter(copy, opened.facts) as writer:
        writer.note(GAME_RECORD, opened.metadata[GAME_RECORD])
        for each in opened.messages():
            if each.type != type_name or not omit(each.message):
                writer.add_topic(each.topic, each.type)
                writer.write(each.topic, each.data, each.log_time, each.publish_time)
    return copy


def cut_short(bag: Path, copy: Path, part: int) -> Path:
    """Copy a part of a bag's MCAP file, up to the middle of the last chunk that begins in it."""
    (source,) = open_bag(bag).files
    content = source.read_bytes()
    with source.open('rb') as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    *_, last = [c for c in summary.chunk_indexes if c.chunk_start_offset < len(content) // part]
    copy.write_bytes(content[: last.chunk_start_offset + last.chunk_length // 2])
    return copy
