"""A domain with continuous features is taught, learned, kept and sent like any other."""

from collections.abc import Mapping
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import gymnasium
from gymnasium.utils.env_checker import check_env
from humanopts_env.domains.base import Domain, Feature
from humanopts_env.domains.check import check_domain, ContractError
from humanopts_env.domains.reference import ReferenceOption
from humanopts_env.domains.registry import domain_from_json, make_domain
from humanopts_env.game import check_transition, Game, transition_from_message
from humanopts_env.gym_env import spec_of
from humanopts_env.ros.convert import domain_from_info, domain_to_info, transition_to_message
from humanopts_env.seeding import generator
from humanopts_env.testing import DomainContract, ReferenceContract
from humanopts_interfaces.msg import FeatureInfo
from humanopts_learner.demonstration_table import (
    demonstrations_from_table,
    demonstrations_to_table,
)
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    demonstration_from_message,
    DemonstrationError,
    make_demonstration,
)
from humanopts_learner.options.conflicts import advise, SAY_AGAIN
from humanopts_learner.options.decision_tree import encode_rows, feature_encoding, fit_tree
from humanopts_learner.options.files import load_option, save_option
from humanopts_learner.options.learn import learn_option, make_dataset
from humanopts_learner.options.rollout import rollouts
from humanopts_learner.options.starts import choose_start_state
from humanopts_learner.ros.convert import demonstration_to_message
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.simulated_teacher import TeacherSettings
from humanopts_teach.report.rules import tree_lines
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sklearn.tree import DecisionTreeClassifier
from teach_support.lake import Lake, LakeState, reference_options, SHORE, ToTheWestShore

LAKE = Lake()
WEST = ToTheWestShore.name
POINTS = """
[humanopts.domains]
lake = teach_support.lake:Lake
[humanopts.reference_options]
lake = teach_support.lake:reference_options
"""


class TestLake(DomainContract):
    def make(self) -> Domain:
        return Lake()


class TestOptionsOfLake(ReferenceContract):
    def make(self) -> Domain:
        return Lake()

    def options(self, domain: Domain) -> Mapping[str, ReferenceOption]:
        return reference_options(domain)


@pytest.fixture(scope='module', autouse=True)
def installed(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Register the domain as a package of another author does."""
    info = tmp_path_factory.mktemp('installed') / 'lake-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: lake\nVersion: 1.0\n')
    (info / 'entry_points.txt').write_text(POINTS)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(info.parent))
        yield


def row_west(x: float, seed: int) -> Demonstration:
    """Show how to row west, as a script."""
    state, rng = LakeState(x, 3.0), generator(seed, 'row')
    states, actions = [state], []
    while states[-1].x > SHORE:
        states.append(LAKE.step(states[-1], 1, rng).state)
        actions.append('west')
    rewards = [-1.0] * len(actions)
    return make_demonstration(LAKE, WEST, states, actions, rewards, features=['x'], number=seed)


@pytest.fixture(scope='module')
def shown() -> list[Demonstration]:
    return [row_west(9.75 - seed, seed) for seed in range(1, 6)]


def test_a_simulated_teacher_teaches_an_option_that_reaches_its_end() -> None:
    rules = LessonRules('failures', budget=12, seed=1)
    taught = teach(LAKE, TeacherSettings((WEST,), seed=1), rules)
    (option,) = taught.options
    assert option.features == ('x',)
    starts = [s for s in LAKE.sample_states(generator(2, 'starts'), 200) if s.x > SHORE + 0.5]
    runs = rollouts(option, LAKE, starts)
    assert runs.reached.mean() > 0.95
    assert make_domain('lake').features == LAKE.features


def test_a_tree_decides_as_scikit_learn_does_to_the_last_bit_of_a_float32() -> None:
    """Values closer than float32 tells apart fall on one side of every threshold."""
    rng = generator(3, 'trees')
    x = rng.uniform(0, 10, 300)
    near = np.concatenate([x, np.nextafter(x, 10), x * (1 + 1e-7), x * (1 - 1e-7)])
    rows = np.stack([near, rng.permutation(near) * 0.6, rng.integers(2, size=len(near))], axis=1)
    labels = (np.sin(5 * near) > 0).astype(np.intp)
    encoding = feature_encoding(LAKE, ['x', 'y', 'wind'])
    X = encode_rows(encoding, rows)
    ours = fit_tree(X, labels, (0, 1), 0)
    assert len(ours.left) > 30
    theirs = DecisionTreeClassifier(random_state=0).fit(X, labels)
    whole = np.column_stack([rows[:, :2], rows[:, 2] == 0, rows[:, 2] == 1])
    assert np.array_equal(ours.leaves(X)[:, 0], theirs.apply(whole))


def test_an_option_file_gives_the_same_option(shown: list[Demonstration], tmp_path: Path) -> None:
    option = learn_option(shown, LAKE, 0)
    assert load_option(save_option(tmp_path, option, shown)) == (option, shown)
    starts = np.array([[x, 3.0, 0] for x in np.linspace(0, 10, 500)])
    assert option.can_start(starts[starts[:, 0] > 2.5]).all()
    option.check_domain(LAKE)
    rules = tree_lines(option.termination, ('on', 'ends'), option.encoding, LAKE)
    assert any(line.startswith('x > 2') and ' m: on' in line for line in rules)


def test_a_demonstration_survives_its_table_its_json_and_its_message(
    shown: list[Demonstration],
) -> None:
    text = demonstrations_to_table(shown).to_csv(index=False)
    import pandas as pd

    table = pd.read_csv(StringIO(text))
    again = demonstrations_from_table(table, LAKE, features=['x'])
    for demo, read in zip(shown, again, strict=True):
        assert (read.features, read.states, read.actions) == (
            demo.features,
            demo.states,
            demo.actions,
        )
        assert Demonstration.from_json(demo.to_json()) == demo
        message = demonstration_to_message(demo)
        over_the_wire = deserialize_message(serialize_message(message), type(message))
        assert demonstration_from_message(over_the_wire) == demo
        check_demonstration(demo, LAKE)


@pytest.mark.parametrize('x', [10.5, -0.1, float('nan'), float('inf')])
def test_a_value_out_of_its_range_is_refused(shown: list[Demonstration], x: float) -> None:
    game = Game(LAKE)
    transition = game.reset('boat 5.0,3.0 calm', 0, 1).transition
    assert transition is not None
    message = transition_to_message(replace(transition, features=(x, 3.0, 0.0)))
    with pytest.raises(ValueError, match='feature x of lake cannot be'):
        check_transition(transition_from_message(message), LAKE)
    rows = ((x, 3.0, 0.0), *shown[0].features[1:])
    with pytest.raises(DemonstrationError, match='feature x of lake cannot be'):
        check_demonstration(replace(shown[0], features=rows), LAKE)


def test_its_description_and_states_survive_their_messages() -> None:
    info = domain_to_info(LAKE)
    x, y, wind = info.features
    assert (x.kind, x.unit, x.low, x.high) == (FeatureInfo.KIND_CONTINUOUS, 'm', 0.0, 10.0)
    assert (wind.value_names, y.value_names) == (['calm', 'windy'], [])
    assert list(domain_from_info(info).features) == list(LAKE.features)
    assert domain_from_json('lake', '{}').name == 'lake'
    transition = Game(LAKE).reset('', 5, 1).transition
    assert transition is not None
    assert transition_from_message(transition_to_message(transition)) == transition


def test_gymnasium_sees_a_box() -> None:
    env = gymnasium.make(spec_of(LAKE))
    space = env.observation_space
    assert isinstance(space, gymnasium.spaces.Box)
    assert (space.low.tolist(), space.high.tolist()) == ([0, 0, 0], [10, 6, 1])
    check_env(env.unwrapped, skip_render_check=True)


def test_the_next_start_is_far_from_those_shown_relative_to_the_range() -> None:
    """6 m of y are as far as 10 m of x."""
    south = make_demonstration(LAKE, WEST, [LakeState(5.0, 0.1)], features=['x', 'y'])
    chosen = choose_start_state('coverage', LAKE, None, [south], generator(0, 'far'))
    assert chosen.y > 5.5
    assert min(chosen.x, 10 - chosen.x) < 0.5


def at(x: float, y: float) -> Demonstration:
    """Show three strokes to the north that the option ends with."""
    states = [LakeState(x, y + n) for n in range(4)]
    return make_demonstration(LAKE, 'stop', states, 3 * ['north'], 3 * [-1.0], features=['wind'])


def test_a_continuous_feature_is_suggested_only_on_more_evidence_than_chance() -> None:
    """Any two values differ; that one tenth of the range has four ends and no more is evidence."""
    for count, expected in ((1, ()), (4, ('Add "y": it tells where the option ends.', SAY_AGAIN))):
        demos = [replace(at(5.0, 1.0 + 0.1 * n), number=n + 1) for n in range(count)]
        assert advise(make_dataset(demos, LAKE), LAKE) == expected


@pytest.mark.parametrize('high', [0.0, -1.0, float('inf'), float('nan')])
def test_a_range_must_have_a_finite_length(high: float) -> None:
    lake = Lake()
    lake.features = (Feature.continuous('x', 'how far', 0.0, high), *LAKE.features[1:])
    with pytest.raises(ContractError, match='the feature x has the range'):
        check_domain(lake, 'lake')
