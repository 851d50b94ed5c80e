"""Start states of demonstrations in a world that can only be reset and stepped."""

from collections.abc import Sequence
from dataclasses import replace

from graph_support.scripted import show
from humanopts_env.domains.base import Action, action_index, Feature
from humanopts_env.domains.replayed_domain import History, ReplayedDomain, World
from humanopts_learner.demonstrations import Demonstration, Kind
from humanopts_learner.options.checks import next_check
from humanopts_learner.options.judge import (
    FEWEST,
    judge,
    more_needed,
    taught_before,
    Thresholds,
)
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.options.starts import (
    choose_start_state,
    nothing_fails,
    sample_failures,
    sort_stuck,
)
from humanopts_learner.planning.plan import make_plan
from humanopts_learner.planning.request import HUMAN, PlanRequest, REPLAYED_STEPS
from humanopts_learner.planning.sampled_plan import SampledPlan
from humanopts_learner.planning.stuck import Trial, TRIALS, try_plan
from humanopts_learner.summary import (
    Criterion,
    INITIATION,
    RETURN,
    SAMPLED_STARTS,
    SUCCESS,
    TERMINATION,
)
import numpy as np
import pytest

LENGTH, KEY = 12, 5  # number of cells of a corridor, and the cell of the key
WEST, EAST, TAKE = range(3)
WAYS = ('west', 'east', 'here')


class KeyWorld:
    """A corridor with a key; with the key, the task is over at its east end."""

    def reset(self, seed: int) -> None:
        self.cell, self.key = int(np.random.default_rng(seed).integers(LENGTH - 1)), False

    def step(self, action: int) -> tuple[float, bool]:
        if action == TAKE:
            self.key |= self.cell == KEY
        else:
            self.cell = min(max(self.cell + 2 * action - 1, 0), LENGTH - 1)
        return -1.0, self.key and self.cell == LENGTH - 1

    def features(self) -> Sequence[float]:
        way = 2 if self.cell == KEY else int(self.cell < KEY)
        return [self.cell, way, self.key]


class Keys(ReplayedDomain):
    name, gamma, max_steps = 'keys', 0.9, 60
    parameters: dict[str, int] = {}
    features = (
        Feature.number('cell', 'which cell it is', LENGTH),
        Feature.nominal('key_way', 'which way the key is', WAYS),
        Feature.nominal('key', 'whether it has the key', ('no', 'yes')),
    )
    actions = tuple(Action(name, name[0], name) for name in ('west', 'east', 'take'))

    def make_world(self) -> World:
        return KeyWorld()


KEYS = Keys()
FETCH, LEAVE = 'fetch the key', 'leave'
CHOSEN = ('key_way', 'key')


def wanted(name: str, state: History) -> int | None:
    """Return the action of a person who shows an option; None: the option cannot start."""
    _, way, key = state.features
    if name == LEAVE:
        return EAST if key else None
    return None if key else (WEST, EAST, TAKE)[int(way)]


def shown(name: str, number: int, start: History) -> Demonstration:
    """Return a demonstration, or "not here"."""
    states, actions = [start], []
    while (action := wanted(name, states[-1])) is not None and not states[-1].over:
        states.append(KEYS.step(states[-1], action, np.random.default_rng(0)).state)
        actions.append(KEYS.actions[action].name)
    return Demonstration(
        Kind.TRAJECTORY if actions else Kind.NOT_HERE,
        f'{name}{number}',
        KEYS.name,
        '{}',
        'ann',
        'one',
        option_name=name,
        number=number,
        chosen_features=CHOSEN,
        feature_names=tuple(feature.name for feature in KEYS.features),
        features=tuple(state.features for state in states),
        states=tuple(map(KEYS.encode, states)),
        actions=tuple(actions),
        rewards=(-1.0,) * len(actions),
        terminated=states[-1].over,
    )


def begins_in(cell: int) -> History:
    """Return a start of the task in a cell."""
    return next(
        s
        for seed in range(999)
        if (s := KEYS.decode(f'seed {seed} actions -')).features[0] == cell
    )


def taught(name: str, *starts: History) -> tuple[LearnedOption, list[Demonstration]]:
    demos = [shown(name, number, start) for number, start in enumerate(starts, start=1)]
    return learn_option(demos, KEYS, 0), demos


FETCHING, _ = taught(FETCH, begins_in(0), begins_in(9))


def test_the_run_of_a_question_is_repeated_by_replay() -> None:
    """The key was fetched from cells near it alone."""
    option, demos = taught(FETCH, begins_in(6), begins_in(7))
    check = next_check(option, KEYS, demos, np.random.default_rng(0))
    assert check is not None
    assert check.features[0][0] not in (6, 7)
    states, rng = [KEYS.decode(text) for text in check.states], np.random.default_rng(0)
    assert check.features == tuple(tuple(state.features) for state in states)
    for before, action, reward, after in zip(states, check.actions, check.rewards, states[1:]):
        outcome = KEYS.step(before, action_index(KEYS, action), rng)
        assert (outcome.state, outcome.reward) == (after, reward)
    assert check.terminated == states[-1].over


@pytest.mark.parametrize('strategy', ['random', 'coverage', 'failures'])
def test_other_options_lead_to_the_start_of_a_new_one(strategy: str) -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        state = choose_start_state(strategy, KEYS, None, [], rng, others=[FETCHING])
        assert state.features == (KEY, 2, 1)
        assert wanted(LEAVE, state) == EAST


def test_without_other_options_a_lesson_begins_at_the_start_of_the_task() -> None:
    state = choose_start_state('failures', KEYS, None, [], np.random.default_rng(1))
    assert state.actions == ()


def test_after_a_refusal_the_next_state_looks_different() -> None:
    """The person says "not here" once, and is then asked elsewhere."""
    refused = shown(LEAVE, 1, begins_in(3))
    assert refused.kind is Kind.NOT_HERE
    for seed in range(5):
        rng = np.random.default_rng(seed)
        state = choose_start_state('failures', KEYS, None, [refused], rng, others=[FETCHING])
        assert state.features[2] == 1


def test_a_lesson_continues_where_the_option_gets_stuck() -> None:
    """It was shown only east of the key, so from the west it walks to the end and stays there."""
    option, demos = taught(FETCH, begins_in(9))
    state = choose_start_state('failures', KEYS, option, demos, np.random.default_rng(0))
    start = KEYS.decode(f'seed {state.seed} actions -')
    assert start.features[0] < KEY
    assert state.features == (0, 1, 0)
    assert set(state.actions) == {WEST}


def test_few_demonstrations_teach_both_options() -> None:
    options: list[LearnedOption] = []
    for name in (FETCH, LEAVE):
        option, demos, rng = None, [], np.random.default_rng(3)
        while option is None or not nothing_fails(option, KEYS, demos, rng, options):
            state = choose_start_state('failures', KEYS, option, demos, rng, others=options)
            demos.append(shown(name, len(demos) + 1, state))
            if any(demo.actions for demo in demos):
                option = learn_option(demos, KEYS, 0)
        assert len(demos) <= 4
        assert not sample_failures(option, KEYS, demos, rng, others=options).stuck.any()
        options.append(option)


def test_an_option_that_always_ended_with_the_task_over_has_no_other_end() -> None:
    ends = [shown(FETCH, 1, begins_in(cell)) for cell in (2, 4, 9)]
    option, demos = taught(LEAVE, *(KEYS.decode(demo.states[-1]) for demo in ends))
    assert all(demo.terminated for demo in demos)
    rows = np.array([[cell, way, key] for cell in range(12) for way in range(3) for key in (0, 1)])
    assert not option.ends(rows.astype(float)).any()
    assert option.can_start(rows.astype(float)).all()
    before = taught_before(LEAVE, [*ends, *demos], KEYS, 0)
    found = judge(demos, KEYS, Thresholds(), 0, others=before)
    criteria = {each.name: each for each in found.criteria}
    for name in (INITIATION, TERMINATION):  # neither could be wrong
        assert (criteria[name].value, bool(criteria[name].obstacle)) == (None, True)
    assert [option.name for option in before] == [FETCH]
    assert (found.evidence, criteria[SUCCESS].threshold) == (SAMPLED_STARTS, 0.95)
    alone = judge(demos, KEYS, Thresholds(), 0)  # without the other option, nobody has the key
    assert alone.criteria[0].value == 0.0
    assert criteria[SUCCESS].value is not None
    assert criteria[SUCCESS].value > 0
    other = [replace(d, terminated=False, chosen_features=('cell', 'key')) for d in demos]
    assert learn_option(other, KEYS, 0).ends(rows.astype(float)).any()


def test_there_are_few_runs_until_success_alone_decides() -> None:
    missing, decides = (
        judge(taught(FETCH, *map(begins_in, cells))[1], KEYS, Thresholds(), 0)
        for cells in ((0, 9, 3), (0, 9, 3, 7))
    )
    assert [each.name for each in missing.criteria if not each.met] == [SUCCESS, RETURN]
    assert missing.criteria[0].count == FEWEST
    assert missing.criteria[0].undecided
    only_return = Criterion.of(RETURN, missing.criteria[2].value, 0.1)
    assert missing.more_needed == more_needed([only_return], 3)  # few runs say nothing about it
    assert decides.criteria_met
    assert decides.criteria[0].count > FEWEST


class TwoEndsWorld(KeyWorld):
    """A corridor in which both ends end the task, one with a reward and one with a loss."""

    def step(self, action: int) -> tuple[float, bool]:
        super().step(action)
        over = self.cell in (0, LENGTH - 1)
        return float(over) * (1 if self.cell else -1), over


class TwoEnds(Keys):
    name = 'two ends'

    def make_world(self) -> World:
        return TwoEndsWorld()


def test_an_end_of_the_task_with_a_loss_is_not_like_one_with_a_reward() -> None:
    """The chosen feature does not tell them apart."""
    domain, rng = TwoEnds(), np.random.default_rng(0)
    starts = [s for _ in range(9) if (s := domain.reset(rng)).features[0] > 0]

    def going(way: str) -> list[Demonstration]:
        fields = {'option_name': 'go', 'chosen_features': ('key',)}
        return [
            replace(show(domain, start, lambda taken, here: way, rng, **fields), number=number)
            for number, start in enumerate(starts, start=1)
        ]

    shown_ends = going('east')
    east, west = (learn_option(going(way), domain, 0) for way in ('east', 'west'))
    found = [judge(shown_ends, domain, Thresholds(), 0, option) for option in (east, west)]
    assert [summary.criteria[0].value for summary in found] == [1.0, 0.0]
    assert not sample_failures(east, domain, shown_ends, rng).stuck.any()
    failures = sample_failures(west, domain, shown_ends, rng)
    assert failures.stuck.any()
    stuck = [state for state, stuck in zip(failures.states, failures.stuck) if stuck]
    assert not any(state.over for state in stuck), 'the person shows the option from its start'


def test_the_same_seed_draws_the_same_state() -> None:
    option, demos = taught(FETCH, begins_in(9))
    drawn = [
        choose_start_state('failures', Keys(), option, demos, np.random.default_rng(4))
        for _ in range(2)
    ]
    assert drawn[0] == drawn[1]


def planned(*options: LearnedOption) -> SampledPlan:
    plan = make_plan(KEYS, options, PlanRequest(HUMAN, seed=1))
    assert isinstance(plan, SampledPlan)
    assert plan.game_steps == REPLAYED_STEPS
    return plan


def test_a_plan_shows_where_to_demonstrate_more() -> None:
    """East of the key nothing was shown: there the option walks to the end and stays."""
    fetching, shown_before = taught(FETCH, begins_in(0))
    leaving, left = taught(LEAVE, *(KEYS.decode(demo.states[-1]) for demo in shown_before))
    trial = try_plan(planned(fetching, leaving), 1)
    assert trial.games == TRIALS
    assert 10 < len(trial.states) < 40
    assert set(trial.options) == {FETCH}
    stuck = [(name, KEYS.decode(text)) for name, text in zip(trial.options, trial.states)]
    planned_with = {demo.uuid for demo in [*shown_before, *left]}
    offered = sort_stuck(KEYS, stuck, {FETCH: shown_before, LEAVE: left}, planned_with)
    assert list(offered) == [FETCH]
    assert [state.features for state in offered[FETCH]] == [(LENGTH - 1, 0, 0)] * len(stuck)
    more = [*shown_before, shown(FETCH, 2, offered[FETCH][0])]
    assert sort_stuck(KEYS, stuck, {FETCH: more, LEAVE: left}, planned_with) == {}
    plan = planned(learn_option(more, KEYS, 0), leaving)
    assert try_plan(plan, 2) == Trial(TRIALS)
    assert plan.play(3, 50).successes.all()


def test_where_no_option_can_start_the_one_with_the_nearest_start_is_shown() -> None:
    _, fetched = taught(FETCH, begins_in(0))
    _, left = taught(LEAVE, KEYS.decode(fetched[0].states[-1]))
    demos = {FETCH: fetched, LEAVE: left}
    east = begins_in(9)
    assert sort_stuck(KEYS, [('', east)], demos, ()) == {FETCH: [east]}
    demos[FETCH] = [*fetched, replace(shown(LEAVE, 2, east), option_name=FETCH)]
    assert sort_stuck(KEYS, [(FETCH, east)], demos, ()) == {LEAVE: [east]}
