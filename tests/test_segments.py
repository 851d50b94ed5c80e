"""Whole plays are cut at events, and the named segments become demonstrations of options."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any
import uuid
import warnings

import gymnasium
from humanopts_env.domains.base import action_index, Domain, DomainError
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.domains.taxi import Taxi
from humanopts_env.seeding import generator
from humanopts_learner.demonstration_table import demonstrations_to_table
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    make_demonstration,
)
from humanopts_learner.options.files import option_to_json
from humanopts_learner.options.learn import learn_option
from humanopts_learner.segments import cut, event_features, joined, Segment, suggested_features
from humanopts_learner.spreadsheet import csv_of
from humanopts_teach.cli import main
from humanopts_teach.lesson.store import DemonstrationStore
import minari
from minari.data_collector import EpisodeBuffer
from minigrid.wrappers import ImgObsWrapper
import numpy as np
import pytest

GET_KEY, OPEN, GO = 'get the key', 'open the door', 'go to the goal'
DOOR_KEY = 'gymnasium:MiniGrid-DoorKey-8x8-v0'


def walk(values: Mapping[str, str], thing: str, act: str) -> str:
    """Return the next action of a walk to a thing, which ends with an action."""
    move = values[f'{thing}_path']
    if move == 'forward' and values['front'] == 'closed door':
        return 'toggle'
    return act if move == 'there' else move


def in_minigrid(values: Mapping[str, str]) -> str:
    """Return the next action of a person who unlocks the door, and gets what is behind it."""
    if values['door_state'] == 'locked':
        empty = values['carrying'] == 'nothing'
        return walk(values, 'key', 'pickup') if empty else walk(values, 'door', 'toggle')
    if 'goal_path' in values:
        return walk(values, 'goal', 'forward')
    if values['carrying'] == 'key':
        return 'drop' if values['front'] == 'empty' else 'left'
    return walk(values, 'box' if 'box_path' in values else 'ball', 'pickup')


def play(domain: Domain, seed: int, slips: float = 0.0) -> Demonstration:
    """
    Return a play of the whole task.

    :param slips: share of steps with another action.
    """
    rng = generator(seed, 'play')
    references = reference_options(domain).values() if domain.name == 'taxi' else ()
    states, actions, rewards = [domain.reset(rng)], [], []
    while not domain.is_over(states[-1]):
        texts = zip(domain.features, domain.feature_values(states[-1]).tolist())
        if references:
            here = next(each for each in references if each.can_start(states[-1]))
            name = domain.actions[here.optimal_actions(states[-1])[0]].name
        else:
            name = in_minigrid({each.name: each.text(value) for each, value in texts})
        if rng.random() < slips:
            name = str(rng.choice([each.name for each in domain.actions[:3]]))
        outcome = domain.step(states[-1], action_index(domain, name), rng)
        states.append(outcome.state)
        actions.append(name)
        rewards.append(outcome.reward)
        assert len(actions) < 300, 'the play does not end'
    return make_demonstration(domain, 'the whole task', states, actions, rewards)


def ends(segments: Sequence[Segment]) -> list[str]:
    return [', '.join(segment.end) for segment in segments]


def test_a_play_of_doorkey_is_cut_where_the_key_is_taken_and_the_door_opens() -> None:
    domain = make_domain(DOOR_KEY)
    one = play(domain, 1)
    events = event_features(domain, [one])
    assert {*events} == {'carrying', 'key_present', 'door_state'}
    segments = cut(domain, one, events)
    assert ends(segments) == [
        'carrying: nothing -> key, key_present: yes -> no',
        'door_state: locked -> open',
        'the task is over',
    ]
    assert [segments[0].first, segments[-1].last] == [0, len(one.actions)]
    assert all(a.last == b.first for a, b in pairwise(segments))


@pytest.mark.parametrize('slips', [0.0, 0.05, 0.2])
@pytest.mark.parametrize(
    ('name', 'wanted'),
    [
        ('taxi', ['passenger_in_taxi']),
        (DOOR_KEY, ['carrying', 'door_state']),
        ('gymnasium:MiniGrid-UnlockPickup-v0', ['carrying', 'door_state']),
        ('gymnasium:MiniGrid-KeyCorridorS3R2-v0', ['carrying', 'door_state']),
    ],
)
def test_no_event_is_lost_even_if_the_person_slips(
    name: str, wanted: list[str], slips: float
) -> None:
    """The recall is 1.00, from three plays each."""
    domain = make_domain(name)
    for first in (0, 3, 6):
        plays = [play(domain, seed, slips) for seed in range(first, first + 3)]
        events = event_features(domain, plays)
        for one in plays:
            there = {segment.last for segment in cut(domain, one, events)}
            assert {segment.last for segment in cut(domain, one, wanted)} <= there, first


def test_neighbours_with_the_same_name_are_one_demonstration() -> None:
    domain = Taxi()
    one = play(domain, 2)
    segments = cut(domain, one, ['taxi_at_passenger', 'passenger_in_taxi'])
    assert len(segments) == 3
    found = joined(segments, ['fetch', 'fetch', ''])
    ((name, fetched),) = found
    assert (name, fetched.first, fetched.last) == ('fetch', 0, segments[1].last)
    shown = fetched.demonstration(name, ['taxi_row'])
    assert shown.states == one.states[: fetched.last + 1]
    assert (len(shown.actions), shown.terminated) == (fetched.last, False)
    with pytest.raises(DomainError, match='taxi has no feature colour; choose from taxi_row'):
        cut(domain, one, ['colour'])


@pytest.mark.parametrize('name', ['taxi', DOOR_KEY])
def test_an_option_from_segments_is_that_from_the_same_steps_shown_separately(name: str) -> None:
    """So it is as good; the last part of three plays, which ends with the task."""
    domain = make_domain(name)
    events = ['passenger_in_taxi'] if name == 'taxi' else ['carrying', 'door_state']
    plays = [play(domain, seed) for seed in range(3)]
    features = [feature.name for feature in domain.features[:4]]
    learned = []
    for whole in (True, False):
        shown = []
        for number, one in enumerate(plays, start=1):
            segment = cut(domain, one, events)[-1]
            demo = segment.demonstration('finish', features)
            if not whole:
                demo = make_demonstration(
                    domain,
                    'finish',
                    [domain.decode(text) for text in one.states[segment.first :]],
                    one.actions[segment.first :],
                    one.rewards[segment.first :],
                    features=features,
                )
            shown.append(replace(demo, number=number, uuid=f'{uuid.UUID(int=number)}'))
        check_demonstration(shown[0], domain)
        learned.append(option_to_json(learn_option(shown, domain, 1), shown))
    assert learned[0] == learned[1]


def test_the_suggested_features_explain_the_actions_and_the_end() -> None:
    domain = make_domain(DOOR_KEY)
    plays = [play(domain, seed) for seed in range(3)]
    each = zip(*(cut(domain, one, ['carrying', 'door_state']) for one in plays))
    assert [{*suggested_features(domain, segments)} for segments in each] == [
        {'carrying', 'key_path'},
        {'door_state', 'door_path'},
        {'goal_path'},
    ]


def test_plays_in_a_table_become_demonstrations_of_a_lesson(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    domain = make_domain(DOOR_KEY)
    table, out = tmp_path / 'plays.csv', tmp_path / 'lesson'
    frame = demonstrations_to_table([play(domain, seed) for seed in range(2)])
    frame['demonstration'] = frame.groupby('step').cumcount()
    table.write_text(csv_of(frame), 'utf-8')
    assert main(['import', 'table', str(table), DOOR_KEY]) == 0
    listed = capsys.readouterr().out
    assert 'events: changes of ' in listed
    assert 'to keep segments: --name NUMBER=OPTION' in listed
    names = [f'--name={number}={name}' for number, name in enumerate((GET_KEY, OPEN, GO), start=1)]
    given: list[Any] = ['import', 'table', table, DOOR_KEY, *names, '--out', out]
    assert main(list(map(str, given))) == 0
    assert f'{OPEN}: 2 demonstrations; depends on door_' in capsys.readouterr().out
    with DemonstrationStore(out / 'demonstrations') as store:
        kept = [each for each in store.entries('p1') if isinstance(each, Demonstration)]
    assert [each.option_name for each in kept] == [GET_KEY, GET_KEY, OPEN, OPEN, GO, GO]
    for each in kept:
        check_demonstration(each, domain)


@pytest.mark.parametrize(
    ('given', 'said'),
    [
        (['--name', '1=a'], 'to keep segments, give both --name and --out'),
        (['--out', 'x', '--name', '9=a'], "--name '9=a': there is no kind 9, only 1 to 3"),
        (['--out', 'x', '--name', 'a'], "--name 'a' is not of the form 1=OPTION"),
        (['--event', 'colour'], 'has no feature colour; choose from '),
    ],
)
def test_names_that_fit_no_segment_are_refused(
    given: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    domain = make_domain(DOOR_KEY)
    table = tmp_path / 'plays.csv'
    table.write_text(csv_of(demonstrations_to_table([play(domain, 1)])), 'utf-8')
    assert main(['import', 'table', str(table), DOOR_KEY, *given]) == 2
    assert said in capsys.readouterr().err


def collected(name: str, env: Any, actions: Sequence[int], seed: int | None) -> None:
    """Write an episode as a Minari dataset."""
    first, _ = env.reset(seed=seed)
    seen, rewards, terminations, truncations, _ = zip(*map(env.step, actions))
    buffer = EpisodeBuffer(
        id=0,
        seed=seed,
        observations=np.array([first, *seen]),
        actions=np.array(actions),
        rewards=list(rewards),
        terminations=list(terminations),
        truncations=list(truncations),
    )
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        minari.create_dataset_from_buffers(name, [buffer], env=env, data_format='arrow')


@pytest.fixture
def datasets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv('MINARI_DATASETS_PATH', str(tmp_path))
    return tmp_path


def test_a_minari_dataset_is_cut_and_kept(
    datasets: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    domain: Any = make_domain(DOOR_KEY)
    seed = 2**63  # as large as Minari's own
    state, actions = domain.decode(f'seed {seed} actions -'), []
    while not state.over:
        texts = zip(domain.features, domain.feature_values(state).tolist())
        actions.append(in_minigrid({each.name: each.text(value) for each, value in texts}))
        state = domain.step(state, action_index(domain, actions[-1]), generator(0, 'none')).state
    env = ImgObsWrapper(gymnasium.make('MiniGrid-DoorKey-8x8-v0'))
    numbers = [action_index(domain, action) for action in actions]
    collected('doorkey/ours-v0', env, numbers, seed)
    events = ['--event=carrying', '--event=door_state']
    given: list[Any] = ['import', 'minari', 'doorkey/ours-v0', '--folder', datasets, *events]
    names = [f'--name={number}={name}' for number, name in enumerate((GET_KEY, OPEN, GO), start=1)]
    assert main([*map(str, given), *names, '--out', str(datasets / 'lesson')]) == 0
    said = capsys.readouterr().out
    assert '3  the task is over' in said
    assert f'{GO}: 1 demonstration; depends on' in said
    collected('doorkey/seedless-v0', env, numbers, None)
    assert main(['import', 'minari', 'doorkey/seedless-v0']) == 2
    assert 'was recorded without its seed' in capsys.readouterr().err


@pytest.mark.parametrize('env_id', ['humanopts/Taxi-v0', 'Taxi-v4'])
def test_a_dataset_of_an_environment_with_a_table_is_cut(
    env_id: str, datasets: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    env = gymnasium.make(env_id)
    _, actions = env.reset(seed=3), []
    taxi, over = Taxi(), False
    while not over:
        inner: Any = env.unwrapped
        state = inner.state if env_id.startswith('humanopts') else taxi.state_at(inner.s)
        here = next(each for each in reference_options(taxi).values() if each.can_start(state))
        actions.append(here.optimal_actions(state)[0])
        over = env.step(actions[-1])[2]
    collected('taxi/ours-v0', env, actions, 3)
    assert main(['import', 'minari', 'taxi/ours-v0', '--event', 'passenger_in_taxi']) == 0
    said = capsys.readouterr().out
    assert 'passenger_in_taxi: no -> yes' in said
    assert 'passenger_in_taxi: yes -> no, the task is over' in said


def test_a_dataset_that_is_not_there_is_named_with_those_that_are(
    datasets: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['import', 'minari', 'no/such-v0']) == 2
    assert "no dataset 'no/such-v0' on this disk; there is: none" in capsys.readouterr().err


def test_the_episodes_of_a_bag_are_cut(
    lesson_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ['bag', 'segment', str(lesson_bag)]
    assert main([*given, '--episode', '1', '--event', 'passenger_in_taxi']) == 0
    said = capsys.readouterr().out
    assert 'episode 1: ' in said
    assert 'passenger_in_taxi: no -> yes' in said
    kept = ['--name', '1=fetch', '--out', str(tmp_path)]
    assert main([*given, '--event', 'passenger_in_taxi', *kept]) == 0
    assert 'fetch: ' in capsys.readouterr().out
    assert main([*given, '--episode', '9999']) == 2
    assert 'has no episode 9999 with all of its steps recorded' in capsys.readouterr().err
