"""The dialogue with a robot: it is driven to each start, stopped at any time, and taken over."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from humanopts_learner.summary import Criterion, OptionSummary
from humanopts_teach.browser.markup import parts
from humanopts_teach.dialogue.view import view
from humanopts_teach.lesson.requests import Drive, EndDemonstration, Phase, Verdict
from humanopts_teach.terminal.drawing import frame
from hypothesis import given, settings
from hypothesis import strategies as st
import pytest
from teach_support import snapshot
from teach_support.robot_desk import RobotDesk

NAME = 'go home'


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[RobotDesk]:
    desk = RobotDesk(tmp_path)
    yield desk
    desk.store.close()


def meet_criteria(desk: RobotDesk) -> None:
    met = OptionSummary(NAME, 'p1', criteria=(Criterion.of('agreement', 0.9, 0.5),))
    desk.exam, desk.reports = 2, {NAME: met}
    desk.publish()
    desk.advance()


EVENTS: dict[str, Callable[[RobotDesk], object]] = {
    'half a second passes': lambda desk: desk.after(0.5),
    'two seconds pass': lambda desk: desk.after(2.0),
    'the machine goes home': lambda desk: desk.moves('home'),
    'it gets home': lambda desk: (
        desk.after(6.0),
        desk.run_ends(f'{NAME}: its termination condition holds (1 step, reward -1).'),
    ),
    'the door closes': lambda desk: (setattr(desk.rover, 'door', 1.0), desk.after(0.3)),
    'its criteria are met': meet_criteria,
    'the scan is late': lambda desk: (desk.game.pause('the scan is 0.7 s old'), desk.after(0.1)),
}
CONVERSATIONS = {
    'taught': (
        'enter 1 g o space h o m e enter | y n | enter | t | left | ... half a second passes '
        '| ... the door closes | left | ... half a second passes | left right '
        '| ... half a second passes | h | ... two seconds pass | space | ? | x | enter | right '
        '| ... half a second passes | ... the scan is late'
    ),
    'corrected': (
        'enter 1 g o space h o m e enter y n t enter left | ... half a second passes | enter '
        '| w | ... the machine goes home | ... half a second passes | left '
        '| ... half a second passes | enter | w | ... the machine goes home '
        '| ... it gets home | escape 3 1 | enter | ... the machine goes home | w | left '
        '| ... half a second passes | enter'
    ),
    'examined': (
        'enter 1 g o space h o m e enter y n t enter left | ... half a second passes '
        '| enter | ... its criteria are met | enter | right | ... half a second passes | enter '
        '| ... the machine goes home | ... it gets home | r | right | ... half a second passes '
        '| enter | ... the machine goes home | ... half a second passes | w | enter'
    ),
}


@pytest.mark.parametrize('name', CONVERSATIONS)
def test_a_conversation_is_as_recorded(name: str, desk: RobotDesk) -> None:
    lines, bar = list[str](), ''
    for step in CONVERSATIONS[name].split(' | '):
        desk.asked.clear()
        if step.startswith('... '):
            EVENTS[step[4:]](desk)
        else:
            desk.press(*(' ' if key == 'space' else key for key in step.split()))
        _, *words, keys = desk.see().split('\n')
        lines += ['', step if step.startswith('...') else f'> {step}']
        lines += [*(f'  asks {each!r}' for each in desk.asked), *words, *[keys][keys == bar :]]
        bar = keys
    snapshot.check(f'robot_{name}.txt', '\n'.join(lines))


@pytest.fixture
def shows(desk: RobotDesk) -> RobotDesk:
    """Begin a demonstration, in control of the robot."""
    desk.press('enter', '1').type(NAME).press('y', 'y', 't', 'enter')
    desk.asked.clear()
    return desk


def test_space_stops_the_robot_at_once_whatever_is_pending(shows: RobotDesk) -> None:
    shows.press('h').after(1.0).press('enter', 'left', 'enter', ' ')
    kinds = [type(each).__name__ for each in shows.asked]
    assert (kinds, shows.asked[-1].action) == (['Drive'] * 3, '')  # the keys between do not count
    (home, back) = (step.previous_action for step in shows.world.driven)
    assert (home, back, shows.game.under_way) == ('home', 'back', None)
    assert shows.world.lesson.phase is Phase.DEMONSTRATING
    assert 'Stopped. You have control.' in shows.see()


def test_space_is_typed_in_a_text_unless_the_robot_moves(desk: RobotDesk) -> None:
    desk.press('enter', '1').press(*NAME)
    assert f'> {NAME}' in desk.see()
    assert not any(isinstance(each, Drive) for each in desk.asked)
    before = parts(view(desk.app))
    desk.rover.door = 1.0
    assert parts(view(desk.after(0.5).app)) == before  # a page keeps its text field
    desk.game.set_control(True, 'other')
    desk.game.set_control(False, 'other')
    desk.moves('home')
    assert desk.press(' ').game.under_way is None


def test_a_key_that_is_held_down_repeats_its_action_once(shows: RobotDesk) -> None:
    shows.press(*['right'] * 20)
    assert len(shows.asked) == 1
    shows.after(3.0)
    assert [step.previous_action for step in shows.world.driven] == ['forward'] * 2
    assert not any(step.cut_short for step in shows.world.driven)


def test_a_demonstration_begins_where_the_person_took_over(shows: RobotDesk) -> None:
    shows.press('left').after(0.5).press('enter', 'w')
    shows.moves('home')
    shows.after(1.0).press('right').after(0.5).press('enter')
    demo = shows.lesson.demonstrations()[-1]
    assert (demo.actions, demo.machine_steps) == (('forward',), 0)
    assert demo.states == ('x 3.50, door 0', 'x 4.00, door 0')


def test_a_run_that_ended_by_itself_is_not_followed_by_a_demonstration(shows: RobotDesk) -> None:
    shows.press('left').after(0.5).press('enter', 'w')
    shows.moves('home')
    shows.after(5.0).run_ends('It ended.')
    assert shows.lesson.phase is Phase.READY
    assert 'It ended.' in shows.see()


def test_what_is_sensed_just_before_an_action_counts(shows: RobotDesk) -> None:
    shows.press('left').after(0.5)
    shows.rover.door = 1.0
    shows.after(0.3)
    assert 'door closed' in shows.see()
    shows.press('left').after(0.5).press('enter')
    demo = shows.lesson.demonstrations()[-1]
    assert [door for _, door in demo.features] == [0.0, 1.0, 1.0]
    assert demo.actions == ('back', 'back')


def test_a_robot_can_be_driven_on_after_its_episode(shows: RobotDesk) -> None:
    shows.press('left').after(0.5).press('enter')
    over = replace(shows.game.transition, terminated=True)
    shows.game.transition = shows.world.game = over
    shows.press('right').after(0.5)
    assert (shows.world.game.episode, shows.world.game.step) == (over.episode + 1, 1)


KEYS = ['left', 'right', '.', 'h', 'enter', 'escape', 'backspace', *'123tywnrsmle?x']


@given(st.lists(st.sampled_from([*KEYS, 'time', 'machine', 'end']), max_size=60))
@settings(max_examples=60, deadline=None)
def test_whatever_is_pressed_space_stops_the_robot_and_nothing_is_lost(keys: list[str]) -> None:
    with TemporaryDirectory() as folder:
        desk, kept = RobotDesk(Path(folder)), set[str]()
        desk.press('enter', '1').type(NAME).press('y', 'n', 't')
        for key in keys:
            running = desk.app.run is not None
            if key == 'time':
                desk.after(0.3)
            elif key == 'machine' and running:
                desk.moves('home')
            elif key == 'end' and running:
                desk.run_ends('It ended.', well=len(keys) % 2 == 0)
            elif key in KEYS:
                desk.press(key)
            assert len(frame(desk.app, 80, 24)) == 24
            now = {demo.uuid for demo in desk.lesson.demonstrations()}
            assert kept <= now
            kept = now
        desk.press(' ')
        assert desk.game.under_way is None
        desk.after(1.0)
        assert desk.app.waits_for is None
        desk.store.close()


def test_a_terminal_that_ends_leaves_a_robot_that_stands_still(shows: RobotDesk) -> None:
    shows.press('h').after(0.5)
    here = shows.world.game
    assert shows.app.last_requests() == [
        EndDemonstration(Verdict.DISCARD, here.episode, here.step),
        Drive('', here.episode, here.step),
    ]
