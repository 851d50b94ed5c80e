"""One demo from end to end, and what it leaves: summary, report, options and bag."""

from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import ExitStack
import json
from pathlib import Path
import re
from typing import Any

from graph_support.command import Command, DemoRun, EPISODES, run_demo, shown_in_bag, shown_on_disk
from humanopts_env.domains.base import action_index
from humanopts_env.domains.taxi import Taxi
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import judged, Kind, shown
from humanopts_learner.options.files import option_from_json
from humanopts_teach.bags.check import check_bag
from humanopts_teach.bags.contents import Episode, read_episodes
from humanopts_teach.bags.info import summarise
from humanopts_teach.bags.reader import Bag, DEMONSTRATION, open_bag
from humanopts_teach.cli import main
import numpy as np
import pytest
from teach_support.bags import without
from teach_support.snapshot import check

ROOT = Path(__file__).parents[1]
PICKUP, DROPOFF = 'go to passenger and pickup', 'go to destination and dropoff'


@pytest.fixture(scope='module')
def bag(demo: DemoRun) -> Bag:
    """The demo's bag."""
    return open_bag(demo.bag)


@pytest.fixture(scope='module')
def episodes(bag: Bag) -> list[Episode]:
    """Every episode in it, those of the lesson first."""
    return list(read_episodes(bag))


def test_demo_keeps_its_promises_and_says_so_stage_by_stage(demo: DemoRun) -> None:
    assert (demo.status, demo.errors) == (0, '')
    played = f'playing {EPISODES} episodes'
    stages = ['teaching', 'planning', played, 'evaluating the bag', 'writing']
    places = [demo.output.index(f'\n{stage}') for stage in stages]
    assert places == sorted(places)
    assert 0 < demo.first_state_after < demo.seconds / 2
    assert re.search(rf'^{PICKUP}: \d+ shown, .*; learned', demo.output, re.M)
    assert f'{EPISODES} of {EPISODES} episodes done by running options, 0 fallbacks' in demo.output
    assert demo.output.count(', over all starts -10.07\n') == 2  # of every plan that is optimal
    assert demo.output.endswith(f'report: {demo.folder / "report.html"}\n')
    assert '\x1b' not in demo.output
    report = (demo.folder / 'report.html').read_text('utf-8')
    frames = len(list(read_episodes(open_bag(demo.bag)))[-1].transitions)
    assert report.partition('<h2 id="episode">')[2].count('<li class=') == frames


def test_summary_has_exactly_its_schema(demo: DemoRun) -> None:
    check('summary_types.txt', '\n'.join(_kinds(demo.summary, '')))
    assert [row['action_set'] for row in demo.summary['planning']] == ['human', 'primitive']
    assert [option['option_name'] for option in demo.summary['options']] == [PICKUP, DROPOFF]
    assert (demo.summary['domain'], demo.summary['seed']) == ('taxi', 1)
    assert demo.summary['ended_nodes'] == []
    assert demo.summary['teaching']['teacher_error_rate'] > 0


def _kinds(value: Any, place: str) -> Iterator[str]:
    """Yield the path of each value of JSON data with its type; of a list, the first entry's."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _kinds(part, f'{place}.{key}'.lstrip('.'))
    elif isinstance(value, list) and value:
        yield from _kinds(value[0], f'{place}[]')
    else:
        yield f'{place}: {type(value).__name__}'


def test_criteria_are_met_and_every_episode_is_delivered_without_a_fallback(
    demo: DemoRun, bag: Bag
) -> None:
    limits = demo.summary['teaching']['thresholds']
    for option in demo.summary['options']:
        assert option['criteria_met']
        assert option['learned']
        assert option['initiation'] <= limits['initiation_error']
        assert option['termination'] <= limits['termination_error']
    played = demo.summary['execution']
    counts = (played['episodes'], played['successes'], played['fallbacks'])
    assert counts == (EPISODES, EPISODES, 0)
    runs = Counter(each.option_name for each in messages(bag, '/option_results'))
    runs -= Counter(run.option_name for run in judged(shown_in_bag(bag)) if run.exam)
    assert runs == {PICKUP: EPISODES, DROPOFF: EPISODES}


def test_mean_return_is_that_of_the_episodes_and_near_the_optimum(
    demo: DemoRun, episodes: list[Episode]
) -> None:
    domain, played = Taxi(), episodes[-EPISODES:]
    assert all(episode.complete and episode.transitions[-1].terminated for episode in played)
    mean = sum(moment.reward for episode in played for moment in episode.transitions) / EPISODES
    assert demo.summary['execution']['mean_return'] == pytest.approx(mean, abs=1e-12)
    best = _best_returns(domain)
    starts = [domain.index(domain.decode(episode.transitions[0].state)) for episode in played]
    optimum = best[starts].mean()
    assert abs(mean - optimum) <= 0.02 * abs(optimum)
    primitive = demo.summary['planning'][1]['mean_return']
    assert abs(mean - primitive) <= 0.02 * abs(primitive)


def _best_returns(domain: Taxi) -> np.ndarray:
    """Return (S,): the largest undiscounted return from every state, by sweeps over the rules."""
    table, best = domain.transitions(), np.zeros(domain.n_states)
    for _ in range(domain.max_steps):
        after = np.where(table.terminated[..., 0], 0.0, best[table.successor[..., 0]])
        best = np.where(domain.over(), 0.0, (table.reward[..., 0] + after).max(axis=1))
    return best


def test_game_states_replay_exactly_in_the_rules(episodes: list[Episode]) -> None:
    domain, rng = Taxi(), generator(0, 'replay')
    steps = 0
    for episode in episodes:
        for before, after in zip(episode.transitions, episode.transitions[1:]):
            action = action_index(domain, after.previous_action)
            outcome = domain.step(domain.decode(before.state), action, rng)
            assert after.step == before.step + 1
            assert domain.encode(outcome.state) == after.state
            assert (outcome.reward, outcome.terminated) == (after.reward, after.terminated)
            assert tuple(domain.feature_values(outcome.state)) == after.features
            steps += 1
    assert steps > 300


def messages(bag: Bag, topic: str) -> list[Any]:
    return [recorded.message for recorded in bag.messages([topic])]


def test_every_step_answers_one_recorded_command(bag: Bag) -> None:
    sent = {(m.publisher_id, m.sequence): m for m in messages(bag, '/action')}
    led = [m for m in messages(bag, '/game_state') if m.previous_action]
    answered = [(m.action_publisher_id, m.action_sequence) for m in led]
    assert len(set(answered)) == len(answered) == len(sent)
    for state, key in zip(led, answered):
        command = sent[key]
        assert (command.action, command.source) == (state.previous_action, state.action_source)
        assert (command.episode, command.step + 1) == (state.episode, state.step)


def test_no_message_is_lost_and_the_summary_counts_them(demo: DemoRun, bag: Bag) -> None:
    streams = summarise(bag).streams
    assert [stream for stream in streams if stream.missing or stream.repeated] == []
    assert len(streams) > 20
    assert bag.damage == ''
    counted = (demo.summary['bag']['messages'], demo.summary['bag']['topics'])
    assert counted == (bag.n_messages, len(bag.topics))


def test_every_service_call_is_recorded_by_both_its_ends(bag: Bag) -> None:
    names = [name for name in bag.topics if name.endswith('/_service_event')]
    calls = defaultdict(list)  # with Jazzy, the ends call the client differently
    for recorded in bag.messages(names):
        info = recorded.message.info
        end = (recorded.topic, tuple(info.client_gid), info.sequence_number)
        calls[end].append(info.event_type)
    assert {tuple(sorted(events)) for events in calls.values()} <= {(0, 3), (1, 2), (0, 1, 2, 3)}
    asked = [topic for (topic, *_), events in calls.items() if 0 in events]
    answered = [topic for (topic, *_), events in calls.items() if 1 in events]
    assert Counter(asked) == Counter(answered)
    assert len(asked) > 150


def test_demonstrations_in_the_bag_are_those_on_disk(demo: DemoRun, bag: Bag) -> None:
    on_disk, in_bag = shown_on_disk(demo.folder), shown_in_bag(bag)
    assert in_bag == on_disk
    shown = [d.option_name for d in on_disk if d.kind is Kind.TRAJECTORY]
    for option in demo.summary['options']:
        assert shown.count(option['option_name']) == option['n_demonstrations']


def test_option_files_load_again_and_are_the_taught_options(demo: DemoRun, bag: Bag) -> None:
    files = sorted((demo.folder / 'options/p1').glob('*.json'))
    loaded = {o.name: (o, d) for o, d in (option_from_json(f.read_text('utf-8')) for f in files)}
    taught = {option['option_name']: option for option in demo.summary['options']}
    assert set(loaded) == set(taught) == {PICKUP, DROPOFF}
    for name, (option, demonstrations) in loaded.items():
        assert list(option.features) == taught[name]['features']
        in_bag = shown(shown_in_bag(bag))
        assert demonstrations == [demo for demo in in_bag if demo.option_name == name]


def test_offline_numbers_equal_the_live_ones_exactly(demo: DemoRun) -> None:
    offline = demo.summary['offline']
    assert offline['options'] == demo.summary['options']
    seconds = {'table_seconds', 'model_seconds', 'sweep_seconds'}
    for live, again in zip(demo.summary['planning'], offline['planning'], strict=True):
        assert {k for k in live if live[k] != again[k]} <= seconds


def test_without_demonstrations_of_an_option_the_bag_gives_other_numbers_of_it_alone(
    demo: DemoRun, bag: Bag, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shown = [d for d in shown_in_bag(bag) if d.option_name == PICKUP]
    left_out = {demo.uuid for demo in [d for d in shown if d.kind is Kind.TRAJECTORY][3:]}
    cut = without(demo.bag, tmp_path / 'cut.mcap', DEMONSTRATION, lambda m: m.uuid in left_out)
    assert open_bag(cut).n_messages == bag.n_messages - len(left_out)
    assert main(['bag', 'eval', '--json', str(cut)]) == 0
    pickup, dropoff = json.loads(capsys.readouterr().out)['options']
    alone, same = demo.summary['options']
    assert {key: dropoff[key] for key in same} == same
    changed = {key for key in alone if pickup[key] != alone[key]}
    assert {'n_demonstrations', 'mean_return_demonstrations'} <= changed


@pytest.mark.slow  # a whole demo of its own
def test_demo_that_was_too_short_to_teach_says_what_is_missing(
    tmp_path: Path, domain_id: int
) -> None:
    short = run_demo(tmp_path, domain_id, '--seed', 1, '--budget', 1, '--episodes', 3)
    assert short.status == 1
    problems = short.errors.splitlines()
    assert all(problem.startswith('humanopts demo: ') for problem in problems)
    assert f'humanopts demo: {PICKUP!r} is not learned: the criteria are not met' in problems
    assert f'humanopts demo: {DROPOFF!r} was not taught' in problems
    assert short.summary['execution']['successes'] < 3
    assert (short.folder / 'report.html').stat().st_size > 10_000


def test_where_states_cannot_be_listed_the_demo_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(['demo', '--domain', 'pacman', '--learn', 'goal']) == 2
    said = capsys.readouterr().err
    assert said.startswith('humanopts demo: the states of pacman cannot be listed')
    assert said.count('\n') == 1


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_eight_games_side_by_side_are_each_recorded_whole(tmp_path: Path, domain_id: int) -> None:
    """Of one ROS_DOMAIN_ID, in namespaces; nothing of one game reaches another's bag."""
    names = [f'game_{number}' for number in range(8)]
    with ExitStack() as stack:
        commands = []
        for seed, name in enumerate(names):
            (folder := tmp_path / name).mkdir()
            words = ('--namespace', f'/{name}', '--seed', seed, '--episodes', EPISODES)
            command = Command(['demo', '--out', folder / 'out', *words], folder, domain_id)
            stack.callback(command.close)
            commands.append(command)
        ends = [(command.ended(900), command.errors) for command in commands]
    assert ends == [(0, '')] * len(names)
    for name in names:
        out = tmp_path / name / 'out'
        bag = open_bag(out / 'bag')
        assert check_bag(bag).findings == []
        assert shown_in_bag(bag) == shown_on_disk(out)
        assert {part for topic in bag.topics if (part := topic.split('/')[1]) in names} == {name}
        summary = json.loads((out / 'summary.json').read_text('utf-8'))
        assert summary['offline']['options'] == summary['options']
        assert summary['ended_nodes'] == []
