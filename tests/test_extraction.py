"""Finding options without a person, on the real graph: the action extract_options of planner."""

from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus
from graph_support.live import GAME, Goal, Graph, PLANNER
from graph_support.planning import Planning, start_planning
from graph_support.scripted import taught, TAXI
from humanopts_interfaces.action import ExtractOptions
from humanopts_interfaces.msg import (
    ExtractionGoal,
    ExtractionResult,
    LearnedOption,
    PlanResult,
    PolicyResult,
)
from humanopts_interfaces.srv import ListOptions
from humanopts_learner.automatic.extract import (
    AutomaticOptions,
    find_options,
    to_learned_options,
)
from humanopts_learner.automatic.subgoals import Extraction
from humanopts_learner.options.files import option_from_json
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import PlanRequest
import pytest

SEED = 3
SMALL = {'tasks': 6, 'task_episodes': 15, 'option_episodes': 20, 'max_options': 2}
HOW = Extraction(options=2, tasks=6, train_episodes=15, option_episodes=20)
ENDLESS = {'tasks': 400, 'task_episodes': 100_000}  # takes an hour
SECONDS = 60.0


@pytest.fixture(scope='module')
def planning(shared: Graph) -> Planning:
    return start_planning(shared, episodes=1, seed=SEED)


@pytest.fixture(scope='module')
def found() -> AutomaticOptions:
    """The same by a library call."""
    return find_options(TAXI, SEED, HOW)


def begin(planning: Planning, **fields: Any) -> Goal:
    return planning.graph.act(ExtractOptions, 'extract_options', **{'seed': SEED, **fields})


def extract(planning: Planning, **fields: Any) -> ExtractionResult:
    _, result = begin(planning, **{**SMALL, **fields}).result(SECONDS)
    return result


@pytest.fixture(scope='module')
def extracted(planning: Planning) -> ExtractionResult:
    return extract(planning)


def served(planning: Planning, participant: str, names: list[str]) -> Callable[[], bool]:
    """Return whether option_server has these options of a participant."""

    def check() -> bool:
        response = planning.graph.ask(ListOptions, 'list_options')
        known = zip(response.option_names, response.participants)
        return [name for name, owner in known if owner == participant] == sorted(names)

    return check


def test_options_are_those_of_the_library_call(
    planning: Planning, extracted: ExtractionResult, found: AutomaticOptions
) -> None:
    """A subscriber that comes late gets them whole; they are served beside those of people."""
    assert (extracted.status, extracted.participant) == (extracted.STATUS_DONE, 'automatic:1')
    assert list(extracted.option_names) == [option.name for option in found.options]
    assert list(extracted.reaches) == [option.reaches for option in found.options]
    assert (extracted.game_steps, extracted.episodes) == (found.game_steps, found.episodes)
    assert extracted.solved == found.solved
    assert extracted.seconds > 0
    heard = planning.graph.listen(LearnedOption, 'automatic_options')
    expected = to_learned_options(TAXI, found)
    planning.graph.until(lambda: len(heard) == len(expected), 'the options')
    assert [option_from_json(message.model)[0] for message in heard] == expected
    planning.teach(taught())
    theirs = [option.name for option in taught()]
    planning.graph.until(served(planning, taught()[0].participant, theirs), 'those of a person')
    assert served(planning, 'automatic:1', list(extracted.option_names))()


def test_an_episode_is_played_by_a_plan_of_automatic_options(
    planning: Planning, extracted: ExtractionResult, found: AutomaticOptions
) -> None:
    plan = make_plan(TAXI, to_learned_options(TAXI, found), PlanRequest('automatic'))
    result = planning.plan('automatic')
    assert result.status == PlanResult.STATUS_CONVERGED
    assert tuple(result.option_names) == plan.names
    assert result.sweeps == plan.solution.sweeps
    planning.graph.until(
        served(planning, 'automatic:1', list(extracted.option_names)), 'the options'
    )
    played = planning.play('automatic')
    assert (played.status, played.episodes) == (PolicyResult.STATUS_DONE, 1)


def test_a_search_leaves_the_plans_of_peoples_options_as_they_are(
    planning: Planning, extracted: ExtractionResult
) -> None:
    planning.teach(taught())
    assert planning.plan('human').status == PlanResult.STATUS_CONVERGED
    assert planning.plan('automatic+primitive').status == PlanResult.STATUS_CONVERGED
    other = extract(planning, participant='automatic:2', max_options=1)
    assert other.status == ExtractionResult.STATUS_DONE
    assert planning.play('human').status == PolicyResult.STATUS_DONE
    refused = planning.play('automatic+primitive')
    assert refused.status == PolicyResult.STATUS_NO_PLAN
    assert 'the options have changed' in refused.detail
    both = planning.plan('automatic')
    assert both.status == PlanResult.STATUS_BAD_REQUEST
    assert 'name one of automatic:1, automatic:2' in both.detail
    named = planning.plan('automatic', participant='automatic:1')
    assert named.status == PlanResult.STATUS_CONVERGED


def test_a_search_tells_how_far_it_is_and_refuses_another_meanwhile(planning: Planning) -> None:
    graph = planning.graph
    goals = graph.listen(ExtractionGoal, 'extraction_goals')
    results = graph.listen(ExtractionResult, 'extraction_results')
    goal = begin(planning, **ENDLESS)
    graph.until(lambda: len(goal.feedback) > 2, 'progress')
    busy = extract(planning)
    assert (busy.status, busy.extraction_id) == (busy.STATUS_BUSY, '')
    assert 'another search' in busy.detail
    goal.cancel()
    status, result = goal.result(5.0)
    assert (status, result.status) == (GoalStatus.STATUS_CANCELED, result.STATUS_CANCELED)
    fractions = [news.progress for news in goal.feedback]
    assert fractions == sorted(fractions)
    assert 0 < fractions[-1] < 1
    assert goal.feedback[-1].game_steps > 0
    graph.until(lambda: len(results) == 2, 'both results')
    (accepted,) = goals
    assert accepted.extraction_id == result.extraction_id == results[-1].extraction_id
    assert (accepted.max_options, accepted.tasks, accepted.seed) == (25, 400, SEED)


@pytest.mark.parametrize(
    ('fields', 'says'),
    [
        ({'participant': 'automatic-1'}, "must begin with 'automatic:', not 'automatic-1'"),
        ({'tasks': 2**31}, 'ask for fewer'),
    ],
)
def test_a_request_that_makes_no_sense_is_refused_in_words(
    planning: Planning, fields: dict[str, Any], says: str
) -> None:
    result = extract(planning, **fields)
    assert result.status == ExtractionResult.STATUS_BAD_REQUEST
    assert says in result.detail


def test_who_asks_is_answered_when_the_planner_ends(live: Graph) -> None:
    live.start(GAME)
    planner = live.start(PLANNER)
    live.ready('/planner')
    goal = live.act(ExtractOptions, 'extract_options', seed=SEED, **ENDLESS)
    live.until(lambda: goal.feedback, 'progress')
    live.stop(planner)
    _, result = goal.result()
    assert (result.status, result.detail) == (result.STATUS_FAILED, 'the planner is stopping')
