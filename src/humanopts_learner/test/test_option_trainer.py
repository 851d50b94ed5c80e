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

from humanopts_env.domains.taxi import Taxi, TaxiState
from humanopts_learner.append_only_log import AppendOnlyLog
from humanopts_learner.demonstrations import Demonstration, DemonstrationError
from humanopts_learner.option_trainer import DATA_SET, DataSetError, OptionTrainer
from humanopts_learner.options.files import load_options, option_from_json
from humanopts_learner.options.judge import judge, Thresholds
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption
import pytest

TAXI = Taxi()
SEED = 2
ABOARD = TaxiState(row=2, col=2, passenger=4, destination=3)
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


def withdrawn(demo: Demonstration) -> Demonstration:
    return replace(demo, withdrawn=True)


def test_a_demonstration_is_learned_from_once_and_known_again_when_it_is_opened_again(
    reopen: Open, few: list[Demonstration], tmp_path: Path, trainer: OptionTrainer
) -> None:
    assert [trainer.take(demo) for demo in few] == [True] * 6
    again = reopen()
    for each in (trainer, again):
        assert each.take(few[3]) is False
        (taught,) = each.options()
        assert taught.option == learn_option(few, TAXI, SEED)
        assert taught.summary == judge(few, TAXI, Thresholds(), SEED)
        assert option_from_json(taught.file) == (taught.option, [])
        assert each.problems == []
    assert load_options(tmp_path / 'options') == ([taught.option], [])


def test_participants_and_options_are_kept_apart_and_read_again_on_return(
    person: Any, tmp_path: Path, reopen: Open, trainer: OptionTrainer
) -> None:
    one, two = person(seed=1).show_random(4), person(seed=2).show_random(1)
    other = person(DELIVER, seed=1).show_random(3)
    for demo in (*one[:3], *other, *two, withdrawn(one[0]), *two, one[3]):
        trainer.take(demo)
    mine, delivering, theirs = trainer.options()
    assert mine.option == learn_option(one[1:], TAXI, SEED)
    assert mine.summary == judge(one[1:], TAXI, Thresholds(), SEED)
    assert delivering.option == learn_option(other, TAXI, SEED)
    assert (theirs.summary.participant, theirs.summary.last_uuid) == ('person 2', two[0].uuid)
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
    assert {p.summary.participant for p in trainer.options()} == {'person 1'}


def test_of_people_who_are_gone_no_demonstrations_and_trees_stay_in_memory(
    few: list[Demonstration], trainer: OptionTrainer
) -> None:
    def of(kind: type) -> list[str]:
        gc.collect()
        return [each.participant for each in gc.get_objects() if isinstance(each, kind)]

    options = len(of(LearnedOption))
    for who in ('gone', 'gone too', 'here'):
        for demo in few:
            uuid = str(uuid5(NAMESPACE_OID, who + demo.uuid))
            trainer.take(replace(demo, participant=who, uuid=uuid))
    shown = Counter(of(Demonstration))
    assert (shown['gone'], shown['gone too'], shown['here']) == (0, 0, len(few))
    assert len(of(LearnedOption)) == options


@pytest.mark.parametrize(
    ('fields', 'says'),
    [
        ({'option_name': ''}, 'names no option'),
        ({'option_name': 'x' * 61}, 'has 61 characters'),
        ({'option_name': 'go\x1b[2J'}, 'cannot be printed'),
        ({'option_name': 'action:north'}, 'primitive actions'),
        ({'participant': 'p\n1'}, 'its participant has characters'),
        ({'session': 's' * 1000}, 'its session has 1000 characters'),
    ],
)
def test_what_cannot_be_used_is_refused_and_not_kept(
    few: list[Demonstration],
    tmp_path: Path,
    fields: dict[str, str],
    says: str,
    trainer: OptionTrainer,
) -> None:
    with pytest.raises(DemonstrationError, match=says):
        trainer.take(replace(few[0], **fields))
    assert trainer.options() == []
    assert not (tmp_path / 'options' / DATA_SET).exists()
    assert trainer.take(few[0])


def test_lines_that_cannot_be_used_are_named_and_the_others_are_kept(
    reopen: Open, few: list[Demonstration], tmp_path: Path, trainer: OptionTrainer
) -> None:
    for demo in few[:2]:
        trainer.take(demo)
    file = tmp_path / 'options' / DATA_SET
    file.write_text('not JSON\n' + '[' * 100_000 + '\n' + file.read_text() + '{"kind": "traj')
    again = reopen()
    assert again.options() == trainer.options()
    torn, unusable, deep = again.problems
    assert 'was cut off' in torn
    assert unusable.startswith(f'line 1 of {file} is left out: not a demonstration')
    assert deep.startswith('line 2 of ')
    assert 'nested more than' in deep
    assert file.read_text().startswith('not JSON\n')


def test_a_folder_or_a_file_that_cannot_be_used_is_named_and_loses_nothing(
    few: list[Demonstration], reopen: Open, tmp_path: Path, trainer: OptionTrainer
) -> None:
    (tmp_path / 'file').touch()
    with pytest.raises(DataSetError, match=r'cannot use the folder .*file: '):
        OptionTrainer(tmp_path / 'file', TAXI, Thresholds(), SEED)
    data = tmp_path / 'options' / DATA_SET
    data.mkdir()
    with pytest.raises(DataSetError, match=r'cannot write .*jsonl: Is a directory'):
        trainer.take(few[0])
    assert trainer.options() == []
    data.rmdir()
    assert trainer.take(few[0])
    (file,) = (tmp_path / 'options').glob('*/*.json')
    file.unlink()
    file.parent.rmdir()
    file.parent.touch()
    assert trainer.take(few[1])
    (problem,) = trainer.problems
    assert 'cannot write the file of' in problem
    assert reopen().options()[0].option == learn_option(few[:2], TAXI, SEED)


def test_what_is_withdrawn_is_unlearned_with_its_file_and_stays_so(
    reopen: Open, few: list[Demonstration], tmp_path: Path, trainer: OptionTrainer
) -> None:
    assert trainer.take(withdrawn(few[2])) is True  # came first
    for demo in few[:2]:
        trainer.take(demo)
    assert trainer.take(withdrawn(few[1])) is True
    for again in (few[1], withdrawn(few[1]), few[2]):
        assert trainer.take(again) is False
    (taught,) = trainer.options()
    assert taught.option == learn_option(few[:1], TAXI, SEED)
    assert reopen().options() == trainer.options()
    trainer.take(withdrawn(few[0]))
    assert trainer.options() == reopen().options() == []
    assert load_options(tmp_path / 'options') == ([], [])
    trainer.take(few[3])
    assert load_options(tmp_path / 'options')[0] == [learn_option([few[3]], TAXI, SEED)]


def test_not_here_alone_is_counted_but_is_no_option_and_has_no_file(
    few: list[Demonstration], person: Any, tmp_path: Path, trainer: OptionTrainer
) -> None:
    refusal = person().show(ABOARD)
    for demo in (refusal, few[0], withdrawn(few[0])):
        trainer.take(demo)
        (taught,) = trainer.options()
        assert (taught.summary.n_not_here, taught.option is None) == (1, demo is not few[0])
    assert (taught.summary.last_uuid, taught.file) == (refusal.uuid, '')
    assert load_options(tmp_path / 'options') == ([], [])


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / 'lines.jsonl'


def test_what_was_appended_is_there_when_it_is_opened_again(path: Path) -> None:
    log = AppendOnlyLog(path)
    assert (log.read(str), log.problems, path.exists()) == ([], [], False)
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


def test_a_last_line_that_was_cut_off_is_moved_aside(path: Path) -> None:
    path.write_bytes(b'{"a": 1}\n')
    for number, torn in enumerate((b'{"a": ', b'{', 'é'.encode()[:1]), 1):
        with path.open('ab') as file:
            file.write(torn)
        log = AppendOnlyLog(path)
        assert log.read(str) == ['{"a": 1}']
        assert f'its {len(torn)} bytes are now in lines.jsonl.torn-{number}' in log.problems[0]
        assert path.with_name(f'lines.jsonl.torn-{number}').read_bytes() == torn
    log.append('{"b": 2}')
    assert AppendOnlyLog(path).read(str) == ['{"a": 1}', '{"b": 2}']


def test_a_last_line_that_lacks_only_its_end_is_kept(path: Path) -> None:
    path.write_bytes(b'{"a": 1}\n{"b": 2}')
    log = AppendOnlyLog(path)
    assert (log.read(str), log.problems) == (['{"a": 1}', '{"b": 2}'], [])
    assert path.read_bytes() == b'{"a": 1}\n{"b": 2}\n'


def test_a_line_that_is_not_utf8_is_left_out_and_named(path: Path) -> None:
    path.write_bytes(b'\xff\n{"a": 1}\n')
    log = AppendOnlyLog(path)
    assert log.read(str) == ['{"a": 1}']
    assert log.problems == [f'line 1 of {path} is left out: it is not UTF-8 text']


def test_a_write_goes_on_after_a_part_of_it_and_leaves_the_file_as_it_was_where_it_fails(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, write = AppendOnlyLog(path), os.write
    monkeypatch.setattr(os, 'write', lambda handle, content: write(handle, content[:3]))
    log.append('{"a": 1}')

    def full_disk(handle: int, content: memoryview) -> int:
        if len(content) > 4:
            return write(handle, content[:4])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, 'write', full_disk)
    with pytest.raises(OSError, match='No space left'):
        log.append('{"b": 2}')
    monkeypatch.undo()
    assert path.read_bytes() == b'{"a": 1}\n'
    log.append('{"c": 3}')
    assert AppendOnlyLog(path).read(str) == ['{"a": 1}', '{"c": 3}']
