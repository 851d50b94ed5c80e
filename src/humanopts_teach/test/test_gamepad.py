"""The mapping of a gamepad, and what its messages mean."""

from collections.abc import Sequence
from pathlib import Path

from humanopts_env.domains.registry import make_domain
from humanopts_teach.gamepad import Deed, Gamepad, GamepadError, read_mapping, Reading
import pytest

LB, A, X, START = 4, 0, 2, 7
UP, RIGHT = {1: 1.0}, {0: -1.0}
TAXI = make_domain('taxi').actions


def read(pad: Gamepad, axes: dict[int, float], *buttons: int) -> Reading:
    """Return the reading of an Xbox pad."""
    return pad.read([axes.get(n, 0.0) for n in range(8)], [int(n in buttons) for n in range(11)])


@pytest.fixture
def pad() -> Gamepad:
    """The default mapping for Taxi, with nothing pressed so far."""
    pad = Gamepad(read_mapping(), TAXI)
    read(pad, {})
    return pad


def test_an_action_needs_the_dead_man_button(pad: Gamepad) -> None:
    assert read(pad, UP) == Reading()
    assert read(pad, UP, LB) == Reading(held=True, action='north', repeats=True)
    assert read(pad, UP) == Reading(released=True)


def test_a_pad_that_is_plugged_in_with_pressed_buttons_moves_nothing() -> None:
    pad = Gamepad(read_mapping(), TAXI)
    assert read(pad, UP, LB, A) == Reading()
    assert not read(pad, UP, LB).held
    read(pad, UP)
    assert read(pad, UP, LB).action == 'north'
    pad.disarm()
    assert read(pad, UP, LB, START) == Reading()


def test_the_control_pressed_first_acts_until_it_is_released(pad: Gamepad) -> None:
    read(pad, {}, LB)
    assert read(pad, UP, LB) == Reading(held=True, action='north', fresh=True, repeats=True)
    both = read(pad, UP | RIGHT, LB)
    assert (both.action, both.fresh) == ('north', False)
    assert read(pad, RIGHT, LB).action == 'east'


def test_a_button_answers_the_lesson_or_acts_with_the_dead_man_button(pad: Gamepad) -> None:
    assert read(pad, {}, A).deeds == (Deed.YES,)
    read(pad, {}, LB)
    pickup = read(pad, {}, LB, A)
    assert pickup == Reading(held=True, action='pickup', fresh=True)
    assert not read(pad, {}, LB, A).fresh
    assert read(pad, {}, LB, START).deeds == (Deed.BEGIN, Deed.DONE)
    assert read(pad, {}, LB, X).deeds == (Deed.NOT_HERE,), 'Taxi has two other actions'


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('controls: []', 'dead_man: Field required'),
        ('dead_man: {button: 4}\ncontrols: [{button: 0, do: jump}]', 'controls 1 do: it should'),
        ('dead_man: {button: 4, axis: 1, above: 0}\ncontrols: []', 'a button or an axis'),
        ('dead_man: {axis: 4}\ncontrols: []', 'dead_man: an axis needs one threshold'),
        ('dead_man: {button: -1}\ncontrols: []', 'dead_man button: it should be greater'),
        ('dead_man: {button: 4}\ncontrols: [{button: 0}]', 'exactly one of action, key, other'),
        ('dead_man: {button: 4}\ncontrols: [{button: 0, does: x}]', 'unknown key; use button'),
        ('dead_man: {button: 4}\nrepeat: 0\ncontrols: []', 'repeat: it should be greater'),
        ('dead_man: {button: 4}\ncontrols: [{button: 0, action: jmup}]', "unknown action 'jmup'"),
        ('dead_man: {button: 4}\ncontrols: [{button: 0, key: jmup}]', 'no control for any action'),
        ('- 1', 'it should be'),
    ],
)
def test_a_bad_mapping_is_refused_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / 'pad.yaml'
    file.write_text(text)
    with pytest.raises(GamepadError) as refused:
        Gamepad(read_mapping(str(file)), TAXI)
    assert said in str(refused.value)
    assert '\n' not in str(refused.value)


@pytest.mark.parametrize(
    ('axes', 'buttons', 'said'),
    [
        ([0.0] * 6, [0] * 11, 'axis 7, and the gamepad has 6 axes'),
        ([0.0] * 8, [0] * 3, 'and the gamepad has 3 buttons'),
        ([0.0, float('nan'), *[0.0] * 6], [0] * 11, 'axis 1 of the gamepad is nan'),
    ],
)
def test_a_pad_that_does_not_fit_is_refused(
    pad: Gamepad, axes: Sequence[float], buttons: Sequence[int], said: str
) -> None:
    with pytest.raises(GamepadError, match=said):
        pad.read(axes, buttons)
