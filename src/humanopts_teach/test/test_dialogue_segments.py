"""A person plays the whole task once, and names its parts, which become demonstrations."""

from pathlib import Path

from humanopts_env.domains.registry import reference_options
from humanopts_env.domains.taxi import Taxi
from humanopts_teach.lesson.requests import AddDemonstrations, AnswerQuestion, Phase
import pytest
from teach_support.desk import Desk
from teach_support.snapshot import check

TAXI = Taxi()
FETCH, DELIVER = 'fetch', 'deliver'


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    """Return a person who has played Taxi to its end."""
    desk = Desk(TAXI, tmp_path).press('enter')
    desk.press(*whole_task(desk))
    while not desk.game.transition.terminated:
        state = TAXI.decode(desk.game.transition.state)
        able = (each for each in reference_options(TAXI).values() if each.can_start(state))
        desk.press(TAXI.actions[next(able).optimal_actions(state)[0]].key)
    return desk


def whole_task(desk: Desk) -> list[str]:
    """Return the key of the menu item."""
    lines = [line for line in desk.see().splitlines() if 'Play the whole task once' in line]
    return [next(char for char in lines[0] if char.isdigit())]


def test_the_parts_are_named_joined_and_kept(desk: Desk) -> None:
    """Taxi arrives at the passenger, picks up, arrives at the destination, drops off."""
    desk.press('enter')
    shown = [desk.see()]
    desk.press('n').type(FETCH).press('m', 'down', 'n').type(DELIVER)
    desk.press('down', 'n').type(DELIVER)
    shown.append(desk.see())
    desk.press('enter')
    assert desk.lesson.phase is Phase.ASKING
    shown.append(desk.see())
    desk.press('enter', 'a')
    shown.append(desk.see())
    desk.press('a')
    shown.append(desk.see())
    check('dialogue_segments.txt', '\n\n'.join(shown))
    kept = desk.lesson.demonstrations()
    assert [demo.option_name for demo in kept] == [FETCH, DELIVER]
    assert kept[0].states[-1] == kept[1].states[0]
    assert (kept[0].terminated, kept[1].terminated) == (False, True)
    assert desk.app.known_options == (FETCH, DELIVER)


def test_a_dropped_part_is_left_out_and_a_refusal_loses_nothing(desk: Desk) -> None:
    desk.press('enter', 'n').type(FETCH).press('down', 'n').type('nothing').press('d')
    desk.lesson.pause('no recorder')
    desk.press('enter')
    assert 'the lesson is paused' in desk.see()
    assert FETCH in desk.see()
    desk.lesson.pause('')
    desk.press('enter', 'a')
    assert [demo.option_name for demo in desk.lesson.demonstrations()] == [FETCH]
    requests = [each for each in desk.asked if isinstance(each, AddDemonstrations)]
    assert len(requests) == 1
    assert any(isinstance(each, AnswerQuestion) and each.yes for each in desk.asked)


def test_names_are_forgotten_only_after_a_question(desk: Desk) -> None:
    desk.press('enter', 'n').type(FETCH).press('escape')
    assert 'The names are forgotten; the recording keeps the play.' in desk.see()
    desk.press('x')
    assert FETCH in desk.see()
