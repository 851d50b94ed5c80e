"""Option files: they come back as they were, and a damaged one harms nothing."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
import json
import os
from pathlib import Path
from typing import Any

from humanopts_env.domains.taxi import Taxi
from humanopts_learner import Demonstration, learn_option, LearnedOption, load_option, save_option
from humanopts_learner.options.files import (
    load_options,
    option_from_json,
    option_path,
    option_to_json,
    OptionFileError,
)
from humanopts_learner.options.learned_option import OptionError
from humanopts_learner.options.rollout import rollouts
from humanopts_learner.ros.convert import demonstration_to_message
from hypothesis import given, settings
from hypothesis import strategies as st
import pytest

TAXI = Taxi()
Shown = Sequence[Demonstration]


@pytest.fixture(scope='session')
def option(fetching: Shown) -> LearnedOption:
    """Return an option learned from all demonstrations of ``fetching``."""
    return learn_option(fetching, TAXI, 0)


def test_an_option_comes_back_with_its_demonstrations(
    option: LearnedOption, fetching: Shown, person: Any
) -> None:
    """And its file has one node and one demonstration on each line."""
    text = option_to_json(option, fetching)
    assert option_from_json(text) == (option, list(fetching))
    assert option_from_json(option_to_json(option)) == (option, [])
    trees = option.policy, option.initiation, option.termination
    lines = text.splitlines()
    assert sum('"counts"' in line for line in lines) == sum(len(tree.left) for tree in trees)
    assert sum('"uuid":' in line for line in lines) == len(fetching)
    ann = person()
    ann.features = (*ann.features, 'blocked_moves')  # which is nominal
    nominal = learn_option(ann.show_random(5), TAXI, 0)
    assert option_from_json(option_to_json(nominal))[0] == nominal


Damage = Callable[[dict[str, Any]], object]


@pytest.mark.parametrize(
    ('damage', 'message'),
    [
        (lambda d: d.update(format='bag'), 'format: it should be'),
        (lambda d: d.update(version=2), 'version: it should be 1, not 2'),
        (lambda d: d.pop('policy'), 'policy: Field required'),
        (lambda d: d.pop('uuids'), 'uuids: Field required'),
        (lambda d: d.update(name=3), 'name: it should be'),
        (lambda d: d.update(name=' '), 'the name is empty'),
        (lambda d: d.update(name='a\x1b[2J'), 'cannot be printed'),
        (lambda d: d['demonstrations'][0].update(option_name=True), '1 option_name: it should'),
        (lambda d: d.update(max_steps=0), 'max_steps 0'),
        (lambda d: d.update(max_steps='9'), 'max_steps: it should'),
        (lambda d: d.update(n_not_here=-1), 'n_not_here: it should'),
        (lambda d: d.update(domain_parameters='{}'), 'domain_parameters: it should'),
        (lambda d: d.update(actions=[1, 2]), 'actions 1: it should'),
        (lambda d: d.update(actions=d['actions'][:-1]), 'among its actions'),
        (lambda d: d.update(features=['taxi_row']), 'not those that it names'),
        (lambda d: d.update(encoding=[]), 'other features'),
        (lambda d: d['policy']['nodes'].pop(), 'child of exactly one'),
        (lambda d: d['policy']['nodes'][0].pop('right'), 'child of exactly one'),
        (lambda d: d['policy']['nodes'][0].update(left=-1), 'left: it should'),
        (lambda d: d['policy']['nodes'][0].update(at_most='0.5'), 'at_most: it should'),
        (lambda d: d['policy']['nodes'][0].update(counts=[1]), 'has not 6 counts'),
        (lambda d: d['policy'].update(columns=1), 'other features|tests another'),
        (lambda d: d['encoding'][0].update(value=2**31), 'encoding 1 value: .* 2147483647'),
        (lambda d: d['encoding'][0].pop('index'), 'index: Field required'),
        (lambda d: d.update(demonstrations=[{}]), 'demonstrations 1 kind: Field required'),
        (lambda d: d['demonstrations'].pop(), 'not those that it was learned from'),
    ],
)
def test_a_damaged_file_is_refused(
    option: LearnedOption, fetching: Shown, damage: Damage, message: str
) -> None:
    data = json.loads(option_to_json(option, fetching))
    damage(data)
    with pytest.raises(OptionFileError, match=message):
        option_from_json(json.dumps(data))


def numbers_in(value: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the keys that lead to each number of JSON data."""
    if isinstance(value, dict | list):
        for key, each in value.items() if isinstance(value, dict) else enumerate(value):
            yield from numbers_in(each, (*place, key))
    elif type(value) in (int, float):
        yield place


@pytest.mark.heavy
@pytest.mark.parametrize('wrong', [2**31, 2**64 - 1, -1, 0.5, True, '1'])
def test_a_file_with_any_number_replaced_is_refused_or_can_be_used(
    option: LearnedOption, fetching: Shown, wrong: object
) -> None:
    small = learn_option(fetching[:3], TAXI, 0)
    text = option_to_json(small, fetching[:3])
    rows, loaded = TAXI.feature_table(), []
    for *place, last in numbers_in(json.loads(text)):
        data = json.loads(text)
        at = data
        for key in place:
            at = at[key]
        at[last] = wrong
        with suppress(OptionError):
            found, shown = option_from_json(json.dumps(data))
            loaded.append((*place, last))
            found.check_domain(TAXI)
            assert found.termination_probability(rows).min() >= 0
            assert found.action(rows).max() < len(TAXI.actions)
            assert option_from_json(option_to_json(found, shown)) == (found, shown)
            demonstration_to_message(shown[0]) if shown else None
            rollouts(found, TAXI, [TAXI.decode(fetching[0].states[0])])
    if wrong in (2**31, '1'):
        real = {'at_most', 'features', 'rewards', 'seconds'}
        free = {at for at in loaded if real & set(at)}
        assert {at for at in loaded if 'domain_parameters' not in at} == (
            free if wrong != '1' else set()
        )


@pytest.mark.heavy
@settings(max_examples=100)
@given(
    place=st.floats(0, 1), text=st.sampled_from(['', '-', '9', 'null', '[]', '{}', '"x"', '1e999'])
)
def test_no_damage_ends_in_another_error(
    option: LearnedOption, fetching: Shown, place: float, text: str
) -> None:
    whole = option_to_json(option, fetching[:0])
    at = int(place * len(whole))
    with suppress(OptionFileError):
        option_from_json(whole[:at] + text + whole[at + 1 :])


def test_files_are_kept_by_person_and_option(
    option: LearnedOption, fetching: Shown, tmp_path: Path
) -> None:
    path = save_option(tmp_path, option, fetching, 'learned: in a test')
    assert path == option_path(tmp_path, option.participant, option.name)
    assert json.loads(path.read_text())['status'] == 'learned: in a test'
    assert path.name.startswith('go-to-passenger-and-pickup')
    assert load_option(path) == (option, list(fetching))
    assert load_options(tmp_path) == ([option], [])
    assert [file.name for file in path.parent.iterdir()] == [path.name]  # nothing temporary


@pytest.mark.heavy
@settings(max_examples=30)
@given(st.sets(st.text(min_size=1, max_size=60), min_size=2, max_size=6))
def test_no_two_names_share_a_file(option: LearnedOption, names: set[str]) -> None:
    folder = Path('options')
    paths = {option_path(folder, option.participant, name) for name in names}
    people = {option_path(folder, name, option.name) for name in names}
    assert len(paths) == len(people) == len(names)
    for path in paths | people:
        assert path.parent.parent == folder
        assert len(path.name) < 80
        assert path.name.isascii()


def test_links_and_deep_files_are_left_out_and_named(
    option: LearnedOption, fetching: Shown, tmp_path: Path
) -> None:
    path = save_option(tmp_path / 'there', option, fetching)
    folder = tmp_path / 'folder'
    (folder / 'p9').mkdir(parents=True)
    (folder / 'p9' / 'deep.json').write_text('{"format": ' + '[' * 100_000)
    (folder / 'p9' / 'link.json').symlink_to(path)
    (folder / 'linked').symlink_to(path.parent)
    (tmp_path / 'whole').symlink_to(folder)
    options, problems = load_options(tmp_path / 'whole')
    assert options == []
    texts = list(map(str, problems))
    assert len(texts) == 4
    assert sum('is a symbolic link' in text for text in texts) == 3
    assert sum('nested more than' in text for text in texts) == 1
    option_path(folder, option.participant, option.name).parent.symlink_to(path.parent)
    with pytest.raises(OSError, match='symbolic link'):
        save_option(folder, option, fetching)


def test_a_damaged_file_stops_no_other_and_is_moved_aside_when_its_option_is_saved(
    option: LearnedOption, fetching: Shown, tmp_path: Path
) -> None:
    save_option(tmp_path, option, fetching)
    other = replace(option, name='other')
    bad = save_option(tmp_path, other, fetching)
    bad.write_text('{"format": "humanopts-option"')
    (bad.parent / 'binary.json').write_bytes(b'\xff\xfe\x00')
    options, problems = load_options(tmp_path)
    assert options == [option]
    assert [str(bad) in str(problem) for problem in problems] == [False, True]
    assert 'not JSON' in str(problems[1])
    assert bad.read_text() == '{"format": "humanopts-option"'
    for number, content in [(1, 'half a fi'), (2, 'another')]:
        bad.write_text(content)
        save_option(tmp_path, other, fetching)
        assert bad.with_name(f'{bad.name}.damaged-{number}').read_text() == content
    assert load_options(tmp_path)[0] == [option, other]


def test_a_write_that_fails_leaves_what_was_there(
    option: LearnedOption, fetching: Shown, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    older = learn_option(fetching[:5], TAXI, 0)
    path = save_option(tmp_path, older, fetching[:5])

    def full(_: int) -> None:
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(os, 'fsync', full)
    with pytest.raises(OSError, match='No space left'):
        save_option(tmp_path, option, fetching)
    assert load_option(path)[0] == older
    assert len(list(path.parent.iterdir())) == 1
