"""The node option_server on the real graph: options run to their end, and it says which."""

from dataclasses import replace
from pathlib import Path
import signal
from typing import Any

from action_msgs.msg import GoalStatus
from graph_support.live import GAME, Goal, Graph, OPTION_SERVER
from graph_support.player import MACHINE, ME, PERSON, Player
from graph_support.scripted import DELIVER, expert, FETCH, taught, TAXI, walk
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.seeding import generator
from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import (
    ActionRefusal,
    OptionGoal,
    OptionResult,
)
from humanopts_interfaces.msg import (
    LearnedOption as OptionMessage,
)
from humanopts_interfaces.srv import ListOptions, QueryOption, RunOption, SetPace
from humanopts_learner.options.files import option_to_json, save_option
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.run import Run
from humanopts_ros.qos import STREAM
import pytest
from rclpy.parameter import Parameter

START = 'taxi 4,4 passenger R destination G'
ABOARD = 'taxi 4,4 passenger aboard destination G'
CIRCLE, WANDER = 'go round', 'wander'
PATIENCE = 10.0  # s that option_server waits for game


def circle() -> LearnedOption:
    """Learn a policy that goes to and fro between the two upper rows for ever."""
    ways = ['south', 'north'] * 4
    demo = walk('taxi 0,2 passenger R destination G', ways, CIRCLE, ['taxi_row'])
    again = walk(
        'taxi 1,2 passenger R destination G', ['north', 'south'] * 4, CIRCLE, ['taxi_row']
    )
    return learn_option([demo, again], TAXI, 0)


def wander() -> LearnedOption:
    """Learn a policy that is not sure what to do anywhere."""
    starts = ['taxi 0,2 passenger R destination G', 'taxi 2,2 passenger R destination G']
    ways = [['south', 'east', 'north', 'west'] * 3, ['west', 'east', 'south', 'south', 'north']]
    demos = [walk(s, w, WANDER, ['passenger_in_taxi']) for s, w in zip(starts, ways)]
    return learn_option(demos, TAXI, 0)


OPTIONS = {option.name: option for option in [*taught(), circle(), wander()]}


class Runs:
    """A game, and the option server that plays it."""

    def __init__(self, graph: Graph) -> None:
        self.graph, self.player = graph, Player(graph)
        self.results = graph.listen(OptionResult, 'option_results')
        self.goals = graph.listen(OptionGoal, 'option_goals')

    def run(self, name: str, start: str = START, **fields: Any) -> OptionResult:
        """Begin an episode and run an option in it."""
        state = self.player.fresh(start)
        fields = {'episode': state.episode, 'step': 0, **fields}
        result: OptionResult = self.graph.ask(
            RunOption, 'run_option', option_name=name, **fields
        ).result
        return result

    def begin(self, name: str, start: str = START, **fields: Any) -> Goal:
        """Begin an episode, and an option by the action; wait for the first feedback."""
        state = self.player.fresh(start)
        fields = {'episode': state.episode, 'step': 0, **fields}
        goal = self.graph.act(ExecuteOption, 'execute_option', option_name=name, **fields)
        self.graph.until(lambda: goal.feedback, 'feedback')
        return goal

    def steps(self, result: OptionResult) -> list[Any]:
        """Return the states that a run led to."""
        first, last = result.first_step, result.first_step + result.step_count

        def found() -> list[Any]:
            states = [s for s in self.player.states if s.episode == result.episode]
            return [s for s in states if first < s.step <= last]

        self.graph.until(lambda: len(found()) == result.step_count, 'the states of the run')
        return found()


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Option files: good ones, a damaged one and one of another game."""
    folder = tmp_path_factory.mktemp('options')
    for option in OPTIONS.values():
        path = save_option(folder, option, [])
    (path.parent / 'damaged.json').write_text(path.read_text()[:200])
    large = make_domain('taxi', {'rows': 7})
    save_option(folder, learn_option(expert('go to passenger', 3, large), large, 0), [])
    return folder


@pytest.fixture(scope='module')
def runs(shared: Graph, folder: Path) -> Runs:
    shared.start(GAME)
    shared.start(OPTION_SERVER, options_directory=folder, no_progress_seconds=PATIENCE, seed=3)
    shared.ready('/game', '/option_server')
    return Runs(shared)


def test_a_learned_option_runs_to_its_end_and_all_of_it_is_on_the_graph(runs: Runs) -> None:
    result = runs.run(FETCH)
    assert result.status == OptionResult.STATUS_REACHED
    assert result.detail == 'its termination condition holds'
    distance = reference_options(TAXI)[FETCH].distance[TAXI.index(TAXI.decode(START))]
    assert result.step_count == distance
    assert result.final_state == 'taxi 0,0 passenger aboard destination G'
    steps = runs.steps(result)
    rewards = [s.reward for s in steps]
    assert result.total_reward == sum(rewards)
    assert result.discounted_return == pytest.approx(
        sum(0.99**k * reward for k, reward in enumerate(rewards))
    )
    assert {s.action_source for s in steps} == {MACHINE}
    runs.graph.until(lambda: runs.results and runs.results[-1].run_id == result.run_id, 'result')
    goal = next(goal for goal in runs.goals if goal.run_id == result.run_id)
    assert (goal.via, goal.option_name, goal.max_steps) == ('run_option', FETCH, 200)
    assert runs.results[-1].step_count == result.step_count


def test_whatever_is_current_is_where_a_run_starts_that_names_no_moment(runs: Runs) -> None:
    runs.player.fresh(START)
    runs.player.do('north')
    answer = runs.graph.ask(RunOption, 'run_option', option_name='action:north').result
    assert (answer.first_step, answer.status) == (1, OptionResult.STATUS_REACHED)


def test_the_action_gives_feedback_after_every_step_or_20_times_a_second(runs: Runs) -> None:
    fast = runs.begin(CIRCLE)
    assert fast.result()[1].step_count == 200
    assert 0 < len(fast.feedback) < 100
    runs.graph.ask(SetPace, 'set_pace', step_period=0.06)
    goal = runs.begin(FETCH)
    status, result = goal.result()
    runs.graph.ask(SetPace, 'set_pace')
    assert status == GoalStatus.STATUS_SUCCEEDED
    assert result.status == OptionResult.STATUS_REACHED
    steps = runs.steps(result)
    assert [f.step_count for f in goal.feedback] == list(range(1, result.step_count + 1))
    assert [f.action for f in goal.feedback] == [s.previous_action for s in steps]
    assert [f.state for f in goal.feedback] == [s.state for s in steps]
    assert goal.feedback[-1].total_reward == result.total_reward
    assert [f.termination >= 0.5 for f in goal.feedback] == [False] * (len(steps) - 1) + [True]


def test_a_run_is_canceled_and_its_result_is_where_the_game_is(runs: Runs) -> None:
    goal = runs.begin(CIRCLE)
    goal.cancel()
    status, result = goal.result()
    assert status == GoalStatus.STATUS_CANCELED
    assert result.status == OptionResult.STATUS_CANCELED
    assert 0 < result.step_count < 200
    runs.steps(result)
    answer = runs.player.do('north', step=result.step_count)
    assert answer.step == result.step_count + 1
    assert runs.player.states[-2].state == result.final_state


def test_a_cancel_before_the_first_state_keeps_every_action_from_the_game(runs: Runs) -> None:
    coming = runs.player.fresh(START).episode + 1
    goal = runs.graph.act(ExecuteOption, 'execute_option', option_name=CIRCLE, episode=coming)
    goal.cancel()
    runs.player.reset(START)
    status, result = goal.result()
    assert status == GoalStatus.STATUS_CANCELED
    assert (result.status, result.step_count) == (OptionResult.STATUS_CANCELED, 0)
    assert runs.run(FETCH).first_step == 0  # so it came later than an action would have
    assert [s.step for s in runs.player.states if s.episode == coming] == [0]


def test_what_cannot_run_is_refused_in_words(runs: Runs) -> None:
    result = runs.run('fly')
    assert result.status == OptionResult.STATUS_UNKNOWN_OPTION
    assert FETCH in result.detail
    over = runs.run(DELIVER, 'taxi 0,4 passenger aboard destination G')
    assert (over.status, over.terminated) == (OptionResult.STATUS_REACHED, True)
    refused = runs.graph.ask(RunOption, 'run_option', option_name=FETCH).result
    assert refused.status == OptionResult.STATUS_NO_EPISODE
    assert 'the episode has ended' in refused.detail
    with runs.graph.hurried():
        never = runs.run(FETCH, episode=9999)
    assert never.status == OptionResult.STATUS_NO_EPISODE
    assert 'episode 9999 step 0 did not arrive; the game is at' in never.detail


def test_a_person_takes_over_a_running_option(live: Graph, folder: Path) -> None:
    live.start(GAME, step_period=0.5)  # the next command of the machine waits for it
    live.start(OPTION_SERVER, options_directory=folder)
    live.ready('/game', '/option_server')
    runs = Runs(live)
    goal = runs.begin(CIRCLE)
    assert runs.goals[-1].run_id == goal.goal_id
    moved = runs.player.do('east', PERSON)
    status, result = goal.result()
    assert status == GoalStatus.STATUS_ABORTED
    assert result.status == OptionResult.STATUS_INTERRUPTED
    assert f'{ME} took east' in result.detail
    refusals = runs.player.refusals
    live.until(lambda: refusals, "the machine's refusal")
    assert refusals[-1].command_episode == moved.episode
    assert refusals[-1].reason == ActionRefusal.REASON_HELD_BY_PERSON
    assert (moved.previous_action, moved.action_source) == ('east', PERSON)
    assert moved.step == result.step_count + 1
    assert runs.player.state == moved

    again = live.ask(RunOption, 'run_option', option_name='action:north').result
    assert again.status == OptionResult.STATUS_INTERRUPTED
    assert 'held by the person' in again.detail
    runs.player.hold(False)
    driven = live.ask(RunOption, 'run_option', option_name='action:north').result
    assert driven.status == OptionResult.STATUS_REACHED


def test_a_run_waits_for_a_person_takes_single_steps_and_goes_on_when_the_person_is_gone(
    live: Graph, folder: Path
) -> None:
    live.start(GAME)
    live.start(OPTION_SERVER, options_directory=folder, no_progress_seconds=0.3)
    live.ready('/game', '/option_server')
    runs = Runs(live)
    for status, fields in (
        (SetPace.Response.STATUS_BAD_PERIOD, {'step_period': 61.0, 'holder_id': '/person#2'}),
        (SetPace.Response.STATUS_NOT_HOLDER, {'holder_id': '/nobody#1'}),
        (SetPace.Response.STATUS_OK, {'steps': 2, 'holder_id': '/person#2'}),
    ):
        assert live.ask(SetPace, 'set_pace', paused=True, **fields).status == status
    goal = runs.begin(FETCH)
    live.until(lambda: runs.player.state.step == 2, 'the two steps')
    ended = live.node.get_clock().now()
    live.until(lambda: not runs.player.controls[-1].paused_by, 'the end of the pause')
    waited = live.node.get_clock().now() - ended  # the terminal is silent for that long
    assert waited.nanoseconds > 0.3e9
    result = goal.result()[1]
    third = next(s for s in runs.steps(result) if s.step == 3)
    stamp = runs.player.controls[-1].header.stamp
    assert (third.header.stamp.sec, third.header.stamp.nanosec) >= (stamp.sec, stamp.nanosec)
    assert result.status == OptionResult.STATUS_REACHED

    live.ask(SetPace, 'set_pace', paused=True, steps=1, holder_id='/person#2')
    goal = runs.begin(FETCH)
    runs.player.hold(True)  # also while it waits
    result = goal.result()[1]
    assert result.status == OptionResult.STATUS_INTERRUPTED
    assert 'control is held by the person' in result.detail
    assert runs.player.state.step == 1


def test_a_reset_interrupts_a_run(runs: Runs) -> None:
    goal = runs.begin(CIRCLE)
    runs.player.reset(START)
    _, result = goal.result()
    assert result.status == OptionResult.STATUS_INTERRUPTED
    assert 'the game was reset' in result.detail
    assert runs.run(FETCH).status == OptionResult.STATUS_REACHED


def test_a_game_that_says_nothing_ends_the_run_and_later_ones_work(runs: Runs) -> None:
    server = runs.graph.node_called('/option_server')
    server.set_parameters([Parameter('no_progress_seconds', value=7.0)])
    goal = runs.begin(CIRCLE)
    with runs.graph.silent('/game'), runs.graph.hurried():
        _, result = goal.result()
    server.set_parameters([Parameter('no_progress_seconds', value=PATIENCE)])
    assert result.status == OptionResult.STATUS_NO_PROGRESS
    assert 'deadline: 7 s' in result.detail
    assert runs.run(FETCH).status == OptionResult.STATUS_REACHED


def test_a_query_answers_with_the_numbers_of_the_option(runs: Runs) -> None:
    for name, text in ((FETCH, START), (WANDER, ABOARD)):
        answer = runs.graph.ask(QueryOption, 'query_option', option_name=name, state=text)
        option, row = OPTIONS[name], TAXI.feature_values(TAXI.decode(text))[None]
        assert answer.status == QueryOption.Response.STATUS_OK
        assert answer.can_start == option.can_start(row)[0]
        assert answer.initiation == option.initiation_probability(row)[0]
        assert answer.termination == option.termination_probability(row)[0]
        assert answer.actions == [action.name for action in TAXI.actions]
        assert answer.action_probabilities.tolist() == option.action_probabilities(row)[0].tolist()
        assert answer.action == TAXI.actions[option.action(row)[0]].name
    for name, text, status, says in (
        ('fly', START, QueryOption.Response.STATUS_UNKNOWN_OPTION, FETCH),
        (FETCH, 'nowhere', QueryOption.Response.STATUS_BAD_STATE, "'nowhere'"),
    ):
        answer = runs.graph.ask(QueryOption, 'query_option', option_name=name, state=text)
        assert (answer.status, says in answer.detail) == (status, True)


def test_the_list_is_what_can_be_run(runs: Runs) -> None:
    listed = runs.graph.ask(ListOptions, 'list_options')
    assert listed.option_names == sorted(OPTIONS)
    assert set(listed.participants) == {'p1'}
    assert listed.n_demonstrations.tolist() == [
        OPTIONS[name].n_demonstrations for name in sorted(OPTIONS)
    ]
    assert listed.primitive_actions == [f'action:{action.name}' for action in TAXI.actions]
    assert listed.status == listed.STATUS_OK
    unknown = runs.graph.ask(ListOptions, 'list_options', participant='p2')
    assert (unknown.status, unknown.option_names) == (unknown.STATUS_UNKNOWN_PARTICIPANT, [])
    assert "'p2' taught no option" in unknown.detail


def sampling(live: Graph, folder: Path, step_period: float = 0.0) -> Any:
    """Start a game, and an option server that draws what it does; return this."""
    live.start(GAME, step_period=step_period)
    server = live.start(OPTION_SERVER, options_directory=folder, mode='sampled', seed=5)
    live.ready('/game', '/option_server')
    return server


def test_files_are_served_until_the_learner_publishes_and_what_cannot_be_is_named(
    live: Graph, folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    sampling(live, folder)
    said = capfd.readouterr().err
    (damaged,) = folder.glob('*/damaged.json')
    assert f'{damaged} cannot be used: it is not JSON' in said
    assert "not served: 'go to passenger' was learned in taxi" in said
    assert len(damaged.read_text()) == 200

    def names() -> list[str]:
        return list(live.ask(ListOptions, 'list_options').option_names)

    assert names() == sorted(OPTIONS)
    publisher = live.node.create_publisher(OptionMessage, 'learned_options', STREAM)
    live.until(lambda: publisher.get_subscription_count() > 0, 'its reader')
    for name, model in ((FETCH, option_to_json(OPTIONS[FETCH])), ('spoilt', '{}')):
        message = OptionMessage(name=name, participant='p1', model=model, n_options=2)
        message.publisher_id = '/learner#1'
        publisher.publish(message)
    live.until(lambda: names() == [FETCH], 'the option to be served')
    assert "learned_options from /learner#1: 'spoilt': " in capfd.readouterr().err


def test_a_run_waits_for_the_options_that_it_names_and_uses_them(live: Graph) -> None:
    live.start(GAME)
    live.start(OPTION_SERVER)
    live.ready('/game', '/option_server')
    runs = Runs(live)
    publisher = live.node.create_publisher(OptionMessage, 'learned_options', STREAM)
    live.until(publisher.get_subscription_count, 'its reader')

    def publish(sequence: int, max_steps: int) -> None:
        model = option_to_json(replace(OPTIONS[CIRCLE], max_steps=max_steps))
        fields = {'name': CIRCLE, 'participant': 'p1', 'model': model, 'n_options': 1}
        publisher.publish(OptionMessage(publisher_id='/learner#1', sequence=sequence, **fields))

    publish(1, 2)
    live.until(lambda: live.ask(ListOptions, 'list_options').option_names, 'the option')
    assert runs.run(CIRCLE, options_sequence=1).step_count == 2
    request = live.request(RunOption, 'run_option', option_name=CIRCLE, options_sequence=2)
    busy = live.ask(RunOption, 'run_option', option_name=CIRCLE).result
    assert busy.status == OptionResult.STATUS_BUSY
    publish(2, 3)
    live.until(request.done, 'the end of the run')
    assert request.result().result.step_count == 3


@pytest.mark.parametrize('begun', [True, False])
def test_an_option_server_that_is_ended_answers_who_waits(
    live: Graph, folder: Path, begun: bool
) -> None:
    """For the end of a run, or for the state that it is to begin in."""
    server = sampling(live, folder, step_period=0.1)  # a run that is drawn may be short
    if begun:
        goal = Runs(live).begin(CIRCLE)
    else:
        goal = live.act(ExecuteOption, 'execute_option', option_name='action:south', episode=99)
        second = live.ask(RunOption, 'run_option', option_name='action:south').result
        assert second.status == OptionResult.STATUS_BUSY
    live.stop(server)
    status, result = goal.result()
    assert status == GoalStatus.STATUS_ABORTED
    assert result.status == OptionResult.STATUS_FAILED
    assert result.detail == 'it failed: option_server is stopping'


def test_the_sampled_mode_is_a_function_of_the_seed_and_the_moment(
    live: Graph, folder: Path
) -> None:
    sampling(live, folder)
    runs, taken = Runs(live), []
    for fields in ({}, {'episode': 0}):
        steps = runs.steps(runs.run(WANDER, **fields))
        expected = sampled(5, steps[0].episode)
        assert [s.previous_action for s in steps] == expected != sampled(6, steps[0].episode)
        taken.append(expected)
    assert taken[0] != taken[1]
    text = live.refused(OPTION_SERVER, mode='lazy')
    assert text == "parameter mode: 'lazy' is not one of greedy, sampled"


def sampled(seed: int, episode: int) -> list[str]:
    """Return the actions that the option draws in an episode that begins at START."""
    state, rng = TAXI.decode(START), generator(seed, 'run', WANDER, episode, 0)
    run = Run(OPTIONS[WANDER], TAXI, state, (episode, 0), rng=rng)
    actions: list[str] = []
    end = None
    while end is None:
        action = run.next_action()
        actions.append(TAXI.actions[action].name)
        outcome = TAXI.step(state, action, rng)
        state = outcome.state
        truncated = not outcome.terminated and len(actions) == TAXI.max_steps
        end = run.observe(state, outcome.reward, outcome.terminated, truncated)
    return actions


def test_a_process_runs_rejects_preempts_cancels_and_ends_what_is_under_way(
    live: Graph, folder: Path
) -> None:
    """It has another executor than the nodes of the test's own process."""
    live.spawn(GAME)
    server = live.spawn(OPTION_SERVER, options_directory=folder)
    live.ready('/game', '/option_server')
    runs = Runs(live)
    assert runs.run(FETCH).status == OptionResult.STATUS_REACHED
    assert live.ask(ListOptions, 'list_options').option_names == sorted(OPTIONS)
    assert not live.accepts(ExecuteOption, 'execute_option', option_name='fly')
    live.ask(SetPace, 'set_pace', step_period=0.06)
    goal = runs.begin(CIRCLE)
    assert not live.accepts(ExecuteOption, 'execute_option', option_name=FETCH)
    asked = {'option_name': WANDER, 'preempt': True}
    preempting = live.act(ExecuteOption, 'execute_option', **asked)
    assert goal.result()[1].status == OptionResult.STATUS_INTERRUPTED
    live.until(lambda: preempting.feedback, 'feedback')
    preempting.cancel()
    assert preempting.result()[0] == GoalStatus.STATUS_CANCELED
    goal = runs.begin(CIRCLE)
    request = live.request(RunOption, 'run_option', **asked)
    assert goal.result()[1].status == OptionResult.STATUS_INTERRUPTED
    assert server.kill(signal.SIGTERM) == 0
    live.until(request.done, 'an answer')
    result = request.result().result
    assert (result.status, result.detail) == (
        OptionResult.STATUS_FAILED,
        'it failed: option_server is stopping',
    )
