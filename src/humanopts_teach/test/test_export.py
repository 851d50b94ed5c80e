"""Bags for other tools: tables and datasets hold the recording, and can be stepped again."""

from collections.abc import Callable, Iterator
from dataclasses import replace
import json
from pathlib import Path
from typing import Any

from humanopts_env.domains.base import Action, Domain, Feature
from humanopts_env.domains.described import DescribedDomain
from humanopts_env.domains.registry import make_domain
from humanopts_env.game import Command, Game, Source, Transition
from humanopts_env.ros.convert import domain_to_info, transition_to_message
from humanopts_env.seeding import generator
from humanopts_interfaces.msg import ActionCommand, GameState, PlanResult
from humanopts_interfaces.srv import ResetGame
from humanopts_learner.demonstrations import Demonstration, version_of
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_teach.bags import BagError
from humanopts_teach.bags.contents import read_domain
from humanopts_teach.bags.reader import Bag
from humanopts_teach.cli import main
from humanopts_teach.export.minari_dataset import dataset_name, FOLDER, write_dataset
from humanopts_teach.export.tables import bag_tables, ExportError, Table, write_tables
from humanopts_teach.plays import plays_in_bag
import numpy as np
import pandas as pd
import pytest
from service_msgs.msg import ServiceEventInfo
from teach_support.bags import judged_run, numbered, write_messages
from teach_support.robot_desk import DOMAIN as CORRIDOR

STEPS = 30


def entries(
    domain: Domain, episodes: int, demos: list[Demonstration]
) -> Iterator[tuple[str, Any]]:
    """Yield (topic, message) of some episodes with random actions by two modules."""
    yield '/domain_info', domain_to_info(domain)
    for demo in demos:
        yield '/demonstrations', demonstration_to_message(demo)
    game, rng = Game(domain), generator(1, 'actions of a test')
    sent = 0
    for number in range(1, episodes + 1):
        start = domain.encode(domain.reset(rng)) if number % 2 else ''
        transition = game.reset(start, number + 40, Source.MACHINE).transition
        assert transition is not None
        request = ResetGame.Request(source=2, start_state=start, seed=number + 40)
        response = ResetGame.Response(status=1, episode=number, state=transition.state)
        for kind, parts in ((1, {'request': [request]}), (2, {'response': [response]})):
            info = ServiceEventInfo(event_type=kind, sequence_number=number)
            yield '/reset_game/_service_event', ResetGame.Event(info=info, **parts)
        yield '/game_state', transition_to_message(transition)
        while game.transition.open and game.transition.step < STEPS:
            sent += 1
            sender, at = ('/option_server#1', sent), game.transition.step
            action = domain.actions[rng.integers(len(domain.actions))].name
            game.command(Command(*sender, Source.MACHINE, number, at, action))
            command = ActionCommand(action=action, option_name=f'module {sent % 2}')
            command.publisher_id, command.sequence = sender
            yield '/action', command
            yield '/game_state', transition_to_message(game.transition)
    plan = PlanResult(plan_id='p', status=1, option_names=['eat', 'flee'], sweeps=3)
    plan.mean_return = float('nan')
    yield '/plan_results', plan


def record(
    path: Path,
    domain: Domain,
    episodes: int,
    demos: list[Demonstration] | None = None,
    keep: Callable[[Any], bool] = lambda message: True,
) -> Bag:
    """Write a bag of the messages to keep."""
    sent = entries(domain, episodes, demos or [])
    return write_messages(path, (entry for entry in sent if keep(entry[1])))


def frames(bag: Bag) -> dict[str, pd.DataFrame]:
    """Return the tables of a bag as data frames."""
    return {
        name: pd.DataFrame(table.rows, columns=[*table.columns])
        for name, table in bag_tables(bag).items()
    }


@pytest.fixture(scope='module')
def bag(
    tmp_path_factory: pytest.TempPathFactory,
    taxi: Domain,
    taxi_lesson: list[Demonstration],
) -> Bag:
    """Two demonstrations, two judged runs, three episodes and a plan."""
    shown = taxi_lesson[:2]
    wrong = judged_run(shown[0], shown, 1, exam=True, stopped=True)
    answer = replace(judged_run(shown[0], shown, 2, right=True), **still(shown[0]))
    folder = tmp_path_factory.mktemp('exported')
    return record(folder / 'bag', taxi, 3, [*shown, wrong, answer])


def still(demo: Demonstration) -> dict[str, Any]:
    """Return the fields of a demonstration of no step in the same start."""
    return {
        'states': demo.states[:1],
        'features': demo.features[:1],
        'actions': (),
        'rewards': (),
    }


def test_tables_hold_what_was_recorded(
    bag: Bag, taxi: Domain, taxi_lesson: list[Demonstration]
) -> None:
    tables = frames(bag)
    steps, demos, plans = (tables[name] for name in ('steps', 'demonstrations', 'plans'))
    assert list(steps['episode']) == [1] * 31 + [2] * 31 + [3] * 31
    assert list(steps['step'][:32]) == [*range(31), 0]
    first, second = (taxi.decode(text) for text in steps['state'][:2])
    action = [a.name for a in taxi.actions].index(steps['action'][1])
    outcome = taxi.step(first, action, generator(0, 'not used'))
    assert (outcome.state, outcome.reward) == (second, steps['reward'][1])
    assert steps['feature:taxi_row'][1] == taxi.features[0].text(taxi.feature_values(second)[0])
    assert list(steps['option'][:4]) == ['', 'module 1', 'module 0', 'module 1']
    assert list(steps['source'][:2]) == ['', 'machine']
    shown = taxi_lesson[:2]
    assert list(demos['uuid']) == [demo.uuid for demo in shown]
    assert [tuple(json.loads(text)) for text in demos['states']] == [d.states for d in shown]
    assert json.loads(demos['features'][0]) == [list(row) for row in shown[0].features]
    assert list(tables['options']['option']) == [shown[0].option_name]
    assert list(plans['status']) == ['converged']
    assert list(plans['option_names']) == ['["eat", "flee"]']
    assert list(plans['mean_return'].isna()) == [True]  # NaN: not evaluated


def test_judged_runs_have_a_table_of_their_own(bag: Bag, taxi_lesson: list[Demonstration]) -> None:
    tables, (shown, _, *_) = frames(bag), taxi_lesson
    assert not {'right', 'exam', 'stopped', 'option_version'} & {*tables['demonstrations']}
    runs = tables['judged_runs']
    assert list(runs['judged_in']) == ['exam', 'question']
    assert list(runs['verdict']) == ['wrong', 'right']
    assert list(runs['stopped']) == [True, False]
    assert list(runs['steps']) == [len(shown.actions), 0]
    assert list(runs['start']) == [shown.states[0]] * 2
    assert list(runs['end']) == [shown.states[-1], shown.states[0]]
    assert set(runs['option_version']) == {version_of(taxi_lesson[:2])}
    assert list(tables['options']['judged']) == [2]
    assert list(tables['options']['demonstrations']) == [2]


def test_the_bag_of_a_robot_is_exported_by_its_description(tmp_path: Path) -> None:
    """Continuous features are numbers, and its domain need not be installed."""
    far = Feature.continuous('far', 'how far it is', 0.0, 9.0, 'm')
    lamp = Feature.nominal('lamp', 'whether it is on', ('off', 'on'))
    rover = DescribedDomain('rover', {}, [far, lamp], [Action('go', 'g', 'go')], 0.9, 100)
    states = [
        Transition(1, at, f'state {at}', (1.5 * at, 1.0), 'go' * (at > 0)) for at in range(3)
    ]
    sent: list[tuple[str, Any]] = [('/domain_info', domain_to_info(rover))]
    sent += [('/game_state', transition_to_message(each)) for each in states]
    bag = write_messages(tmp_path / 'bag', sent)
    steps = frames(bag)['steps']
    assert list(steps['feature:far']) == [0.0, 1.5, 3.0]
    assert list(steps['feature:lamp']) == ['on'] * 3
    with pytest.raises(BagError, match="unknown domain 'rover'"):
        read_domain(bag)


@pytest.mark.parametrize('features', [[999.0], [0.5], []])
def test_values_that_features_do_not_have_are_left_empty_and_noted(
    tmp_path: Path, taxi: Domain, features: list[float]
) -> None:
    def spoil(message: Any) -> bool:
        if isinstance(message, GameState) and message.step == 3:
            message.features = [*features, *message.features[1:]]
        return True

    bag = record(tmp_path / 'bag', taxi, 1, keep=spoil)
    steps = frames(bag)['steps']
    empty = list(steps.index[steps.filter(like='feature:').isna().any(axis=1)])
    assert (len(steps), empty) == (STEPS + 1, [3])
    assert 'values that features do not have' in bag.damage


@pytest.mark.parametrize('kind', ['csv', 'parquet'])
def test_files_hold_the_tables(tmp_path: Path, bag: Bag, kind: str) -> None:
    pytest.importorskip('pyarrow.parquet', exc_type=ImportError)
    paths = write_tables(bag_tables(bag), tmp_path, kind)
    for path, (name, table) in zip(paths, frames(bag).items(), strict=True):
        read = pd.read_parquet(path) if kind == 'parquet' else pd.read_csv(path)
        assert path.name == f'{name}.{kind}'
        plain = [each.astype(object).fillna('').astype(str) for each in (read, table)]
        assert plain[0].equals(plain[1])


@pytest.mark.parametrize('kind', ['parquet', 'minari'])
def test_export_names_the_missing_package(
    tmp_path: Path, bag: Bag, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setitem(__import__('sys').modules, 'pyarrow', None)  # import fails
    out = tmp_path / 'out'
    with pytest.raises(ExportError, match='not installed: pip install'):
        write_tables({}, out, kind) if kind == 'parquet' else write_dataset(bag, out)
    assert not out.exists()


@pytest.fixture
def minari(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return Minari, which looks for its datasets in ``tmp_path/out``."""
    pytest.importorskip('pyarrow', exc_type=ImportError)
    monkeypatch.setenv(FOLDER, str(tmp_path / 'out'))
    return pytest.importorskip('minari')


@pytest.mark.parametrize(
    ('name', 'parameters'), [('taxi', {}), ('rooms', {}), ('pacman', {'maze': 'yard'})]
)
def test_episodes_of_a_minari_dataset_step_through_our_environments(
    tmp_path: Path, minari: Any, name: str, parameters: dict[str, Any]
) -> None:
    recorded = record(tmp_path / 'b', make_domain(name, parameters), 4)
    dataset_id, count = write_dataset(recorded, tmp_path / 'out')
    assert (dataset_id, count) == (f'humanopts/{name}/b-v0', 4)
    dataset = minari.load_dataset(dataset_id)
    env = dataset.recover_environment()
    assert dataset.total_episodes == 4
    for episode in dataset.iterate_episodes():
        (kept,) = dataset.storage.get_episode_metadata([episode.id])
        seen = [(env.reset(options=kept['options'])[0], 0.0, False, False)]
        seen += [env.step(int(action))[:4] for action in episode.actions]
        observations, rewards, terminations, truncations = map(np.array, zip(*seen))
        assert np.array_equal(observations, episode.observations)
        assert np.array_equal(rewards[1:], episode.rewards)
        assert np.array_equal(terminations[1:], episode.terminations)
        truncations[-1] |= not episode.terminations[-1]  # it was broken off
        assert np.array_equal(truncations[1:], episode.truncations)


def test_episodes_with_gaps_are_left_out_and_counted_and_others_have_an_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, minari: Any, taxi: Domain
) -> None:
    """No request is recorded, a step of the first episode is lost, and the third is broken off."""

    def keep(message: Any) -> bool:
        place = (message.episode, message.step) if isinstance(message, GameState) else (0, 0)
        return not (isinstance(message, ResetGame.Event) or place == (1, 5) or place > (3, 5))

    bag = record(tmp_path / '!!!', taxi, 3, keep=keep)
    monkeypatch.chdir(tmp_path)
    name, count = write_dataset(bag, Path('out'))
    assert '1 episodes are left out' in bag.damage
    episodes = list(minari.load_dataset(name).iterate_episodes())
    assert count == len(episodes) == 2
    ends = [(e.terminations | e.truncations).tolist() for e in episodes]
    assert all(each[-1] and not any(each[:-1]) for each in ends)
    assert len(ends[1]) == 5
    kept = json.loads(next(Path('out').rglob('data/0/metadata.json')).read_text())
    assert list(kept['options']) == ['state']
    with pytest.raises(ExportError, match='already exists'):
        write_dataset(bag, tmp_path / 'out')


def test_bags_of_different_names_have_different_datasets_that_minari_finds(
    taxi: Domain,
) -> None:
    bags = ('up-2026_11', '2026.01.02', '2026-01-02', '!!!', '???', 'a b', 'a-b', 'ü', 'x' * 200)
    names = [dataset_name(taxi, Path('runs') / name) for name in bags]
    assert (names[0], len(set(names))) == ('humanopts/taxi/up-2026_11-v0', len(names))
    minari_data = pytest.importorskip('minari.dataset.minari_dataset')
    for name in names:
        namespace, rest, version = minari_data.parse_dataset_id(name)
        assert (namespace, f'{namespace}/{rest}-v{version}') == ('humanopts/taxi', name)


def test_a_dataset_that_cannot_be_written_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, minari: Any, taxi: Domain
) -> None:
    recorded = record(tmp_path / 'b', taxi, 2)

    def full(*args: Any, **options: Any) -> None:
        create(*args, **options)
        raise OSError(28, 'No space left on device')

    create = minari.create_dataset_from_buffers
    monkeypatch.setattr(minari, 'create_dataset_from_buffers', full)
    with pytest.raises(OSError, match='No space left'):
        write_dataset(recorded, tmp_path / 'out')
    assert not list((tmp_path / 'out').rglob('*-v0'))


@pytest.mark.parametrize(
    ('names', 'refusal'),
    [
        (['options/p1/fetch.json', 'notes.txt'], ''),
        ([], 'has no attached files'),
        (['../outside.json'], 'with unsafe name'),
        (['/etc/outside.json'], 'with unsafe name'),
    ],
)
def test_attached_files_come_out_below_the_folder_only(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], names: list[str], refusal: str
) -> None:
    contents = {name: name.encode() for name in names}
    write_messages(tmp_path / 'bag', [('/game_state', numbered(1))], attached=contents)
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

    def write(kind: str, **how: bool) -> Path:
        rows = iter([('=1+1', -5.0), ('größer', None)])
        steps = Table({'option': str, 'reward': float}, rows)
        return write_tables({'steps': steps}, tmp_path, kind, **how)[0]

    assert write('csv').read_text('utf-8').splitlines() == [
        'option,reward',
        "'=1+1,-5.0",
        'größer,',
    ]
    assert write('csv', excel=True).read_bytes().startswith(b'\xef\xbb\xbfoption')
    assert parquet.read_table(write('parquet')).to_pydict()['option'] == ['=1+1', 'größer']


def test_a_refreshed_state_replaces_that_of_its_step_and_short_actions_are_marked(
    tmp_path: Path,
) -> None:
    first = Transition(1, 0, 'x 5', (5.0, 0.0))
    moved = replace(first, step=1, state='x 4', features=(4.0, 0.0), previous_action='back')
    stopped = replace(moved, action_source=Source.PERSON, cut_short=True)
    sensed = [first, replace(first, state='x 6', features=(6.0, 1.0), refreshed=True), stopped]
    bag = write_messages(
        tmp_path / 'bag',
        [
            ('/domain_info', domain_to_info(CORRIDOR)),
            *(('/game_state', transition_to_message(each)) for each in sensed),
        ],
    )
    table = bag_tables(bag)['steps']
    rows = [dict(zip(table.columns, row)) for row in table.rows]
    assert [(row['step'], row['feature:x'], row['feature:door']) for row in rows] == [
        (0, 6.0, 'closed'),
        (1, 4.0, 'open'),
    ]
    assert [row['cut_short'] for row in rows] == [False, True]
    _, plays = plays_in_bag(bag)
    assert plays[1].states == ('x 6', 'x 4')
