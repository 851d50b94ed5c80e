"""Bags for other tools: tables and datasets say what was recorded, and step again."""

from collections.abc import Iterator
import json
from pathlib import Path
from typing import Any

from humanopts_env.domains.base import Action, Domain, Feature
from humanopts_env.domains.described import DescribedDomain
from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Command, Game, Source, Transition
from humanopts_env.ros.convert import domain_to_info, transition_to_message
from humanopts_env.seeding import generator
from humanopts_interfaces.msg import ActionCommand, PlanResult
from humanopts_interfaces.srv import ResetGame
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_teach.bags import BagError
from humanopts_teach.bags.contents import read_domain
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.bags.writer import BagWriter
from humanopts_teach.cli import main
from humanopts_teach.export.minari_dataset import dataset_name, FOLDER, write_dataset
from humanopts_teach.export.tables import bag_tables, ExportError, Table, write_tables
import numpy as np
import pandas as pd
import pytest
from rclpy.serialization import serialize_message
from service_msgs.msg import ServiceEventInfo

MESSAGES = 'humanopts_interfaces/msg/'
EVENT = 'humanopts_interfaces/srv/ResetGame_Event'
STEPS = 30


def entries(
    domain: Domain[Any], episodes: int, demos: list[Demonstration]
) -> Iterator[tuple[str, str, Any]]:
    """Yield (topic, type, message) of some episodes with random actions by two modules."""
    yield '/domain_info', f'{MESSAGES}DomainInfo', domain_to_info(domain)
    for demo in demos:
        yield '/demonstrations', f'{MESSAGES}Demonstration', demonstration_to_message(demo)
    game, rng = Game(domain), generator(1, 'actions of a test')
    sent = 0
    for number in range(1, episodes + 1):
        start = domain.encode(domain.reset(rng)) if number % 2 else ''
        transition = game.reset(start, number + 40, Source.MACHINE).transition
        assert transition is not None
        yield from events(number, start, transition.state)
        yield '/game_state', f'{MESSAGES}GameState', transition_to_message(transition)
        while game.transition.open and game.transition.step < STEPS:
            sent += 1
            action = domain.actions[rng.integers(len(domain.actions))].name
            at = game.transition.step
            command = Command('/option_server#1', sent, Source.MACHINE, number, at, action)
            game.command(command)
            yield (
                '/action',
                f'{MESSAGES}ActionCommand',
                ActionCommand(
                    publisher_id='/option_server#1',
                    sequence=sent,
                    action=action,
                    option_name=f'module {sent % 2}',
                ),
            )
            yield '/game_state', f'{MESSAGES}GameState', transition_to_message(game.transition)
    yield (
        '/plan_results',
        f'{MESSAGES}PlanResult',
        PlanResult(
            publisher_id='/planner#1',
            plan_id='p',
            status=1,
            option_names=['eat', 'flee'],
            mean_return=float('nan'),
            sweeps=3,
        ),
    )


def events(number: int, start: str, state: str) -> Iterator[tuple[str, str, Any]]:
    """Yield what introspection tells of a reset."""
    asked = ResetGame.Request(source=2, start_state=start, seed=number + 40)
    answer = ResetGame.Response(status=1, episode=number, state=state)
    for kind, parts in ((1, {'request': [asked]}), (2, {'response': [answer]})):
        info = ServiceEventInfo(event_type=kind, sequence_number=number)
        yield '/reset_game/_service_event', EVENT, ResetGame.Event(info=info, **parts)


def record(
    path: Path, domain: Domain[Any], episodes: int, demos: list[Demonstration] | None = None
) -> Bag:
    """Write a bag."""
    with BagWriter(path) as bag:
        for time, (topic, kind, message) in enumerate(entries(domain, episodes, demos or [])):
            bag.add_topic(topic, kind)
            if hasattr(message, 'publisher_id') and not message.publisher_id:
                message.publisher_id, message.sequence = '/game#1', time + 1
            bag.write(topic, serialize_message(message), time + 1)
    return open_bag(path)


def frames(bag: Bag) -> dict[str, pd.DataFrame]:
    """Return the tables of a bag as data frames."""
    return {
        name: pd.DataFrame(table.rows, columns=[*table.columns])
        for name, table in bag_tables(bag).items()
    }


@pytest.fixture(scope='module')
def bag(
    tmp_path_factory: pytest.TempPathFactory,
    taxi: Domain[Any],
    taxi_lesson: list[Demonstration],
) -> Bag:
    """Two demonstrations, three episodes and a plan."""
    return record(tmp_path_factory.mktemp('exported') / 'bag', taxi, 3, taxi_lesson[:2])


def test_step_table_has_every_state_with_the_step_that_led_to_it(
    bag: Bag, taxi: Domain[Any]
) -> None:
    steps = frames(bag)['steps']
    assert len(steps) == 3 * (STEPS + 1)
    assert list(steps['episode']) == [1] * 31 + [2] * 31 + [3] * 31
    assert list(steps['step'][:32]) == [*range(31), 0]
    first, second = (taxi.decode(text) for text in steps['state'][:2])
    action = [a.name for a in taxi.actions].index(steps['action'][1])
    outcome = taxi.step(first, action, generator(0, 'not used'))
    assert (outcome.state, outcome.reward) == (second, steps['reward'][1])
    row = taxi.features[0].text(taxi.feature_values(second)[0])
    assert steps['feature:taxi_row'][1] == row
    assert list(steps['option'][:4]) == ['', 'module 1', 'module 0', 'module 1']
    assert list(steps['source'][:2]) == ['', 'machine']


def test_the_bag_of_a_robot_is_exported_by_its_description(tmp_path: Path) -> None:
    """Continuous features are numbers, and it need not be installed."""
    far = Feature.continuous('far', 'how far it is', 0.0, 9.0, 'm')
    lamp = Feature.nominal('lamp', 'whether it is on', ('off', 'on'))
    rover = DescribedDomain('rover', {}, [far, lamp], [Action('go', 'g', 'go')], 0.9, 100)
    with BagWriter(tmp_path / 'bag') as bag:
        states = [
            Transition(1, step, f'state {step}', (1.5 * step, 1.0), 'go' if step else '')
            for step in range(3)
        ]
        messages: list[tuple[str, Any]] = [('/domain_info', domain_to_info(rover))]
        messages += [('/game_state', transition_to_message(each)) for each in states]
        for time, (topic, message) in enumerate(messages):
            bag.add_topic(topic, f'humanopts_interfaces/msg/{type(message).__name__}')
            message.publisher_id, message.sequence = '/rover#1', max(time, 1)
            bag.write(topic, serialize_message(message), time + 1)
    steps = frames(open_bag(tmp_path / 'bag'))['steps']
    assert list(steps['feature:far']) == [0.0, 1.5, 3.0]
    assert list(steps['feature:lamp']) == ['on'] * 3
    with pytest.raises(BagError, match="no domain 'rover'"):
        read_domain(open_bag(tmp_path / 'bag'))


@pytest.mark.parametrize('features', [[999.0], [-1.0], [0.5], []])
def test_features_that_the_domain_does_not_have_here_are_left_empty_and_said(
    tmp_path: Path, taxi: Domain[Any], features: list[float]
) -> None:
    with BagWriter(tmp_path / 'bag') as writer:
        for time, (topic, kind, message) in enumerate(entries(taxi, 1, [])):
            if topic == '/game_state' and message.step == 3:
                message.features = [*features, *message.features[1:]]
            writer.add_topic(topic, kind)
            writer.write(topic, serialize_message(message), time)
    bag = open_bag(tmp_path / 'bag')
    steps = frames(bag)['steps']
    empty = list(steps.index[steps.filter(like='feature:').isna().any(axis=1)])
    assert (len(steps['state']), empty) == (STEPS + 1, [3])
    assert 'values that features do not have' in bag.damage


def test_tables_of_demonstrations_options_and_plans_say_what_was_recorded(
    bag: Bag, taxi_lesson: list[Demonstration]
) -> None:
    tables = frames(bag)
    demos, options = tables['demonstrations'], tables['options']
    assert list(demos['uuid']) == [demo.uuid for demo in taxi_lesson[:2]]
    assert [tuple(json.loads(text)) for text in demos['states']] == [
        demo.states for demo in taxi_lesson[:2]
    ]
    assert json.loads(demos['features'][0]) == [list(row) for row in taxi_lesson[0].features]
    assert list(options['option']) == [taxi_lesson[0].option_name]
    plans = tables['plans']
    assert list(plans['status']) == ['converged']
    assert list(plans['option_names']) == ['["eat", "flee"]']
    assert list(plans['mean_return'].isna()) == [True]  # NaN: not evaluated


@pytest.mark.parametrize('kind', ['csv', 'parquet'])
def test_files_hold_the_tables(tmp_path: Path, bag: Bag, kind: str) -> None:
    if kind == 'parquet':
        pytest.importorskip('pyarrow.parquet', exc_type=ImportError)
    paths = write_tables(bag_tables(bag), tmp_path, kind)
    for path, (name, table) in zip(paths, frames(bag).items()):
        read = pd.read_parquet(path) if kind == 'parquet' else pd.read_csv(path)
        assert (path.name, list(read.columns)) == (f'{name}.{kind}', list(table.columns))
        as_read = [[*map(str, row)] for row in read.astype(object).fillna('').values.tolist()]
        assert as_read == [
            [*map(str, row)] for row in table.astype(object).fillna('').values.tolist()
        ]


@pytest.mark.parametrize('write', ['parquet', 'minari'])
def test_export_says_which_package_is_missing(
    tmp_path: Path, bag: Bag, monkeypatch: pytest.MonkeyPatch, write: str
) -> None:
    monkeypatch.setitem(__import__('sys').modules, 'pyarrow', None)  # import fails
    out = tmp_path / 'out'
    with pytest.raises(ExportError, match='not installed: pip install'):
        write_tables({}, out, write) if write == 'parquet' else write_dataset(bag, out)
    assert not out.exists()


@pytest.mark.parametrize(
    ('name', 'parameters'), [('taxi', {}), ('rooms', {}), ('pacman', {'maze': 'yard'})]
)
def test_episodes_of_a_minari_dataset_step_through_our_environments(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, parameters: dict[str, Any]
) -> None:
    minari = pytest.importorskip('minari')
    pytest.importorskip('pyarrow', exc_type=ImportError)
    recorded = record(tmp_path / 'b', make_domain(name, parameters), 4)
    dataset_id, count = write_dataset(recorded, tmp_path)
    assert (dataset_id, count) == (f'humanopts/{name}/b-v0', 4)
    monkeypatch.setenv(FOLDER, str(tmp_path))
    dataset = minari.load_dataset(dataset_id)
    env = dataset.recover_environment()
    assert dataset.total_episodes == 4
    for episode in dataset.iterate_episodes():
        (kept,) = dataset.storage.get_episode_metadata([episode.id])
        seen = [(env.reset(options=kept['options'])[0], 0.0, False, False)]
        seen += [env.step(int(action))[:4] for action in episode.actions]
        observations, *others = zip(*seen)
        assert np.array_equal(np.array(observations), episode.observations)
        kept_ends = episode.rewards, episode.terminations, episode.truncations
        *same, (_, *truncated) = others
        for here, there in zip(same, kept_ends, strict=False):
            assert list(here[1:]) == there.tolist()
        truncated[-1] |= not episode.terminations[-1]  # it was broken off
        assert truncated == kept_ends[-1].tolist()


def test_episodes_with_gaps_are_left_out_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, taxi: Domain[Any]
) -> None:
    monkeypatch.chdir(tmp_path)
    pytest.importorskip('minari')
    pytest.importorskip('pyarrow', exc_type=ImportError)
    with BagWriter(tmp_path / 'gap') as bag:
        for time, (topic, kind, message) in enumerate(entries(taxi, 2, []), start=1):
            lost = topic == '/game_state' and (message.episode, message.step) == (1, 5)
            if not lost and kind != EVENT:
                bag.add_topic(topic, kind)
                bag.write(topic, serialize_message(message), time)
    recorded = open_bag(tmp_path / 'gap')
    _, count = write_dataset(recorded, Path('out'))
    assert count == 1
    assert '1 episodes are left out' in recorded.damage
    (kept,) = (tmp_path / 'out').rglob('data/0/metadata.json')
    assert list(json.loads(kept.read_text())['options']) == ['state']  # no request was recorded
    with pytest.raises(ExportError, match='already exists'):
        write_dataset(open_bag(tmp_path / 'gap'), tmp_path / 'out')


NAMES = (
    'up-2026_11',
    '2026.01.02',
    '2026.01.03',
    '2026-01-02',
    '!!!',
    '???',
    'a b',
    'a-b',
    'ü',
    '-',
    'x' * 200,
)


def test_bags_of_different_names_have_different_datasets_that_minari_finds(
    taxi: Domain[Any],
) -> None:
    names = [dataset_name(taxi, Path('runs') / name) for name in NAMES]
    assert (names[0], len(set(names))) == ('humanopts/taxi/up-2026_11-v0', len(names))
    minari_data = pytest.importorskip('minari.dataset.minari_dataset')
    for name in names:
        namespace, rest, version = minari_data.parse_dataset_id(name)
        assert (namespace, f'{namespace}/{rest}-v{version}') == ('humanopts/taxi', name)


def test_a_dataset_of_any_name_can_be_loaded_and_every_episode_has_an_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, taxi: Domain[Any]
) -> None:
    minari = pytest.importorskip('minari')
    pytest.importorskip('pyarrow', exc_type=ImportError)
    with BagWriter(tmp_path / '!!!') as bag:
        for time, (topic, kind, message) in enumerate(entries(taxi, 2, []), start=1):
            cut = topic == '/game_state' and (message.episode, message.step) > (1, 5)
            if kind != EVENT and not cut:  # the second episode is broken off, and not over
                bag.add_topic(topic, kind)
                bag.write(topic, serialize_message(message), time)
    name, count = write_dataset(open_bag(tmp_path / '!!!'), tmp_path / 'out')
    monkeypatch.setenv(FOLDER, str(tmp_path / 'out'))
    episodes = list(minari.load_dataset(name).iterate_episodes())
    assert count == len(episodes) > 0
    ends = [(e.terminations | e.truncations).tolist() for e in episodes]
    assert all(each[-1] and not any(each[:-1]) for each in ends)
    assert ends[-1] == [False] * 4 + [True]
    assert [path.name for path in (tmp_path / 'out').iterdir()] == ['humanopts']


def test_a_dataset_that_cannot_be_written_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, taxi: Domain[Any]
) -> None:
    minari = pytest.importorskip('minari')
    pytest.importorskip('pyarrow', exc_type=ImportError)
    recorded = record(tmp_path / 'b', taxi, 2)

    def full(*args: Any, **options: Any) -> None:
        create(*args, **options)
        raise OSError(28, 'No space left on device')

    create = minari.create_dataset_from_buffers
    monkeypatch.setattr(minari, 'create_dataset_from_buffers', full)
    with pytest.raises(OSError, match='No space left'):
        write_dataset(recorded, tmp_path / 'out')
    assert not (tmp_path / 'out' / 'humanopts' / 'taxi' / 'b-v0').exists()


@pytest.mark.parametrize(
    ('names', 'refusal'),
    [
        (['options/p1/fetch.json', 'notes.txt'], ''),
        ([], 'has no attached files'),
        (['../outside.json'], 'of the name'),
        (['/etc/outside.json'], 'of the name'),
    ],
)
def test_attached_files_come_out_below_the_folder_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], names: list[str], refusal: str
) -> None:
    with BagWriter(tmp_path / 'bag') as writer:
        writer.add_topic('/action', f'{MESSAGES}ActionCommand')
        writer.write('/action', serialize_message(ActionCommand()), 1)
        for name in names:
            writer.attach(name, name.encode())
    out = tmp_path / 'out'
    command = ['bag', 'export', str(tmp_path / 'bag'), '--to', 'files', '--out', str(out)]
    assert main(command) == (2 if refusal else 0)
    assert refusal in capsys.readouterr().err
    found = {p.relative_to(out).as_posix(): p.read_text() for p in out.rglob('*') if p.is_file()}
    assert found == ({} if refusal else {name: name for name in names})
    assert not (tmp_path / 'outside.json').exists()
    if not refusal:
        assert main(command) == 2  # nothing is overwritten


def test_text_that_a_spreadsheet_would_run_is_text_in_csv_alone(tmp_path: Path) -> None:
    parquet = pytest.importorskip('pyarrow.parquet', exc_type=ImportError)

    def tables() -> dict[str, Table]:
        rows = iter([('=1+1', -5.0), ('größer', None)])
        return {'steps': Table({'option': str, 'reward': float}, rows)}

    (path,) = write_tables(tables(), tmp_path, 'csv')
    assert path.read_text('utf-8').splitlines() == ['option,reward', "'=1+1,-5.0", 'größer,']
    (path,) = write_tables(tables(), tmp_path, 'csv', excel=True)
    assert path.read_bytes().startswith(b'\xef\xbb\xbfoption')
    (path,) = write_tables(tables(), tmp_path, 'parquet')
    assert parquet.read_table(path).to_pydict()['option'] == ['=1+1', 'größer']
