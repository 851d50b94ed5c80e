"""A robot in lock-step, without ROS: actions that take time, stops, faults, control and locks."""

from dataclasses import replace

from humanopts_env.domains.base import Action, DomainError, Feature
from humanopts_env.domains.described import DescribedDomain
from humanopts_env.game import (
    Begun,
    Command,
    Control,
    ControlStatus,
    Holder,
    Pacing,
    Reason,
    Refused,
    ResetStatus,
    Source,
    Transition,
)
from humanopts_env.worlds.acted_game import ActedGame
from humanopts_env.worlds.sensors import Sensed
from humanopts_env.worlds.world import Ending, Timing
import pytest

ANNA, BEN, SERVER, PLANNER = '/anna#1', '/ben#2', '/option_server#3', '/planner#4'
TIMINGS = {
    'forward': Timing(0.2),
    'go': Timing(60.0, timed=False),
    'close': Timing(3.0, settle=0.5, timed=False),
    'beep': Timing(0.0),
}
DOMAIN = DescribedDomain(
    'rover',
    {},
    [
        Feature.continuous('x', 'where it is', 0, 10, 'm'),
        Feature.nominal('door', 'whether the door is open', ['closed', 'open']),
    ],
    [Action(name, name[0], name, t.seconds + t.settle) for name, t in TIMINGS.items()],
    0.99,
    0,
)
KEY = Command(ANNA, 5, Source.PERSON, 0, 0, 'forward')
STOP = replace(KEY, action='')
MACHINE = Command(SERVER, 8, Source.MACHINE, 1, 0, 'forward')


class Rover:
    """A robot on a line, driven by the test; it records what it is asked."""

    def __init__(self) -> None:
        self.x, self.door, self.fault, self.reward = 1.0, 0.0, '', -1.0
        self.outside = ''  # what is out of its range
        self.doing: list[str] = []
        self.shown: list[Transition] = []

    def start(self, action: str) -> None:
        if action == 'close' and self.door:
            raise DomainError('the gripper is not there')
        self.doing.append(action)

    def halt(self) -> None:
        self.doing.append('halt')

    def sense(self) -> Sensed:
        if self.fault:
            raise DomainError(self.fault)
        return Sensed((self.x, self.door), self.outside)

    def text(self, features: tuple[float, ...]) -> str:
        return f'x {features[0]:g}'

    def ending(self, before: tuple[float, ...], action: str, after: tuple[float, ...]) -> Ending:
        return Ending(self.reward, after[0] >= 9, after[0] < 0.5)

    def show(self, transition: Transition) -> None:
        self.shown.append(transition)


class World:
    """The game, its robot and its clock."""

    def __init__(self, *, supervised: bool = True, domain: DescribedDomain = DOMAIN) -> None:
        self.now, self.rover = 100.0, Rover()
        self.game = ActedGame(
            domain, self.rover, lambda: self.now, TIMINGS, step=0.2, supervised=supervised
        )
        assert self.game.reset('', 0, Source.MACHINE).status is ResetStatus.OK

    def after(self, seconds: float) -> list[Transition]:
        """Let time pass; return the states shown meanwhile."""
        known = len(self.rover.shown)
        self.now += seconds
        self.game.tick()
        return self.rover.shown[known:]

    def enable(self) -> None:
        """Let Anna enable the machine."""
        self.game.set_control(True, ANNA)
        self.game.set_control(False, ANNA)


@pytest.fixture
def world() -> World:
    return World()


def reason_of(result: object) -> Reason:
    assert isinstance(result, Refused), result
    return result.reason


def test_an_action_ends_after_its_time_and_its_state_is_sensed_then(world: World) -> None:
    begun = world.game.command(KEY)
    assert isinstance(begun, Begun)
    assert begun.control == Control(Holder.PERSON, ANNA, 'a person pressed a key')
    assert world.rover.doing[-1] == 'forward'
    world.rover.x = 1.05
    assert world.after(0.1) == []
    world.rover.x = 1.06
    (state,) = world.after(0.1)
    assert state == Transition(
        1, 1, 'x 1.06', (1.06, 0.0), 'forward', Source.PERSON, ANNA, 5, reward=-1.0
    )
    assert (world.rover.doing[-1], world.game.under_way) == ('halt', None)


def test_an_action_with_an_end_of_its_own_ends_when_it_reports_it(world: World) -> None:
    world.game.command(replace(KEY, action='go'))
    world.after(20.0)
    world.game.finish()
    (state,) = world.rover.shown
    assert (state.previous_action, state.cut_short) == ('go', False)
    world.game.finish()  # reported twice
    assert len(world.rover.shown) == 1


def test_at_its_deadline_it_is_cut_short(world: World) -> None:
    world.game.command(replace(KEY, action='go'))
    assert world.after(59.9) == []
    (state,) = world.after(0.1)
    assert (state.previous_action, state.cut_short) == ('go', True)
    assert world.rover.doing[-1] == 'halt'


def test_an_action_that_fails_is_cut_short(world: World) -> None:
    world.game.command(replace(KEY, action='go'))
    world.game.finish(cut_short=True)
    assert world.rover.shown[-1].cut_short


def test_the_effect_is_sensed_when_the_robot_has_settled(world: World) -> None:
    world.game.command(replace(KEY, action='close'))
    world.game.finish()
    assert world.after(0.4) == []
    world.rover.door = 1.0
    (state,) = world.after(0.1)
    assert (state.features, state.cut_short) == ((1.0, 1.0), False)


def test_a_stop_while_it_settles_cuts_nothing_short(world: World) -> None:
    world.game.command(replace(KEY, action='close'))
    world.game.finish()
    world.game.stop(STOP)
    assert not world.rover.shown[-1].cut_short


def test_an_action_without_duration_ends_with_the_next_tick(world: World) -> None:
    world.game.command(replace(KEY, action='beep'))
    (state,) = world.after(0.0)
    assert state.previous_action == 'beep'


def test_another_key_ends_the_action_early_and_begins_its_own(world: World) -> None:
    world.game.command(KEY)
    world.now += 0.1
    result = world.game.command(replace(KEY, sequence=6, action='go'))
    assert isinstance(result, Begun)
    assert result.control is None
    (state,) = world.rover.shown
    assert (state.previous_action, state.action_sequence, state.cut_short) == ('forward', 5, True)
    assert world.rover.doing[-3:] == ['forward', 'halt', 'go']


def test_a_wrong_key_does_not_end_it(world: World) -> None:
    world.game.command(KEY)
    assert reason_of(world.game.command(replace(KEY, action='fly'))) is Reason.NO_SUCH_ACTION
    assert world.game.under_way is not None


def test_a_key_is_refused_if_the_early_end_was_that_of_the_task(world: World) -> None:
    world.game.command(KEY)
    world.rover.x = 9.5
    assert reason_of(world.game.command(KEY)) is Reason.EPISODE_OVER
    assert world.rover.shown[-1].terminated


def test_an_action_that_cannot_begin_is_refused_and_the_robot_stands(world: World) -> None:
    world.rover.door = 1.0
    refused = world.game.command(replace(KEY, action='close'))
    assert reason_of(refused) is Reason.FAILED
    assert isinstance(refused, Refused)
    assert refused.detail == 'the gripper is not there'
    assert (world.rover.doing[-1], world.game.under_way) == ('halt', None)


# Control


def test_nothing_moves_before_a_person_has_enabled_it(world: World) -> None:
    assert world.game.control.holder is Holder.LOCKED
    refused = world.game.command(MACHINE)
    assert reason_of(refused) is Reason.LOCKED
    assert 'forward' not in world.rover.doing
    assert world.game.set_control(False, ANNA).detail == 'nothing changed'
    world.enable()
    assert world.game.control == Control(
        Holder.NOBODY, '', 'the person gave control back', supervisor_id=ANNA
    )
    assert isinstance(world.game.command(MACHINE), Begun)


def test_a_world_without_supervision_moves_at_once() -> None:
    world = World(supervised=False)
    assert isinstance(world.game.command(MACHINE), Begun)
    world.game.command(KEY)
    world.game.release('gone')
    assert world.game.control == Control(Holder.NOBODY, '', 'gone')
    assert world.rover.shown[-1].cut_short


@pytest.mark.parametrize('holds', [True, False])
def test_who_holds_or_supervises_and_leaves_locks_it(holds: bool, world: World) -> None:
    world.enable()
    world.game.command(KEY if holds else MACHINE)
    world.game.release('/anna#1 has ended')
    assert world.game.control == Control(Holder.LOCKED, '', '/anna#1 has ended')
    assert world.rover.shown[-1].cut_short
    assert world.rover.doing[-1] == 'halt'
    assert reason_of(world.game.command(replace(MACHINE, step=1))) is Reason.LOCKED
    assert isinstance(world.game.command(KEY), Begun)


def test_who_takes_control_stops_the_machine(world: World) -> None:
    world.enable()
    world.game.command(MACHINE)
    assert world.game.set_control(True, BEN).status is ControlStatus.OK
    state = world.rover.shown[-1]
    assert (state.action_publisher_id, state.cut_short) == (SERVER, True)
    assert reason_of(world.game.command(replace(MACHINE, step=1))) is Reason.HELD_BY_PERSON
    world.game.set_control(False, BEN)
    assert world.game.control.supervisor_id == BEN


def test_who_cannot_take_control_stops_nothing(world: World) -> None:
    world.game.command(KEY)
    assert world.game.set_control(True, BEN).status is ControlStatus.NOT_HOLDER
    assert world.game.under_way is not None


# Machines


def test_while_an_action_lasts_other_machines_are_late(world: World) -> None:
    world.enable()
    world.game.command(MACHINE)
    refused = world.game.command(replace(MACHINE, publisher_id=PLANNER))
    assert reason_of(refused) is Reason.STALE
    assert isinstance(refused, Refused)
    assert refused.detail == "step 0 is answered: 'forward' is under way"
    assert len(world.after(0.2)) == 1


def test_a_delayed_command_of_a_machine_waits_as_in_a_game(world: World) -> None:
    world.enable()
    pacing = Pacing(world.game, 0.3)
    assert pacing.offer(MACHINE) == []
    (begun,) = pacing.due()
    assert isinstance(begun, Begun)


# Stops


def test_a_person_stops_whatever_is_under_way_and_takes_control(world: World) -> None:
    world.enable()
    world.game.command(MACHINE)
    control = world.game.stop(STOP)
    assert control == Control(Holder.PERSON, ANNA, 'a person pressed a key')
    state = world.rover.shown[-1]
    assert (state.previous_action, state.action_sequence, state.cut_short) == ('forward', 8, True)


def test_a_second_person_stops_it_too_but_does_not_take_control(world: World) -> None:
    world.game.command(KEY)
    assert world.game.stop(replace(STOP, publisher_id=BEN)) is None
    assert world.rover.shown[-1].cut_short
    assert world.game.control.holder_id == ANNA


def test_a_machine_stops_its_own_action_and_no_other(world: World) -> None:
    world.enable()
    stop = replace(MACHINE, action='')
    world.game.command(MACHINE)
    assert reason_of(world.game.stop(replace(stop, publisher_id=PLANNER))) is Reason.STALE
    assert world.rover.shown == []
    assert world.game.stop(stop) is None
    assert world.rover.shown[-1].cut_short
    assert world.game.control.holder is Holder.NOBODY


def test_with_nothing_under_way_a_stop_only_halts(world: World) -> None:
    assert world.game.stop(replace(MACHINE, action='')) is None
    assert (world.rover.doing[-1], world.rover.shown) == ('halt', [])


@pytest.mark.parametrize('wrong', [{'source': 7}, {'publisher_id': ''}])
def test_a_stop_without_sender_is_refused(wrong: dict[str, object], world: World) -> None:
    assert reason_of(world.game.stop(replace(STOP, **wrong))) is Reason.NO_SUCH_SOURCE  # type: ignore[arg-type]


def test_a_lock_stops_and_a_key_unlocks(world: World) -> None:
    world.game.command(KEY)
    assert world.game.lock('stop was called').holder is Holder.LOCKED
    assert world.rover.shown[-1].cut_short
    assert isinstance(world.game.command(KEY), Begun)


# Faults


def test_a_fault_cuts_the_action_short_with_the_last_state_that_was_sensed(world: World) -> None:
    world.game.command(KEY)
    world.rover.x, world.rover.fault = 5.0, '/odom is stale'
    world.game.pause('/odom is stale')
    state = world.rover.shown[-1]
    assert (state.features, state.cut_short, state.reward) == ((1.0, 0.0), True, 0.0)
    refused = world.game.command(KEY)
    assert reason_of(refused) is Reason.PAUSED
    assert isinstance(refused, Refused)
    assert refused.detail == '/odom is stale'
    assert world.after(1.0) == []
    world.rover.fault = ''
    world.game.pause('')
    (state,) = world.after(0.2)
    assert (state.features, state.refreshed) == ((5.0, 0.0), True)


def test_out_of_the_range_of_a_feature_only_a_person_acts(world: World) -> None:
    world.enable()
    world.game.command(MACHINE)
    world.rover.x, world.rover.outside = 8.0, 'x is out of range'
    world.game.restrict('x is out of range')
    state = world.rover.shown[-1]
    assert (state.state, state.cut_short) == ('x 8; x is out of range', True)
    refused = world.game.command(replace(MACHINE, step=1))
    assert isinstance(refused, Refused)
    assert (refused.reason, refused.detail) == (Reason.PAUSED, 'x is out of range')
    assert isinstance(world.game.command(KEY), Begun)
    world.game.restrict('y is out of range')
    assert world.game.under_way is not None  # it is a person's
    world.rover.x, world.rover.outside = 5.0, ''
    world.game.restrict('')
    assert [state.state for state in world.after(0.2)] == ['x 5']
    world.game.set_control(False, ANNA)
    assert isinstance(world.game.command(replace(MACHINE, step=2)), Begun)


def test_a_person_stops_a_paused_world(world: World) -> None:
    world.game.pause('the emergency stop is pressed')
    assert world.game.stop(STOP) is not None
    assert world.rover.doing[-1] == 'halt'


# Episodes


def test_an_episode_begins_where_the_robot_is(world: World) -> None:
    world.game.command(KEY)
    reply = world.game.reset('x 3', 0, Source.PERSON)
    assert (reply.status, reply.detail) == (
        ResetStatus.BAD_STATE,
        'rover can only begin where the robot is: drive it to another start',
    )
    assert world.game.under_way is not None
    assert world.game.reset('', 0, Source.MACHINE).status is ResetStatus.HELD_BY_PERSON
    begun = world.game.reset('', 0, Source.PERSON).transition
    assert begun == Transition(2, 0, 'x 1', (1.0, 0.0))
    assert world.rover.shown[-1].cut_short
    world.rover.fault = 'no scan'
    assert world.game.reset('', 0, Source.PERSON).detail == 'no scan'


def test_a_condition_or_the_step_limit_ends_the_episode() -> None:
    world = World(domain=replace(DOMAIN, max_steps=2))
    for x, terminated, truncated in ((9.5, True, False), (0.2, False, True)):
        world.game.reset('', 0, Source.PERSON)
        world.game.command(KEY)
        world.rover.x = x
        (state,) = world.after(0.2)
        assert (state.terminated, state.truncated) == (terminated, truncated)
    world.rover.x = 1.0
    world.game.reset('', 0, Source.PERSON)
    for truncated in (False, True):
        world.game.command(KEY)
        assert world.after(0.2)[0].truncated is truncated
    assert world.after(1.0) == []


def test_a_robot_that_is_pushed_shows_the_step_again_and_the_machine_may_answer_it(
    world: World,
) -> None:
    world.enable()
    world.rover.x = 1.05
    assert world.after(0.3) == []  # less than 1 % of the range
    world.rover.x = 1.15
    (state,) = world.after(0.0)
    assert state == Transition(1, 0, 'x 1.15', (1.15, 0.0), refreshed=True)
    world.rover.door = 1.0
    assert world.after(0.1) == []  # at most once per step time
    (state,) = world.after(0.1)
    assert state.features == (1.15, 1.0)
    assert isinstance(world.game.command(MACHINE), Begun)
    world.rover.x = 3.0
    (state,) = world.after(0.2)
    assert (state.step, state.refreshed) == (1, False)
