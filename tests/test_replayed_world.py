"""A world that can only be reset and stepped is taught, planned in, and set to any state."""

from collections.abc import Iterator, Mapping, Sequence
import itertools

from graph_support.live import Graph
from graph_support.planning import start_planning
import gymnasium
from humanopts_env.domains.base import Action, Domain, Feature, StateError
from humanopts_env.domains.check import check_domain, ContractError
from humanopts_env.domains.reference import ReferenceOption
from humanopts_env.domains.replayed_domain import MAX_WORLDS, ReplayedDomain, World
from humanopts_env.game import Command, Game, Source
from humanopts_env.games import new_games
from humanopts_env.seeding import generator
from humanopts_env.testing import DomainContract, ReferenceContract
from humanopts_interfaces.msg import PolicyResult
from humanopts_learner.options.accuracy import policy_accuracy
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.planning.plan import judge_plan, make_plan
from humanopts_learner.planning.request import PlanRequest
from humanopts_learner.planning.sampled_plan import SampledPlan
from humanopts_learner.planning.stuck import try_plan
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.simulated_teacher import TeacherSettings
import numpy as np
import pytest
from teach_support.orchard import Field, FILL, install, Orchard, reference_options, UNLOAD

STEPS, SEED = 8_000, 1


class FrozenLake:
    """A Gymnasium environment as a world: slippery, so its chance must follow from the seed."""

    def __init__(self) -> None:
        self.env = gymnasium.make('FrozenLake-v1')

    def reset(self, seed: int) -> None:
        self.seen, _ = self.env.reset(seed=seed)

    def step(self, action: int) -> tuple[float, bool]:
        self.seen, reward, over, *_ = self.env.step(action)
        return float(reward), over

    def features(self) -> Sequence[float]:
        return [self.seen]


class Lake(ReplayedDomain):
    name, gamma, max_steps = 'lake', 0.95, 100
    parameters: dict[str, int] = {}
    features = (Feature.number('cell', 'which cell it is', 16),)
    actions = tuple(Action(f'go_{n}', str(n), f'go {n}') for n in range(4))

    def make_world(self) -> World:
        return FrozenLake()


class TestOrchard(DomainContract):
    def make(self) -> Domain:
        return Orchard()


class TestGymnasium(DomainContract):
    def make(self) -> Domain:
        return Lake()


class TestOptionsOfOrchard(ReferenceContract):
    def make(self) -> Domain:
        return Orchard()

    def options(self, domain: Domain) -> Mapping[str, ReferenceOption]:
        return reference_options(Orchard())


class Counted(Field):
    """A field that counts the steps taken in all fields."""

    steps = 0

    def step(self, action: int) -> tuple[float, bool]:
        Counted.steps += 1
        return super().step(action)


class CountedOrchard(Orchard):
    def make_world(self) -> Field:
        return Counted()


def test_going_on_takes_one_step_and_going_back_as_many_as_it_took() -> None:
    domain, rng = CountedOrchard(), generator(0, 'count')
    games, Counted.steps = new_games(domain, MAX_WORLDS - 1, rng), 0
    for _ in range(3):
        games.step(rng.integers(4, size=len(games)), rng)
    assert Counted.steps == 3 * len(games)
    (state,) = games.take(np.array([0])).states()
    assert domain.decode(domain.encode(state)) == state
    assert Counted.steps == 3 * len(games) + 3
    fresh, Counted.steps = CountedOrchard(), 0
    assert fresh.decode(domain.encode(state)) == state
    assert Counted.steps == 3
    branches = [fresh.step(state, action, rng).state for action in (0, 1, 0)]
    assert branches[0] == branches[2] != branches[1]
    assert Counted.steps == 3 + 1 + 2 * 4
    assert len(domain._worlds) <= MAX_WORLDS


def test_games_that_are_taken_out_continue_without_replay() -> None:
    domain, rng = CountedOrchard(), generator(0, 'take')
    games, Counted.steps = new_games(domain, 4, rng), 0
    for _ in range(3):
        games.step(rng.integers(4, size=len(games)), rng)
    some = games.take(np.array([2, 0]))
    some.step(np.zeros(2, dtype=np.intp), rng)
    assert Counted.steps == 3 * 4 + 2
    games.step(np.zeros(4, dtype=np.intp), rng)  # two of them are replayed
    assert games.take(np.array([2, 0])).states() == some.states()
    assert Counted.steps == 3 * 4 + 2 + 4 + 2 * 3


def test_the_world_in_a_state_can_be_looked_at_even_after_others_were_played() -> None:
    domain, rng = CountedOrchard(), generator(0, 'look')
    first = domain.reset(rng)
    second = domain.step(first, 3, rng).state
    for state in (first, second, first):
        looked = domain.world(state)
        assert looked is domain.world(state)
        assert tuple(looked.features()) == state.features


def test_a_game_is_begun_in_any_state_that_was_played() -> None:
    game = Game(Orchard())
    assert game.reset('', 3, Source.MACHINE).transition is not None
    for step in range(20):
        game.command(Command('/m#1', 1, Source.MACHINE, 1, step, 'east' if step % 2 else 'south'))
    played = game.transition
    elsewhere = Game(Orchard())
    begun = elsewhere.reset(played.state, 9, Source.PERSON).transition
    assert begun is not None
    assert (begun.state, begun.features) == (played.state, played.features)
    for text in (f'{played.state}4', 'seed 3 actions', 'seed -1 actions -', 'seed 07 actions 0'):
        with pytest.raises(StateError, match='write one like "seed 7 actions 0012"'):
            Orchard().decode(text)


def test_what_comes_after_the_end_is_no_state() -> None:
    domain, rng = Lake(), generator(0, 'over')
    state = domain.reset(rng)
    while not state.over:
        state = domain.step(state, int(rng.integers(4)), rng).state
    with pytest.raises(StateError, match=r'the task of lake with seed \d+ is over before that'):
        Lake().decode(f'{domain.encode(state)}0')


def test_a_world_that_its_seed_does_not_determine_is_refused() -> None:
    class Fickle(Field):
        def reset(self, seed: int) -> None:
            super().reset(next(resets))

    class FickleOrchard(Orchard):
        def make_world(self) -> Field:
            return Fickle()

    resets = itertools.count()
    with pytest.raises(ContractError, match='gives another result with the same generator'):
        check_domain(FickleOrchard(), 'orchard')


@pytest.fixture(scope='module', autouse=True)
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        install(tmp_path_factory.mktemp('installed'), patch)
        yield


@pytest.fixture(scope='module')
def taught() -> Sequence[LearnedOption]:
    lesson = teach(
        Orchard(), TeacherSettings((FILL.name, UNLOAD.name), seed=1), LessonRules(seed=1)
    )
    assert not lesson.cut_short
    return lesson.options


def planned(options: Sequence[LearnedOption], *columns: str) -> SampledPlan:
    request = PlanRequest('human', game_steps=STEPS, seed=SEED, columns=columns)
    made = make_plan(Orchard(), options, request)
    assert isinstance(made, SampledPlan)
    return made


def test_it_is_taught_and_planned_in_by_samples(taught: Sequence[LearnedOption]) -> None:
    """Two options after a few demonstrations; a plan carries everything home."""
    domain = Orchard()
    for option in taught:
        assert policy_accuracy(option, domain, reference_options(domain)[option.name]) > 0.98
    assert planned(taught).play(1, 40).successes.mean() > 0.9


def test_nodes_plan_and_play_in_it(shared: Graph, taught: Sequence[LearnedOption]) -> None:
    planning = start_planning(shared, episodes=1, seed=SEED, domain='orchard')
    planning.teach(taught)
    result = planning.plan('human', game_steps=STEPS, evaluation_episodes=5, columns=['basket'])
    assert planning.plan_goals[-1].columns == ['basket']
    plan = planned(taught, 'basket')
    assert result.mean_return == judge_plan(plan, SEED, 5).total.mean
    trial = try_plan(plan, SEED)
    found = result.trial_games, tuple(result.stuck_options), tuple(result.stuck_states)
    assert found == (trial.games, trial.options, trial.states)
    played = planning.play('human')
    assert played.status == PolicyResult.STATUS_DONE
    last = planning.player.state
    assert last.terminated
    assert planning.player.reset(planning.player.states[-3].state).state.startswith('seed')
