"""What a bag says: demonstrations, domain, episodes, numbers, and the last episode of a game."""

from pathlib import Path
import re
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_env.domains.registry import make_domain
from humanopts_env.ros.convert import domain_to_info, transition_to_message
from humanopts_interfaces.msg import ActionCommand, GameState, OptionResult
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
)
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_teach.bags import BagError
from humanopts_teach.bags.check import repair
from humanopts_teach.bags.contents import (
    find_episodes,
    read_actors,
    read_demonstrations,
    read_domain,
    read_episodes,
)
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.bags.sequence_numbers import read_stamp, Stamp, Stream
from humanopts_teach.bags.writer import GAME, GAME_IDS
from humanopts_teach.report.episode import read_last_episode
from hypothesis import given, strategies
import pytest
from rclpy.serialization import serialize_message
from teach_support.bags import numbered, play, write_messages


def test_demonstrations_come_back_equal_except_for_those_of_unknown_kind(
    tmp_path: Path, taxi: Domain, taxi_lesson: list[Demonstration]
) -> None:
    messages = [demonstration_to_message(demo) for demo in [taxi_lesson[0], *taxi_lesson]]
    messages[0].kind = 0
    bag = write_messages(tmp_path / 'bag', [('/ns/demonstrations', each) for each in messages])
    assert read_demonstrations(bag) == taxi_lesson
    assert 'left out' in bag.damage
    for demo in taxi_lesson:
        check_demonstration(demo, taxi)


def test_a_bag_without_demonstrations_says_so(tmp_path: Path) -> None:
    bag = write_messages(tmp_path / 'bag', [('/game_state', numbered(1))])
    with pytest.raises(BagError, match='no topic of demonstrations'):
        read_demonstrations(bag)


def test_the_domain_comes_back_with_its_parameters_or_the_reason_is_named(tmp_path: Path) -> None:
    domain = make_domain('taxi', {'rows': 8, 'cols': 7})
    large, other = domain_to_info(domain), domain_to_info(domain)
    taxi, unknown = domain_to_info(make_domain('taxi')), domain_to_info(domain)
    found = read_domain(write_messages(tmp_path / 'bag', [('/domain_info', large)]))
    assert (found.name, dict(found.parameters)) == ('taxi', dict(domain.parameters))
    unknown.domain = 'chess'
    other.publisher_id, other.sequence = '/game#2', 1
    cases = [
        ([('/game_state', numbered(1))], 'does not say which domain'),
        ([('/domain_info', unknown)], "unknown domain 'chess'"),
        ([('/domain_info', taxi), ('/domain_info', other)], 'several domains'),
        ([('/a/domain_info', taxi), ('/b/domain_info', other)], 'several namespaces: /a, /b'),
    ]
    for number, (entries, reason) in enumerate(cases):
        bag = write_messages(tmp_path / f'bag{number}', entries)
        with pytest.raises(BagError, match=reason):
            read_domain(bag)


def test_episodes_come_back_in_order_and_once(tmp_path: Path, taxi: Domain) -> None:
    transitions = play(taxi, ['north', 'east', 'south'])
    entries = [
        (topic, transition_to_message(transition))
        for transition in transitions
        for topic in ('/game_state', '/current_state')
    ]
    (episode,) = read_episodes(write_messages(tmp_path / 'bag', entries))
    assert list(episode.transitions) == transitions
    assert (episode.number, episode.complete) == (1, False)


TEXT = strategies.text('a\x1f\u00e9\u20ac\U0001f600', max_size=20)  # letters of one to four bytes


@given(TEXT, strategies.integers(0, 2**64 - 1), TEXT)
def test_a_stamp_is_read_without_decoding(publisher: str, sequence: int, frame: str) -> None:
    message = GameState(publisher_id=publisher, sequence=sequence)
    message.header.frame_id = frame
    assert read_stamp(serialize_message(message)) == Stamp(publisher, sequence)


@pytest.mark.parametrize('data', [b'', b'\0\1\0\0', b'\0\1\0\0' + b'\xff' * 30])
def test_a_stamp_of_damaged_bytes_is_none(data: bytes) -> None:
    assert read_stamp(data) is None


@given(strategies.lists(strategies.integers(1, 30), min_size=1))
def test_a_stream_counts_like_a_set(numbers: list[int]) -> None:
    stream = Stream()
    for number in numbers:
        stream.add(number)
    distinct, last = set(numbers), max(numbers)
    assert (stream.first, stream.sent, stream.recorded) == (min(distinct), last, len(distinct))
    assert stream.repeated == len(numbers) - len(distinct)
    assert stream.missing == last - len(distinct)


def test_the_last_episode_is_of_the_chosen_game_even_where_two_count_alike(
    tmp_path: Path, taxi: Domain
) -> None:
    refused = OptionResult(option_name='unknown', status=OptionResult.STATUS_UNKNOWN_OPTION)
    entries: list[tuple[str, Any]] = [('/left/option_results', refused)]
    for where, actions in (('left', ['north', 'east']), ('right', ['south', 'south', 'west'])):
        states = [transition_to_message(transition) for transition in play(taxi, actions)]
        states[-1].terminated = True
        entries += [(f'/{where}/game_state', state) for state in states]
        run = OptionResult(option_name=where, episode=1, step_count=len(actions), terminated=True)
        entries.append((f'/{where}/option_results', run))
    bag = write_messages(tmp_path / 'bag', entries)
    with pytest.raises(BagError, match='choose one with --namespace'):
        read_last_episode(bag)
    frames = read_last_episode(open_bag(bag.path, namespace='/right'))
    assert [frame.action for frame in frames] == ['', 'south', 'south', 'west']
    assert [frame.option for frame in frames] == ['', 'right', 'right', 'right']
    assert [frame.ends_run for frame in frames] == [False, False, False, True]


def test_the_last_episode_of_modules_names_the_module_of_each_step(
    tmp_path: Path, taxi: Domain
) -> None:
    states = [
        transition_to_message(transition) for transition in play(taxi, ['south', 'west', 'west'])
    ]
    states[-1].terminated = True
    entries: list[tuple[str, Any]] = [('/game_state', state) for state in states]
    for state, name in zip(states[1:], ('down', 'left', 'action:west')):
        command = ActionCommand(
            publisher_id=state.action_publisher_id,
            sequence=state.action_sequence,
            option_name=name,
        )
        entries.append(('/action', command))
    run = OptionResult(episode=1, step_count=3, terminated=True, execution='modular_mass')
    entries.append(('/option_results', run))
    frames = read_last_episode(write_messages(tmp_path / 'bag', entries))
    assert [frame.option for frame in frames] == ['', 'down', 'left', 'action:west']
    assert [frame.ends_run for frame in frames] == [False, False, False, True]


def test_messages_of_another_definition_are_left_out_and_noted(
    tmp_path: Path, taxi: Domain, taxi_lesson: list[Demonstration]
) -> None:
    bag = write_messages(
        tmp_path / 'bag',
        [
            *(('/game_state', transition_to_message(m)) for m in play(taxi, ['north'])),
            ('/domain_info', domain_to_info(taxi)),
            ('/demonstrations', demonstration_to_message(taxi_lesson[0])),
            ('/action', ActionCommand()),
        ],
    )
    for topic in bag.topics.values():
        topic.schema = re.sub('(publisher_id|domain|step) ', r'x\1 ', topic.schema)
    assert list(read_episodes(bag)) == []
    assert summarise(bag).episodes == 0
    assert read_demonstrations(bag) == []
    assert read_actors(bag) == {}
    with pytest.raises(BagError, match='does not say which domain'):
        read_domain(bag)
    assert len(bag.damage.splitlines()) >= 4


def games(taxi: Domain) -> list[tuple[str, GameState]]:
    """Return the states of three episodes, the second left, and of a game that came later."""
    entries = []
    for publisher, number, length in (
        ('/a#1', 1, 3),
        ('/a#1', 2, 2),
        ('/a#1', 3, 4),
        ('/b#1', 1, 2),
    ):
        for transition in play(taxi, ['north', 'east', 'south'][: length - 1]):
            state = transition_to_message(transition)
            state.episode, state.publisher_id = number, publisher
            state.sequence = len(entries) + 1
            entries.append(('/game_state', state))
    return entries


def test_episodes_that_cannot_be_read_and_late_states_are_left_out(
    tmp_path: Path, taxi: Domain
) -> None:
    entries = games(taxi)
    for _, state in entries[3:5]:
        state.action_source = 77
    entries.append(entries.pop(2))
    bag = write_messages(tmp_path / 'bag', entries)
    episodes, found = list(read_episodes(bag)), find_episodes(bag)
    assert [(each.number, len(each.transitions)) for each in episodes] == [(1, 2), (3, 4), (1, 2)]
    assert found[2].transitions == episodes[2].transitions
    assert [each.transitions for each in found] == [each.transitions for each in episodes]
    assert '77 is not a valid Source' in bag.damage
    assert 'after a later episode are left out' in bag.damage


def forged(taxi: Domain, publisher: str) -> list[tuple[str, Any]]:
    """Return a game of Taxi that is announced, as is a game by another publisher."""
    other, mine = domain_to_info(make_domain('rooms')), domain_to_info(taxi)
    other.publisher_id, other.sequence = publisher, 1
    mine.publisher_id, mine.sequence = '/game#1', 1
    states = [transition_to_message(each) for each in play(taxi, ['north', 'east'])]
    announced = ('/domain_info', mine)
    return [('/domain_info', other), announced, *(('/game_state', state) for state in states)]


@pytest.mark.parametrize(
    ('publisher', 'words'),
    [
        ('/stranger#1', 'from /stranger#1, not from /game'),
        ('', 'from no node, not from /game'),
        ('/game#2', 'from /game#2, which was not the game'),
        ('/game#1', 'from /game#1, another game than taxi {"cols": 5, "rows": 5}'),
    ],
)
def test_a_game_that_another_node_announced_does_not_count_in_a_bag_of_another_program(
    tmp_path: Path, taxi: Domain, publisher: str, words: str
) -> None:
    entries = forged(taxi, publisher)
    if publisher == '/game#1':  # what a process announces first is its game
        entries[:2] = reversed(entries[:2])
    bag = write_messages(tmp_path / 'bag', entries)
    assert read_domain(bag).name == 'taxi'
    assert [len(episode.transitions) for episode in read_episodes(bag)] == [3]
    assert bag.notes == [f'left out: 1 message on /domain_info: {words}']
    assert bag.damage == ''


@pytest.mark.parametrize('kept', ['[' * 100_000, '{}', '[]'])
def test_a_damaged_record_of_the_game_is_said_and_the_bag_is_read(
    tmp_path: Path, taxi: Domain, kept: str
) -> None:
    opened = write_messages(tmp_path / 'bag', forged(taxi, '/stranger#1'))
    opened.metadata[GAME] = {GAME_IDS: kept}
    repair(opened, tmp_path / 'kept')
    bag = open_bag(tmp_path / 'kept')
    assert read_domain(bag).name == 'taxi'
    assert ('humanopts_game is damaged' in bag.damage) is (kept != '[]')
