"""A demonstration by keys: steps, verdicts, what is shown meanwhile, and the next start."""

from humanopts_env.domains.registry import make_domain
from humanopts_teach.lesson.requests import (
    BeginDemonstration,
    Drive,
    EndDemonstration,
    Phase,
    Verdict,
)
import pytest
from teach_support.person import Person, START


def drives(shower: Person, key: str, action: str, state: str, reward: float = -1.0) -> None:
    """Press a key, and have the game take the step."""
    shower.press(key)
    step = shower.world.game.step + 1
    shower.game(step=step, state=state, previous_action=action, reward=reward)


@pytest.mark.parametrize('key', ['n', 'enter', 'u', 'backspace'])
def test_a_key_pressed_while_the_learner_works_does_not_answer_the_next_start(
    shower: Person, key: str
) -> None:
    drives(shower, 'left', 'west', 'taxi 2,2 passenger R destination B')
    ended = shower.press('enter')
    shower.lesson(Phase.LEARNING, n_demonstrations=1, last_uuid='abc')
    begin = shower.answer(ended)
    assert begin is None
    assert shower.sees_words('learning ...')
    begin = shower.lesson(Phase.READY)
    assert begin == BeginDemonstration()
    shower.press(key)  # the screen does not show the next start yet
    shower.game(episode=3, step=0, state=START)
    shower.lesson(Phase.DEMONSTRATING, episode=3)
    assert shower.answer(begin, episode=3) is None
    assert shower.sees_words('came before this was shown, and is not taken.')
    assert not shower.sees_words('Take back')


def test_keys_of_one_demonstration_can_be_typed_ahead(shower: Person) -> None:
    assert shower.press('left', 'p', 'enter') == Drive('west', 2, 0)
    assert shower.game(step=1) == Drive('pickup', 2, 1)
    assert shower.game(step=2) == EndDemonstration(Verdict.DONE, 2, 2)


def test_the_board_and_the_words_show_only_the_chosen_features(shower: Person) -> None:
    assert shower.sees_words('taxi row 2, taxi col 3, passenger row 0, passenger col 0')
    assert '⚑' not in shower.sees()
    assert '☻' in shower.sees()


def test_all_keys_are_on_the_screen_while_demonstrating(shower: Person) -> None:
    for key in (
        *('↓ south', '↑ north', '→ east', '← west', 'p pickup', 'd dropoff', 'Enter done'),
        *('n not here', 'Backspace discard', 'can restart at its end: no', 'q quit', '? help'),
    ):
        assert key in shower.sees()


def test_an_arrow_key_is_sent_for_the_state_that_was_seen(shower: Person) -> None:
    assert shower.press('left', 'left') == Drive('west', 2, 0)
    assert shower.look() is None  # the second key waits for the first
    assert shower.game(step=1) == Drive('west', 2, 1)


def test_done_waits_for_the_steps_typed_before_it(shower: Person) -> None:
    shower.press('p', 'enter')
    assert shower.game(step=1) == EndDemonstration(Verdict.DONE, 2, 1)


def test_the_next_start_begins_by_itself_after_a_verdict(shower: Person) -> None:
    request = shower.press('n')
    assert request == EndDemonstration(Verdict.NOT_HERE, 2, 0)
    shower.lesson(Phase.LEARNING, n_not_here=1)
    assert shower.answer(request) is None
    assert shower.lesson(Phase.READY) == BeginDemonstration()


def test_each_step_says_what_it_did(shower: Person) -> None:
    assert 'reward' not in shower.sees()
    drives(shower, 'left', 'west', 'taxi 2,2 passenger R destination B')
    assert shower.sees_words('went west (reward -1)')
    drives(shower, 'p', 'pickup', 'taxi 2,2 passenger R destination B')
    assert shower.sees_words('nobody here to pick up (reward -1)')


def test_a_step_whose_beginning_was_not_seen_is_named_by_its_action(shower: Person) -> None:
    shower.game(step=7, previous_action='west', reward=-1.0)
    assert shower.sees_words('last: west (reward -1)')


def test_done_after_a_step_without_effect_asks_once_more(shower: Person) -> None:
    drives(shower, 'p', 'pickup', START)
    assert shower.press('enter') is None
    assert shower.sees_words('The last step had no effect (nobody here to pick up).')
    assert shower.press('x') is None
    assert shower.press('enter', 'enter') == EndDemonstration(Verdict.DONE, 2, 1)


def test_a_fall_is_told_and_not_called_done(teacher: Person) -> None:
    lake = make_domain('gymnasium:FrozenLake-v1')
    teacher.world.domain = lake
    teacher.game(episode=1, step=0, state='row 1, col 0')
    teacher.press('escape', '5')
    teacher.game(step=1, state='row 1, col 1', previous_action='down', terminated=True, reward=0.0)
    assert teacher.sees_words('slid right and fell into a hole (reward 0) The task is over.')
    assert 'done' not in teacher.sees()


def test_a_refused_verdict_leaves_the_demonstration_as_it_is(shower: Person) -> None:
    shower.answer(shower.press('enter'), ok=False, text='nothing was demonstrated')
    assert shower.sees_words('nothing was demonstrated')
    assert shower.press('left') == Drive('west', 2, 0)


def test_starts_are_not_asked_for_again_and_again_when_they_are_refused(teacher: Person) -> None:
    assert teacher.answer(teacher.press(' '), ok=False, text='the budget is spent') is None
    assert teacher.sees_words('the budget is spent')


def test_can_start_again_stays_as_it_was_said_last(shower: Person) -> None:
    assert shower.press('s') is None
    assert 'can restart at its end: YES' in shower.sees()
    request = shower.press('enter')
    assert request == EndDemonstration(Verdict.DONE, 2, 0, can_start_at_end=True)
    shower.lesson(Phase.LEARNING)
    begin = shower.answer(request) or shower.lesson(Phase.READY)
    shower.game(episode=3)
    shower.lesson(Phase.DEMONSTRATING, episode=3)
    shower.answer(begin, episode=3)
    assert shower.press('enter') == EndDemonstration(Verdict.DONE, 3, 0, can_start_at_end=True)
    shower.lesson(Phase.DEMONSTRATING, option_name='another', episode=4)
    assert 'can restart at its end: no' in shower.sees()


def test_leaving_asks_first_once_steps_were_taken(shower: Person) -> None:
    shower.press('left')
    shower.game(step=1)
    assert shower.press('escape') is None
    assert shower.sees_words('The demonstration under way is discarded; all else is saved.')
    assert shower.press('x') is None
    assert shower.press('escape', 'enter') == EndDemonstration(Verdict.DISCARD, 2, 1)
