"""Options found without a person: bottlenecks by hand, what is found, and its learned form."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

from humanopts_env.domains.base import Domain, DomainError, Transitions
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.registry import make_domain
from humanopts_env.domains.rooms import Rooms
from humanopts_env.domains.taxi import ABOARD, Taxi
from humanopts_env.seeding import generator
from humanopts_learner import find_options, LearnedOption, to_learned_options
from humanopts_learner.automatic.bottlenecks import Bottleneck, find_bottlenecks, Visits
from humanopts_learner.automatic.extract import AutomaticOptions, search_space
from humanopts_learner.automatic.subgoals import draw_tasks, Extraction, USUAL
from humanopts_learner.execution import Execution
from humanopts_learner.options.files import option_from_json, option_to_json
from humanopts_learner.options.learned_option import tabulate
from humanopts_learner.planning.action_set import ActionSet, AnyOption
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import (
    NoOptionsError,
    PlanCanceled,
    PlanError,
    PlanRequest,
    select_options,
)
import numpy as np
import pytest

CORRIDOR = '%%%%%%%\n%P....%\n%%%%%%%'  # five cells in a row
LONG_CORRIDOR = '%%%%%%%%%\n%P......%\n%%%%%%%%%'
RING = '%%%%%\n%P..%\n%.%.%\n%...%\n%%%%%'  # in rows 0 1 2, 3 4, 5 6 7
CROSSING = '%%%%%%%\n%%%.%%%\n%%%.%%%\n%P....%\n%%%.%%%\n%%%%%%%'
QUICK = Extraction(tasks=60, train_episodes=60, option_episodes=100, max_steps=300)
PAPERS_NINE = {f'{event} at {place}' for event in ('pickup', 'dropoff') for place in 'RGYB'}


@cache
def domain_of(name: str) -> Any:
    """Return a domain; of Pac-Man the small maze."""
    return make_domain(name, {'maze': 'yard'} if name == 'pacman' else {})


@cache
def search(name: str, seed: int) -> AutomaticOptions:
    return find_options(domain_of(name), seed, USUAL if name == 'taxi' else QUICK)


def found(name: str, seed: int = 0) -> AutomaticOptions:
    """Return what is found in a domain; in Taxi with the usual parameters."""
    return search(name, seed)


@cache
def options(name: str) -> list[LearnedOption]:
    """Return the same as learned options."""
    return to_learned_options(domain_of(name), found(name))


def bottlenecks(domain: Domain, runs: list[list[int]], most: int = 9) -> list[Bottleneck]:
    """Return the bottlenecks of runs that are given as states."""
    run = np.repeat(np.arange(len(runs)), [len(states) for states in runs])
    return find_bottlenecks(Visits(search_space(domain), run, np.concatenate(runs)), most)


def test_visits_of_runs_through_a_bottleneck_are_subtracted() -> None:
    """Cell 2 is in three runs; without these cell 4 has two visits, and cell 3 has one."""
    runs = [[0, 1, 2], [1, 2], [3, 2], [4, 4, 3]]
    names = [(b.name, b.visits) for b in bottlenecks(PacMan(maze=CORRIDOR), runs)]
    assert names == [('go to cell 0,2', 3), ('go to cell 0,4', 2)]


def test_an_option_starts_where_more_than_the_mean_of_runs_come_by() -> None:
    """On the way to cell 6: 5 four times, 4 three times, 3 once; the mean of seven is 1.1."""
    runs = [[3, 4, 5, 6], [4, 5, 6], [4, 5, 6], [5, 6], [6]]
    first = bottlenecks(PacMan(maze=LONG_CORRIDOR), runs, 1)[0]
    assert first.cell == 6
    assert np.flatnonzero(first.initiation).tolist() == [4, 5]


def test_an_initiation_set_is_completed_where_most_neighbours_are_inside() -> None:
    """Both neighbours of cell 7 are inside, so it is, too; of those of cell 5, one is."""
    runs = [[4, 6, 2], [4, 6, 2], [4, 6, 2], [2]]
    region = bottlenecks(PacMan(maze=RING), runs, 1)[0].initiation
    assert np.flatnonzero(region).tolist() == [4, 6, 7]


def test_what_has_no_way_to_the_target_inside_is_left_out() -> None:
    """Cells 0 and 1 are visited on the way to cell 4, cells 2 and 3 are jumped over."""
    runs = [[0, 1, 4], [0, 1, 4], [4]]
    first = bottlenecks(PacMan(maze=CORRIDOR), runs, 1)[0]
    assert first.cell == 4
    assert not first.initiation.any()


def test_events_in_a_cell_give_an_option_each_that_starts_before_them() -> None:
    taxi = Taxi()
    states = [
        'taxi 1,0 passenger R destination Y',
        'taxi 0,0 passenger R destination Y',
        'taxi 0,0 passenger aboard destination Y',
        'taxi 1,0 passenger aboard destination Y',
    ]
    run = [taxi.index(taxi.decode(text)) for text in states]
    first = bottlenecks(taxi, [run], 1)[0]
    assert (first.name, first.visits) == ('pickup at R', 2)
    starts = {taxi.encode(taxi.state_at(s)) for s in np.flatnonzero(first.initiation).tolist()}
    assert starts == {  # whatever the destination is
        f'taxi {row},0 passenger R destination {name}' for row in (0, 1) for name in 'GYB'
    }


@pytest.mark.heavy
@pytest.mark.parametrize('seed', [0, pytest.param(1, marks=pytest.mark.slow)])
def test_taxi_has_the_nine_options_of_the_paper(seed: int) -> None:
    """Section 7.3: four pickups, four dropoffs, and one to reach the centre; nobody said nine."""
    taxi, (centre, *others) = Taxi(), found('taxi', seed).options
    assert centre.name in ('go to cell 2,1', 'go to cell 2,2')
    assert len(others) == 8
    assert {option.name for option in others} == PAPERS_NINE
    for option in others:
        passengers = {taxi.state_at(s).passenger for s in np.flatnonzero(option.initiation)}
        waits = 'RGYB'.index(option.name[-1])
        assert passengers == ({waits} if option.target.event == 'pickup' else {ABOARD})
        assert option.reaches == 1.0


def test_pacman_options_run_to_their_cells_in_the_real_game() -> None:
    """Without ghosts nothing is in their way."""
    domain = PacMan(maze=CROSSING)
    found_here = find_options(domain, 0, QUICK)
    actions = ActionSet(domain, 'human', to_learned_options(domain, found_here))
    rng = generator(0, 'test')
    games = domain.games([domain.rules.start()] * 50)
    target = np.array([option.target.cell for option in found_here.options])
    execution, came = Execution(actions, AnyOption(rng), 50), set[int]()
    for _ in range(10):
        steps = games.step(execution.act(actions.see(games)), rng)
        runs = execution.observe(actions.see(games), steps)
        ended = runs.option < actions.first_fallback
        at = runs.game[ended]
        assert (games.batch.pacman[at] == target[runs.option[ended]]).all()
        came |= set(at.tolist())
    assert came


@pytest.mark.heavy
def test_the_cost_is_counted_and_the_same_seed_finds_the_same_options() -> None:
    told: list[tuple[str, float, int]] = []
    ticks, domain = iter([10.0, 12.5]), PacMan(maze='yard')
    extracted = find_options(domain, 3, QUICK, lambda *now: told.append(now), lambda: next(ticks))
    assert extracted.seconds == 2.5
    assert extracted.episodes == 60 * 60 + 100 * len(extracted.options)
    assert extracted.game_steps >= extracted.episodes
    assert [stage for stage, done, _ in told if done == 1.0] == ['tasks', 'policies']
    assert [steps for _, _, steps in told] == sorted(steps for _, _, steps in told)
    again, other = (search('pacman', seed) for seed in (3, 4))
    assert [o.name for o in extracted.options] == [o.name for o in again.options]
    assert (extracted.visits == again.visits).all()
    assert (extracted.visits != other.visits).any()
    for stage in ('tasks', 'policies'):

        def cancel(now: str, done: float, steps: int, stage: str = stage) -> None:
            if now == stage:
                raise PlanCanceled

        with pytest.raises(PlanCanceled):
            find_options(domain, 0, QUICK, cancel)


def test_a_task_leads_to_another_state_and_a_one_way_world_has_none() -> None:
    tasks = draw_tasks(search_space(Rooms()), 50, generator(0, 'test'))
    goal = tasks.target.argmax(axis=1)
    assert (tasks.target.sum(axis=1) == 1).all()
    assert (goal != tasks.starts).all()
    assert not Rooms().over()[goal].any()
    space = search_space(PacMan(maze=CORRIDOR))
    step = np.minimum(np.arange(1, 6), 4).astype(np.int32)[:, None, None]
    one = np.ones(step.shape)
    rules = Transitions(step, one, one, one < 0)
    with pytest.raises(PlanError, match='no two states'):
        draw_tasks(replace(space, transitions=rules), 3, generator(0, 'test'))


def test_what_cannot_be_found_is_refused_with_what_to_do() -> None:
    hardly = replace(QUICK, tasks=1, train_episodes=1, max_steps=3)
    with pytest.raises(PlanError, match=r'not one of 1 tasks .* in 1 episodes each: give more'):
        find_options(Taxi(), 0, hardly)
    with pytest.raises(PlanError, match='endless cannot all be listed'):
        find_options(SimpleNamespace(name='endless'), 0)  # type: ignore[arg-type]
    for wrong in ({'tasks': 0}, {'explore': 2.0}):
        with pytest.raises(PlanError, match=f'{next(iter(wrong))} is'):
            Extraction(**wrong)  # type: ignore[arg-type]
    seen = found('rooms')
    with pytest.raises(PlanError, match="must begin with 'automatic:', not 'automatic-1'"):
        to_learned_options(Rooms(), seen, 'automatic-1')
    dark = replace(seen, space=replace(seen.space, rows=np.zeros_like(seen.space.rows)))
    with pytest.raises(DomainError, match='of rooms do not determine'):
        to_learned_options(Rooms(), dark)


@pytest.mark.heavy
@pytest.mark.parametrize('name', ['taxi', 'rooms', 'gymnasium:CliffWalking-v1'])
def test_trees_say_what_the_tables_say_wherever_an_episode_goes_on(name: str) -> None:
    """With no feature that they can do without, and in a file without demonstrations."""
    domain, space = domain_of(name), found(name).space
    going = space.reached & ~space.over
    for option, learned in zip(found(name).options, options(name), strict=True):
        said = tabulate(learned, domain)
        assert (said.initiation == option.initiation)[going].all()
        assert (said.termination == option.termination)[going].all()
        assert (said.action == option.action)[option.initiation].all()
        assert learned.max_steps == option.max_steps
        assert option.termination[option.target.target].all()
        assert (option.termination == ~option.initiation).all()
        assert option_from_json(option_to_json(learned)) == (learned, [])
        assert learned.participant == 'automatic:1'
        assert 'blocked_moves' not in learned.features
        assert name != 'rooms' or learned.features == ('row', 'col')


@pytest.mark.heavy
def test_sets_choose_between_what_people_taught_and_what_was_found() -> None:
    auto, other = options('rooms')[:2]
    taught = replace(auto, name='out', participant='automatic-1')
    second = replace(other, participant='automatic:2')
    both = [taught, auto, other]
    assert select_options(both, 'human') == [taught]
    assert select_options(both, 'automatic') == [auto, other]
    assert select_options(both, 'automatic+primitive', names=[other.name]) == [other]
    assert select_options([*both, second], 'automatic', 'automatic:2') == [second]
    with pytest.raises(PlanError, match='name one of automatic:1, automatic:2'):
        select_options([*both, second], 'automatic')
    with pytest.raises(NoOptionsError, match='extract them first'):
        make_plan(Rooms(), select_options([taught], 'automatic'), PlanRequest('automatic'))
