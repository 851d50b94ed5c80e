"""The data set of a lesson, in a file that a crash cannot spoil, and what is learned from it."""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace
import errno
import gc
import os
from pathlib import Path
from typing import Any
from uuid import NAMESPACE_OID, uuid5

from humanopts_env.domains.taxi import Taxi
from humanopts_learner.append_only_log import append_bytes, AppendOnlyLog
from humanopts_learner.demonstrations import Demonstration, DemonstrationError, Kind
from humanopts_learner.option_trainer import DATA_SET, DataSetError, OptionTrainer
from humanopts_learner.options.files import load_options, option_from_json
from humanopts_learner.options.judge import judge, Thresholds
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption
import pytest

TAXI = Taxi()
SEED = 2
DELIVER = 'go to destination and dropoff'
Open = Callable[[], OptionTrainer]


@pytest.fixture
def reopen(tmp_path: Path) -> Open:
    """Open the trainer in the test's folder; every call is a new process's view of it."""
    return lambda: OptionTrainer(tmp_path / 'options', TAXI, Thresholds(), SEED)


@pytest.fixture(scope='module')
def few(fetching: list[Demonstration]) -> list[Demonstration]:
    return fetching[:6]


@pytest.fixture
def trainer(reopen: Open) -> OptionTrainer:
    """Return a trainer without demonstrations."""
    return reopen()


@pytest.fixture
def trained(trainer: OptionTrainer, few: list[Demonstration]) -> OptionTrainer:
    """Return a trainer that has taken the few demonstrations."""
    for demo in few:
        trainer.take(demo)
    return trainer


def not_here(shown: Demonstration) -> Demonstration:
    """Return a "not here" answer in the first state of a demonstration."""
    return replace(
        shown,
        kind=Kind.NOT_HERE,
        states=shown.states[:1],
        features=shown.features[:1],
        actions=(),
        rewards=(),
        terminated=False,
    )


def withdrawn(demo: Demonstration) -> Demonstration:
    return replace(demo, withdrawn=True)


def test_a_demonstration_is_learned_from_once(
    few: list[Demonstration], trainer: OptionTrainer
) -> None:
    assert [trainer.take(demo) for demo in few] == [True] * 6
    assert trainer.take(few[3]) is False
    (taught,) = trainer.options()
    assert taught.option == learn_option(few, TAXI, SEED)
    assert taught.summary == judge(few, TAXI, Thresholds(), SEED)
    assert option_from_json(taught.file) == (taught.option, [])


def test_everything_is_known_again_when_it_is_opened_again(
    reopen: Open, few: list[Demonstration], trained: OptionTrainer
) -> None:
    again = reopen()
    assert again.options() == trained.options()
    assert again.problems == []
    assert again.take(few[0]) is False


def test_the_option_file_holds_the_demonstrations(tmp_path: Path, trained: OptionTrainer) -> None:
    options, problems = load_options(tmp_path / 'options')
    assert options == [trained.options()[0].option]
    assert problems == []


def test_options_and_people_are_kept_apart(person: Any, trainer: OptionTrainer) -> None:
    one, two = person(seed=1).show_random(3), person(seed=2).show_random(3)
    other = person(DELIVER, seed=1).show_random(3)
    for demos in zip(one, two, other):
        for demo in demos:
            trainer.take(demo)
    found = [(p.summary.participant, p.summary.last_uuid) for p in trainer.options()[:2]]
    assert found == [('person 1', one[-1].uuid), ('person 2', two[-1].uuid)]
    assert [p.option for p in trainer.options()] == [
        learn_option(demos, TAXI, SEED) for demos in (one, two, other)
    ]


def test_what_somebody_taught_is_read_again_when_they_go_on(
    person: Any, tmp_path: Path, reopen: Open, trainer: OptionTrainer
) -> None:
    one, two = person(seed=1).show_random(4), person(seed=2).show_random(1)
    for demo in (*one[:3], *two, withdrawn(one[0]), *two, one[3]):
        trainer.take(demo)
    mine = trainer.options()[0]
    assert mine.option == learn_option(one[1:], TAXI, SEED)
    assert mine.summary == judge(one[1:], TAXI, Thresholds(), SEED)
    assert reopen().options() == trainer.options()
    file = tmp_path / 'options' / DATA_SET
    kept = file.read_bytes()
    file.unlink()
    file.mkdir()
    with pytest.raises(DataSetError, match=r'cannot read .*jsonl: it is not a regular file'):
        trainer.take(withdrawn(two[0]))
    file.rmdir()
    file.write_bytes(kept)
    assert trainer.take(withdrawn(two[0]))
    assert [p.summary.participant for p in trainer.options()] == ['person 1']


def test_of_people_who_are_gone_no_demonstrations_and_trees_stay_in_memory(
    few: list[Demonstration], trainer: OptionTrainer
) -> None:
    def of(kind: type) -> list[str]:
        return [each.participant for each in gc.get_objects() if isinstance(each, kind)]

    gc.collect()
    options = len(of(LearnedOption))
    for who in ('gone', 'gone too', 'here'):
        for demo in few:
            trainer.take(
                replace(demo, participant=who, uuid=str(uuid5(NAMESPACE_OID, who + demo.uuid)))
            )
    gc.collect()
    shown = Counter(of(Demonstration))
    assert (shown['gone'], shown['gone too'], shown['here']) == (0, 0, len(few))
    assert len(of(LearnedOption)) == options


def test_not_here_alone_is_counted_but_is_no_option(
    few: list[Demonstration], trainer: OptionTrainer
) -> None:
    nothing = not_here(few[0])
    assert trainer.take(nothing)
    (taught,) = trainer.options()
    assert (taught.summary.last_uuid, taught.summary.n_not_here) == (nothing.uuid, 1)
    assert (taught.option, taught.file) == (None, '')


def test_what_cannot_be_used_is_not_kept(
    few: list[Demonstration], tmp_path: Path, trainer: OptionTrainer
) -> None:
    trainer.take(few[0])
    before = (tmp_path / 'options' / DATA_SET).read_bytes()
    with pytest.raises(DemonstrationError, match='names no option'):
        trainer.take(replace(few[1], option_name=''))
    assert (tmp_path / 'options' / DATA_SET).read_bytes() == before
    assert trainer.take(few[1])


def test_a_line_that_cannot_be_used_is_named_and_the_others_are_kept(
    reopen: Open, tmp_path: Path, trained: OptionTrainer
) -> None:
    file = tmp_path / 'options' / DATA_SET
    file.write_text('not JSON\n' + file.read_text() + '{"kind": "traj')
    again = reopen()
    assert again.options() == trained.options()
    torn, unusable = again.problems
    assert 'was cut off' in torn
    assert unusable.startswith(f'line 1 of {file} is left out: not a demonstration')
    assert file.read_text().startswith('not JSON\n')


def test_a_folder_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    (tmp_path / 'file').touch()
    with pytest.raises(DataSetError, match=r'cannot use the folder .*file: '):
        OptionTrainer(tmp_path / 'file', TAXI, Thresholds(), SEED)


def test_a_data_set_that_cannot_be_written_keeps_the_demonstration_out(
    few: list[Demonstration], tmp_path: Path, trainer: OptionTrainer
) -> None:
    (tmp_path / 'options' / DATA_SET).mkdir()
    with pytest.raises(DataSetError, match=r'cannot write .*jsonl: Is a directory'):
        trainer.take(few[0])
    assert trainer.options() == []
    (tmp_path / 'options' / DATA_SET).rmdir()
    assert trainer.take(few[0])


def test_an_option_file_that_cannot_be_written_is_a_problem_but_no_loss(
    reopen: Open, few: list[Demonstration], tmp_path: Path, trainer: OptionTrainer
) -> None:
    trainer.take(few[0])
    (file,) = (tmp_path / 'options').glob('*/*.json')
    folder = file.parent
    file.unlink()
    folder.rmdir()
    folder.touch()
    assert trainer.take(few[1])
    (problem,) = trainer.problems
    assert 'cannot write the file of' in problem
    assert reopen().options()[0].option == learn_option(few[:2], TAXI, SEED)


def test_what_is_withdrawn_is_unlearned_and_stays_so(
    reopen: Open, few: list[Demonstration], trained: OptionTrainer
) -> None:
    assert trained.take(withdrawn(few[-1])) is True
    for again in (few[-1], withdrawn(few[-1])):
        assert trained.take(again) is False
    (taught,) = trained.options()
    assert taught.option == learn_option(few[:-1], TAXI, SEED)
    assert reopen().options() == trained.options()


def test_an_option_of_which_nothing_is_left_is_gone_with_its_file(
    reopen: Open, few: list[Demonstration], tmp_path: Path, trainer: OptionTrainer
) -> None:
    trainer.take(few[0])
    trainer.take(withdrawn(few[0]))
    assert trainer.options() == reopen().options() == []
    assert load_options(tmp_path / 'options') == ([], [])
    trainer.take(few[1])
    assert load_options(tmp_path / 'options')[0] == [learn_option([few[1]], TAXI, SEED)]


def test_an_option_with_not_here_alone_left_is_known_and_has_no_file(
    few: list[Demonstration], person: Any, tmp_path: Path, trainer: OptionTrainer
) -> None:
    refusal = not_here(few[1])
    for demo in (refusal, few[0], withdrawn(few[0])):
        trainer.take(demo)
    (taught,) = trainer.options()
    assert (taught.summary.last_uuid, taught.option) == (refusal.uuid, None)
    assert load_options(tmp_path / 'options') == ([], [])


def test_a_withdrawal_that_comes_first_holds(
    few: list[Demonstration], trainer: OptionTrainer
) -> None:
    assert trainer.take(withdrawn(few[0])) is True
    assert trainer.take(few[0]) is False
    assert trainer.options() == []


@pytest.mark.parametrize(
    ('fields', 'says'),
    [
        ({'option_name': 'x' * 61}, 'has 61 characters'),
        ({'option_name': 'go\x1b[2J'}, 'cannot be printed'),
        ({'option_name': 'action:north'}, 'primitive actions'),
        ({'participant': 'p\n1'}, 'its participant has characters'),
        ({'session': 's' * 1000}, 'its session has 1000 characters'),
    ],
)
def test_names_that_no_lesson_gives_are_refused(
    trainer: OptionTrainer, few: list[Demonstration], fields: dict[str, str], says: str
) -> None:
    with pytest.raises(DemonstrationError, match=says):
        trainer.take(replace(few[0], **fields))
    assert trainer.options() == []


def test_a_deep_line_is_left_out_by_its_number(
    trained: OptionTrainer, reopen: Open, tmp_path: Path
) -> None:
    path = tmp_path / 'options' / DATA_SET
    lines = path.read_text().splitlines()
    path.write_text('\n'.join([lines[0], '[' * 100_000, *lines[1:], '']))
    again = reopen()
    (problem,) = again.problems
    assert problem.startswith('line 2 of ')
    assert 'nested more than' in problem
    assert again.options() == trained.options()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / 'lines.jsonl'


def test_what_was_appended_is_there_when_it_is_opened_again(path: Path) -> None:
    log = AppendOnlyLog(path)
    assert (log.read(str), log.problems) == ([], [])
    for line in ('{"a": 1}', '{"name": "Zoë"}'):
        log.append(line)
    again = AppendOnlyLog(path)
    assert again.read(str) == log.read(str) == ['{"a": 1}', '{"name": "Zoë"}']
    assert again.problems == []


def test_a_link_is_refused_when_it_is_opened_and_when_it_comes_later(path: Path) -> None:
    other = path.with_name('other')
    other.write_bytes(b'{}\n')
    log = AppendOnlyLog(path)
    path.symlink_to(other)
    with pytest.raises(OSError, match='symbolic link to'):
        log.append('{"a": 1}')
    with pytest.raises(OSError, match='symbolic link to'):
        AppendOnlyLog(path)
    assert other.read_bytes() == b'{}\n'


def test_a_file_is_not_made_before_there_is_a_line(path: Path) -> None:
    AppendOnlyLog(path)
    assert not path.exists()


@pytest.mark.parametrize('torn', [b'{"a": ', b'{', 'é'.encode()[:1]])
def test_a_last_line_that_was_cut_off_is_moved_aside(path: Path, torn: bytes) -> None:
    path.write_bytes(b'{"a": 1}\n' + torn)
    log = AppendOnlyLog(path)
    assert log.read(str) == ['{"a": 1}']
    assert f'its {len(torn)} bytes are now in lines.jsonl.torn-1' in log.problems[0]
    assert path.with_name('lines.jsonl.torn-1').read_bytes() == torn
    log.append('{"b": 2}')
    assert AppendOnlyLog(path).read(str) == ['{"a": 1}', '{"b": 2}']


def test_a_second_torn_line_does_not_replace_the_first(path: Path) -> None:
    for torn in (b'{"first', b'{"second'):
        path.write_bytes(torn)
        AppendOnlyLog(path)
    names = ['lines.jsonl.torn-1', 'lines.jsonl.torn-2']
    assert [path.with_name(name).read_bytes() for name in names] == [b'{"first', b'{"second']


def test_a_last_line_that_lacks_only_its_end_is_kept(path: Path) -> None:
    path.write_bytes(b'{"a": 1}\n{"b": 2}')
    log = AppendOnlyLog(path)
    assert (log.read(str), log.problems) == (['{"a": 1}', '{"b": 2}'], [])
    assert path.read_bytes() == b'{"a": 1}\n{"b": 2}\n'


def test_a_line_that_is_not_utf8_is_left_out_and_named(path: Path) -> None:
    path.write_bytes(b'\xff\n{"a": 1}\n')
    log = AppendOnlyLog(path)
    assert log.read(str) == ['{"a": 1}']
    assert log.problems == [f'line 1 of {path} is left out: it is not a text in UTF-8']


def test_a_write_that_fails_half_way_leaves_the_file_as_it_was(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = AppendOnlyLog(path)
    log.append('{"a": 1}')
    write = os.write

    def full_disk(handle: int, content: memoryview) -> int:
        if len(content) > 4:
            return write(handle, content[:4])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, 'write', full_disk)
    with pytest.raises(OSError, match='No space left'):
        log.append('{"b": 2}')
    monkeypatch.undo()
    assert log.read(str) == ['{"a": 1}']
    assert path.read_bytes() == b'{"a": 1}\n'
    log.append('{"c": 3}')
    assert AppendOnlyLog(path).read(str) == ['{"a": 1}', '{"c": 3}']


def test_a_write_goes_on_after_a_part_of_it(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = os.write
    monkeypatch.setattr(os, 'write', lambda handle, content: write(handle, content[:3]))
    append_bytes(path, b'0123456789')
    assert path.read_bytes() == b'0123456789'
