"""Control by gamepad: the mapping file, and the interpretation of messages."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
import math
from pathlib import Path
from typing import Annotated, Any

from humanopts_env.domains.base import Action
from humanopts_ros.text_files import fault_in, FileError, read_yaml
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    model_validator,
    NonNegativeInt,
    PositiveInt,
    ValidationError,
)

DEFAULT = 'default'  # in place of a file: the mapping for an Xbox pad with joy_node
_ARROWS = 'up', 'down', 'left', 'right'


class GamepadError(ValueError):
    """A mapping file or a message of a gamepad cannot be used; the text says why."""


class Deed(StrEnum):
    """The effect of a control that is not an action of the world."""

    BEGIN = 'begin'
    DONE = 'done'
    NOT_HERE = 'not here'
    DISCARD = 'discard'
    YES = 'yes'
    NO = 'no'
    STOP = 'stop'
    TAKE_CONTROL = 'take control'
    GIVE_CONTROL = 'give control'


def _word(value: Any) -> Any:
    """Restore yes and no, which are booleans in YAML 1.1."""
    return {True: 'yes', False: 'no'}.get(value, value) if isinstance(value, bool) else value


class Input(BaseModel):
    """A button, or an axis beyond a threshold."""

    model_config = ConfigDict(extra='forbid', frozen=True)
    button: NonNegativeInt | None = None
    axis: NonNegativeInt | None = None
    above: float | None = None
    below: float | None = None

    @model_validator(mode='after')
    def _check_input(self) -> 'Input':
        if (self.button is None) == (self.axis is None):
            raise ValueError('name a button or an axis')
        limits = (self.above is not None) + (self.below is not None)
        if limits != (self.axis is not None):
            raise ValueError('an axis needs one threshold, above or below; a button has none')
        return self

    def pressed(self, axes: Sequence[float], buttons: Sequence[int]) -> bool:
        """
        Return whether the input is pressed.

        :raises GamepadError: the gamepad lacks the input, or its value is not a number.
        """
        name, plural, number = 'button', 'buttons', self.button
        values: Sequence[float] = buttons
        if self.axis is not None:
            name, plural, number, values = 'axis', 'axes', self.axis, axes
        assert number is not None, 'validated'
        if number >= len(values):
            raise GamepadError(
                f'the mapping uses {name} {number}, and the gamepad has {len(values)} {plural}, '
                'numbered from 0: correct the mapping'
            )
        value = values[number]
        if not math.isfinite(value):
            raise GamepadError(f'{name} {number} of the gamepad is {value}')
        if self.above is not None:
            return value > self.above
        return value < self.below if self.below is not None else bool(value)


class Binding(Input):
    """The effect of an input: exactly one of action, key, other and do."""

    action: str | None = None  # name of an action
    key: str | None = None  # the action with this key, if the world has one
    other: PositiveInt | None = None  # the n-th action without an arrow key, if there is one
    do: Annotated[Deed, BeforeValidator(_word)] | None = None
    repeat: bool | None = None  # whether it repeats while held; None: only an axis does

    @model_validator(mode='after')
    def _check_effect(self) -> 'Binding':
        if sum(each is not None for each in (self.action, self.key, self.other, self.do)) != 1:
            raise ValueError('give exactly one of action, key, other and do')
        return self

    @property
    def repeats(self) -> bool:
        """Whether the effect repeats while the input is held."""
        return self.axis is not None if self.repeat is None else self.repeat

    @property
    def place(self) -> tuple[object, ...]:
        """A key that is equal for controls on the same input."""
        return self.button, self.axis, self.above, self.below


class GamepadMapping(BaseModel):
    """The contents of a mapping file."""

    model_config = ConfigDict(extra='forbid', frozen=True)
    dead_man: Input
    repeat: float = Field(0.25, gt=0, le=60)  # s between steps of actions that take no time
    controls: tuple[Binding, ...]


def read_mapping(name: str = DEFAULT) -> GamepadMapping:
    """
    Read a mapping file.

    :param name: path of the file, or ``DEFAULT``.
    :raises GamepadError: the file cannot be read, or is invalid.
    """
    path = Path(__file__).parent / 'gamepad.yaml' if name == DEFAULT else Path(name)
    try:
        return GamepadMapping.model_validate(read_yaml(path))
    except FileError as error:
        raise GamepadError(str(error)) from error
    except ValidationError as error:
        place = error.errors()[0]['loc'][:1]
        known = (GamepadMapping if len(error.errors()[0]['loc']) == 1 else Binding).model_fields
        kind = Input.model_fields if place == ('dead_man',) else known
        raise GamepadError(f'{path.name}: {fault_in(error, kind)}') from None


@dataclass(frozen=True)
class Reading:
    """The person's input in one message of the gamepad."""

    held: bool = False  # whether the dead-man button counts as held
    released: bool = False  # whether it was released in this message
    action: str = ''  # of the active control; empty: none
    fresh: bool = False  # whether that control was pressed in this message
    repeats: bool = False
    deeds: tuple[Deed, ...] = ()  # of controls pressed in this message


class Gamepad:
    """
    Interprets the messages of one gamepad.

    Actions require the dead-man button, which counts only after it has been released once:
    plugging in a pad with a pressed button moves nothing. Of several controls, the one pressed
    first is active until it is released.
    """

    def __init__(self, mapping: GamepadMapping, actions: Sequence[Action]) -> None:
        """
        Match the controls of the mapping to actions.

        :raises GamepadError: the mapping names an unknown action, or controls no action of the
            world.
        """
        self._mapping = mapping
        names, keys = {each.name: each.name for each in actions}, {a.key: a.name for a in actions}
        others = [each.name for each in actions if each.key not in _ARROWS]
        self._drives: dict[Binding, str] = {}
        for control in mapping.controls:
            if control.action is not None and control.action not in names:
                known = ', '.join(names)
                raise GamepadError(f'unknown action {control.action!r}; choose from {known}')
            action = names.get(control.action or '') or keys.get(control.key or '')
            if control.other is not None and control.other <= len(others):
                action = others[control.other - 1]
            if action:
                self._drives[control] = action
        if not self._drives:
            raise GamepadError('the mapping has no control for any action of this world')
        self._places = {each.place for each in self._drives}
        self._active: Binding | None = None
        self.disarm()

    def disarm(self) -> None:
        """Ignore the pressed controls until they are released, since messages were missed."""
        self._pressed: set[Binding] | None = None  # None: unknown
        self._armed = self._held = False

    def read(self, axes: Sequence[float], buttons: Sequence[int]) -> Reading:
        """
        Return the person's input in a message.

        :raises GamepadError: an input of the mapping is missing, or its value is not a number.
        """
        pressed = {each for each in self._mapping.controls if each.pressed(axes, buttons)}
        dead_man = self._mapping.dead_man.pressed(axes, buttons)
        new = pressed - (pressed if self._pressed is None else self._pressed)
        self._armed |= not dead_man
        held, before = dead_man and self._armed, self._held
        self._pressed, self._held = pressed, held
        driving = [each for each in self._drives if each in pressed] if held else []
        fresh = [each for each in driving if each in new]
        kept = self._active if self._active in driving else None
        self._active = kept or next(iter(fresh or driving), None)
        blocked = self._places if held else ()
        return Reading(
            held,
            before and not held,
            self._drives[self._active] if self._active else '',
            self._active in fresh,
            self._active is not None and self._active.repeats,
            tuple(
                each.do
                for each in self._mapping.controls
                if each in new and each.do is not None and each.place not in blocked
            ),
        )
