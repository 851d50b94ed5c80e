"""The lock-step game: who may act when, control that is not renewed, and its messages."""

from dataclasses import asdict, replace
from enum import IntEnum
from typing import Any

from humanopts_env import game
from humanopts_env.domains.taxi import Taxi
from humanopts_env.game import (
    Accepted,
    Command,
    ControlStatus,
    Game,
    Holder,
    Reason,
    Refused,
    ResetStatus,
    Source,
    Transition,
)
from humanopts_env.lease import CHECKS, Lease, MAX_KNOWN
from humanopts_interfaces.msg import ActionRefusal, ControlState, GameState
from humanopts_interfaces.srv import ResetGame, SetControl
import pytest

START = 'taxi 2,3 passenger R destination B'
ANNA, BEN, PLANNER = 'anna-1', 'ben-2', 'planner-3'
MACHINE = Command(PLANNER, 7, Source.MACHINE, 1, 0, 'north')
PERSON = Command(ANNA, 4, Source.PERSON, 0, 99, 'south')


def begun(state: str = START, max_steps: int = 200) -> Game:
    """Return a game in the first state of episode 1."""
    domain = Taxi()
    domain.max_steps = max_steps
    game = Game(domain)
    assert game.reset(state, 3, Source.MACHINE).status is ResetStatus.OK
    return game


def held_by_anna() -> Game:
    """Return a game that Anna drives."""
    game = begun()
    assert game.set_control(True, ANNA).status is ControlStatus.OK
    return game


def ended() -> Game:
    """Return a game whose first episode ended with the delivery."""
    game = begun('taxi 4,3 passenger aboard destination B')
    assert isinstance(game.command(replace(MACHINE, action='dropoff')), Accepted)
    return game


def cut_off() -> Game:
    """Return a game whose first episode was cut off after one step."""
    game = begun(max_steps=1)
    assert isinstance(game.command(MACHINE), Accepted)
    return game


def stepped() -> Game:
    """Return a game in which the machine has taken one step."""
    game = begun()
    assert isinstance(game.command(MACHINE), Accepted)
    return game


REFUSALS = {
    'no source': (begun, replace(MACHINE, source=0), Reason.NO_SUCH_SOURCE, 'source 0'),
    'unknown source': (begun, replace(MACHINE, source=9), Reason.NO_SUCH_SOURCE, 'source 9'),
    'nameless person': (
        begun,
        replace(PERSON, publisher_id=''),
        Reason.NO_SUCH_SOURCE,
        'publisher_id',
    ),
    'machine, held': (held_by_anna, MACHINE, Reason.HELD_BY_PERSON, ANNA),
    'second person, held': (
        held_by_anna,
        replace(PERSON, publisher_id=BEN),
        Reason.HELD_BY_PERSON,
        ANNA,
    ),
    'none begun': (lambda: Game(Taxi()), MACHINE, Reason.EPISODE_OVER, 'no episode'),
    'none begun, person': (lambda: Game(Taxi()), PERSON, Reason.EPISODE_OVER, 'no episode'),
    'delivered': (ended, replace(MACHINE, step=1), Reason.EPISODE_OVER, 'the task is over'),
    'delivered, person': (ended, PERSON, Reason.EPISODE_OVER, 'the task is over'),
    'cut off': (cut_off, replace(MACHINE, step=1), Reason.EPISODE_OVER, 'it was cut off'),
    'earlier episode': (begun, replace(MACHINE, episode=0), Reason.STALE, 'episode 0'),
    'repeated': (stepped, MACHINE, Reason.STALE, 'step 0'),
    'later step': (begun, replace(MACHINE, step=1), Reason.STALE, 'step 1'),
    'bad action': (begun, replace(MACHINE, action='fly'), Reason.NO_SUCH_ACTION, 'fly'),
    'bad key': (begun, replace(PERSON, action='fly'), Reason.NO_SUCH_ACTION, 'fly'),
    'no action': (begun, replace(PERSON, action=''), Reason.NO_SUCH_ACTION, 'has no action'),
}


@pytest.mark.parametrize('case', REFUSALS)
def test_a_refused_command_is_answered_and_changes_nothing(case: str) -> None:
    """Every reason, in words, with the command and what is current; control is not claimed."""
    make, command, reason, words = REFUSALS[case]
    game = make()
    transition, control = game.transition, game.control
    answer = game.command(command)
    assert isinstance(answer, Refused)
    assert answer.reason is reason
    assert words in answer.detail
    assert answer.command == command
    assert (answer.episode, answer.step) == (transition.episode, transition.step)
    assert (game.transition, game.control) == (transition, control)


def test_a_machine_step_is_the_transition_that_led_to_the_next_state() -> None:
    """The transition carries s, a, r, s' and who chose a."""
    game = begun()
    answer = game.command(MACHINE)
    assert isinstance(answer, Accepted)
    assert answer.control is None
    assert asdict(answer.transition) == {
        'episode': 1,
        'step': 1,
        'state': 'taxi 1,3 passenger R destination B',
        'features': (1, 3, 0, 0, 4, 3, 0, 0, 0, 0),
        'previous_action': 'north',
        'action_source': Source.MACHINE,
        'action_publisher_id': PLANNER,
        'action_sequence': 7,
        'reward': -1.0,
        'terminated': False,
        'truncated': False,
        'cut_short': False,
        'refreshed': False,
    }
    assert game.transition == answer.transition


def test_a_persons_first_key_claims_control_whatever_step_it_names() -> None:
    """The key is applied to the current step; the next machine command is refused."""
    game = begun()
    answer = game.command(PERSON)
    assert isinstance(answer, Accepted)
    assert answer.control == game.control
    assert (game.control.holder, game.control.holder_id) == (Holder.PERSON, ANNA)
    assert game.control.reason
    assert (answer.transition.step, answer.transition.action_source) == (1, Source.PERSON)
    refused = game.command(replace(MACHINE, step=1))
    assert isinstance(refused, Refused)
    assert refused.reason is Reason.HELD_BY_PERSON


@pytest.mark.parametrize(
    ('max_steps', 'action', 'ends'),
    [
        (200, 'north', (False, False)),
        (0, 'north', (False, False)),
        (1, 'north', (False, True)),
        (200, 'dropoff', (True, False)),
        (1, 'dropoff', (True, False)),
    ],
)
def test_an_episode_ends_with_the_task_or_is_cut_off_at_max_steps(
    max_steps: int, action: str, ends: tuple[bool, bool]
) -> None:
    """0 steps mean never; a task that is over in the last step is not cut off."""
    game = begun('taxi 4,3 passenger aboard destination B', max_steps)
    game.command(replace(MACHINE, action=action))
    assert (game.transition.terminated, game.transition.truncated) == ends
    assert game.transition.open == (not any(ends))


def test_each_reset_begins_the_next_episode() -> None:
    """Episodes count from 1, steps from 0, and nobody led to the first state."""
    game = ended()
    reply = game.reset(START, 0, Source.PERSON)
    assert (reply.status, reply.transition) == (ResetStatus.OK, game.transition)
    assert game.transition == Transition(2, 0, START, (2, 3, 0, 0, 4, 3, 0, 0, 0, 0))
    assert isinstance(game.command(replace(MACHINE, episode=2)), Accepted)


def test_an_empty_start_state_is_drawn_by_seed() -> None:
    """The same seed draws the same state, others draw others; seeds may have 64 bits."""
    seeds = (0, 0, 1, 2, 3, 2**64 - 1)
    replies = [begun().reset('', seed, Source.MACHINE) for seed in seeds]
    states = [reply.transition.state for reply in replies if reply.transition]
    assert len(states) == len(seeds)
    assert states[0] == states[1]
    assert len(set(states)) > 3
    starts = Taxi().start_states().tolist()
    assert all(Taxi().index(Taxi().decode(state)) in starts for state in states)


@pytest.mark.parametrize(
    ('state', 'words'),
    [
        ('nonsense', 'nonsense'),
        ('taxi 5,0 passenger R destination B', '5 x 5'),
        ('taxi 2,3 passenger B destination B', 'already over'),
    ],
)
def test_a_bad_start_state_is_refused_and_the_episode_goes_on(state: str, words: str) -> None:
    game = begun()
    transition = game.transition
    reply = game.reset(state, 0, Source.MACHINE)
    assert (reply.status, reply.transition) == (ResetStatus.BAD_STATE, None)
    assert words in reply.detail
    assert game.transition == transition


def test_a_reset_without_a_source_is_a_machine_s() -> None:
    game = begun()
    assert game.reset('', 0, 0).status is ResetStatus.OK
    assert game.reset(START, 0, 3).status is ResetStatus.BAD_SOURCE
    game.set_control(True, ANNA)
    assert game.reset('', 0, 0).status is ResetStatus.HELD_BY_PERSON


def test_a_machine_cannot_reset_what_a_person_drives() -> None:
    """The refusal names the holder; a person's reset is accepted and claims nothing."""
    game = held_by_anna()
    refused = game.reset(START, 0, Source.MACHINE)
    assert refused.status is ResetStatus.HELD_BY_PERSON
    assert ANNA in refused.detail
    assert game.transition.episode == 1
    control = game.control
    assert game.reset(START, 0, Source.PERSON).status is ResetStatus.OK
    assert game.control == control


@pytest.mark.parametrize(
    ('holder', 'hold', 'asker', 'status', 'holder_after', 'changed'),
    [
        ('', True, ANNA, ControlStatus.OK, ANNA, True),
        ('', False, ANNA, ControlStatus.OK, '', False),
        (ANNA, True, ANNA, ControlStatus.OK, ANNA, False),
        (ANNA, False, ANNA, ControlStatus.OK, '', True),
        (ANNA, True, BEN, ControlStatus.NOT_HOLDER, ANNA, False),
        (ANNA, False, BEN, ControlStatus.NOT_HOLDER, ANNA, False),
        ('', True, '', ControlStatus.NOT_HOLDER, '', False),
        (ANNA, False, '', ControlStatus.NOT_HOLDER, ANNA, False),
    ],
)
def test_control_is_taken_and_given_back_by_its_holder_only(
    holder: str, hold: bool, asker: str, status: ControlStatus, holder_after: str, changed: bool
) -> None:
    """Every combination of holder and request; a change carries the new control."""
    game = held_by_anna() if holder else begun()
    reply = game.set_control(hold, asker)
    assert reply.status is status
    assert reply.detail
    assert game.control.holder_id == holder_after
    assert game.control.holder is (Holder.PERSON if holder_after else Holder.NOBODY)
    assert reply.control == (game.control if changed else None)
    if status is ControlStatus.NOT_HOLDER and asker:
        assert ANNA in reply.detail


def test_control_of_a_terminal_that_is_gone_can_be_released() -> None:
    """Otherwise nobody could ever drive again."""
    game = held_by_anna()
    control = game.release('the terminal is gone')
    assert control == game.control
    assert (control.holder, control.holder_id) == (Holder.NOBODY, '')
    assert control.reason == 'the terminal is gone'


HOLDER, AGAIN, OTHER = '/anna#1', '/anna#2', '/bert#1'


def leased(*known: str) -> Lease:
    """A lease of Anna, where publishers have told their life."""
    lease = Lease()
    for publisher in known:
        lease.note_status(publisher)
    lease.begin(HOLDER)
    return lease


def looks(lease: Lease, count: int) -> list[str]:
    return [lease.check() for _ in range(count)]


def test_it_ends_after_so_many_looks_without_a_sign() -> None:
    *before, last = looks(leased(HOLDER), CHECKS)
    assert not any(before)
    assert last == '/anna#1 is silent and has not renewed its control'


def test_whatever_the_holder_publishes_renews_it_and_nobody_else() -> None:
    lease = leased(HOLDER, OTHER)
    for renew in (lease.renew, lease.note_status):
        assert not any(looks(lease, CHECKS - 1))
        renew(HOLDER)
        assert not any(looks(lease, CHECKS - 1))
        renew(OTHER)
        assert lease.check() != ''
        lease.begin(HOLDER)


def test_a_holder_that_is_started_again_or_ends_loses_it_at_once() -> None:
    assert leased(HOLDER).note_status(AGAIN) == '/anna was restarted'
    assert leased(HOLDER).note_status(HOLDER, ended=True) == '/anna#1 has ended'
    assert not leased(HOLDER).note_status(OTHER)
    assert not leased(HOLDER).note_status(OTHER, ended=True)
    assert not leased(HOLDER, AGAIN).note_status(AGAIN)  # two that both were there before


def test_who_told_its_life_is_known_until_it_ends_and_not_more_than_memory_allows() -> None:
    lease = leased(HOLDER)
    assert (lease.knows(HOLDER), lease.knows(OTHER)) == (True, False)
    lease.note_status(HOLDER, ended=True)
    assert not lease.knows(HOLDER)
    for number in range(MAX_KNOWN + 1):
        lease.note_status(f'/many#{number}')
    assert not lease.knows('/many#0')
    assert lease.knows('/many#1')


ENVELOPE = {'header', 'publisher_id', 'sequence'}
PACE = {'step_period', 'paused_by'}  # of ``Pacing``, told with who holds control


@pytest.mark.parametrize(
    ('values', 'prefix', 'message'),
    [
        (game.Source, 'SOURCE_', GameState),
        (game.Reason, 'REASON_', ActionRefusal),
        (game.Holder, 'HOLDER_', ControlState),
        (game.ResetStatus, 'STATUS_', ResetGame.Response),
        (game.ControlStatus, 'STATUS_', SetControl.Response),
    ],
)
def test_numbers_are_those_of_the_message(
    values: type[IntEnum], prefix: str, message: Any
) -> None:
    """Every constant has its member, and the other way round; UNKNOWN is never sent."""
    constants = {
        name.removeprefix(prefix): getattr(message, name)
        for name in dir(message)
        if name.startswith(prefix) and not name.endswith('_UNKNOWN')
    }
    assert {member.name: member.value for member in values} == constants
