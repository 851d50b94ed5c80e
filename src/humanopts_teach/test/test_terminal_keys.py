"""The key table: the domain's keys come first, commands give way."""

from typing import Any

from humanopts_env.domains.base import Action, Domain
from humanopts_teach.dialogue.keys import Command, key_table
from humanopts_teach.terminal.device import key_of
from prompt_toolkit.key_binding.key_processor import KeyPress
from prompt_toolkit.keys import Keys
import pytest

TEACHING = (Command.DONE, Command.START_AGAIN, Command.NOT_HERE, Command.QUIT, Command.HELP)


def test_every_key_of_taxi_drives_and_no_command_has_one_of_them(taxi: Domain[Any]) -> None:
    table = key_table(taxi.actions, TEACHING)
    assert {table.action(a.key) for a in taxi.actions} == {a.name for a in taxi.actions}
    assert not table.actions.keys() & table.commands.keys()


def test_a_command_moves_to_its_next_key_when_an_action_has_it() -> None:
    actions = [Action('nap', 'n', 'sleep'), Action('squat', 's', 'sit'), Action('ask', 'a', 'ask')]
    table = key_table(actions, TEACHING)
    assert table.action('n') == 'nap'
    assert table.commands['h'] is Command.NOT_HERE
    assert Command.START_AGAIN in table.commands.values()
    assert len(table.commands) == len(TEACHING)


def test_capitals_do_the_same_unless_they_have_a_meaning_of_their_own(taxi: Domain[Any]) -> None:
    table = key_table(taxi.actions, TEACHING)
    assert table.action('P') == 'pickup'
    assert table.command('Q') is Command.QUIT
    both = key_table([Action('up', 'q', ''), Action('down', 'Q', '')], TEACHING)
    assert (both.action('q'), both.action('Q')) == ('up', 'down')
    assert both.command('q') is both.command('Q') is None


@pytest.mark.parametrize(
    ('press', 'key'),
    [
        (Keys.Up, 'up'),
        (Keys.ControlM, 'enter'),
        (Keys.ControlJ, 'enter'),
        (Keys.ControlH, 'backspace'),
        (Keys.ControlC, 'ctrl-c'),
        ('é', 'é'),
        (Keys.ControlZ, ''),
        (Keys.F1, ''),
    ],
)
def test_terminal_keys_have_our_names(press: Keys | str, key: str) -> None:
    assert key_of(KeyPress(press)) == key
