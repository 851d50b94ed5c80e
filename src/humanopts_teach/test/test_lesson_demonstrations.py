"""A demonstration from its start state to its verdict, and what spoils it."""

from dataclasses import replace
from pathlib import Path

from humanopts_env.game import Source
from humanopts_learner.demonstrations import Kind
from humanopts_teach.lesson.requests import (
    BeginDemonstration,
    EndDemonstration,
    Phase,
    RequestStatus,
    Verdict,
)
from humanopts_teach.lesson.store import DemonstrationStore
import pytest
from teach_support.lesson import CHOSEN, fill_disk, OPTION, preparing, START, Table, TAXI


def test_a_demonstration_holds_what_was_shown(table: Table) -> None:
    table.ready().began(START)
    table.time += 2.5
    table.drive('west', 'west', 'pickup')
    kept = table.end(again=True).demonstration
    assert kept is not None
    assert kept.kind is Kind.TRAJECTORY
    assert kept.states[0] == START
    assert len(kept.states) == len(kept.features) == 4
    assert kept.actions == ('west', 'west', 'pickup')
    assert kept.rewards == (-1.0, -1.0, 0.0)
    assert (kept.participant, kept.session, kept.option_name) == ('p1', 's1', OPTION)
    assert (kept.number, kept.chosen_features) == (1, CHOSEN)
    assert (kept.can_start_at_end, kept.terminated, kept.seconds) == (True, False, 2.5)
    assert table.lesson.demonstrations() == [kept]
    assert table.lesson.view.n_demonstrations == 1


def test_not_here_is_one_state_without_steps(table: Table) -> None:
    kept = table.ready().began(START).end(Verdict.NOT_HERE, again=True).demonstration
    assert kept is not None
    assert (kept.kind, kept.states, kept.actions) == (Kind.NOT_HERE, (START,), ())
    assert not kept.can_start_at_end
    assert table.lesson.view.n_not_here == 1


@pytest.mark.parametrize(
    ('steps', 'verdict', 'status'),
    [
        ((), Verdict.DONE, RequestStatus.NO_STEPS),
        (('west',), Verdict.NOT_HERE, RequestStatus.STEPS_TAKEN),
        (('west',), None, RequestStatus.BAD_VERDICT),
    ],
)
def test_a_verdict_that_does_not_fit_lets_the_demonstration_go_on(
    table: Table, steps: tuple[str, ...], verdict: Verdict | None, status: RequestStatus
) -> None:
    table.ready().began(START).drive(*steps)
    assert table.end(verdict).status is status
    assert table.drive('west', 'west', 'pickup').end().ok


@pytest.mark.parametrize(('episode', 'step'), [(1, 0), (1, 2), (2, 1), (0, 1)])
def test_a_verdict_on_another_state_is_not_carried_out(
    table: Table, episode: int, step: int
) -> None:
    table.ready().began(START).drive('west')
    answer = table.ask(EndDemonstration(Verdict.DONE, episode, step, False))
    assert answer.status is RequestStatus.NOT_CURRENT
    assert 'episode 1 step 1' in answer.detail
    assert table.end().ok


def test_the_state_that_a_verdict_names_may_still_be_on_its_way(table: Table) -> None:
    table.ready().began(START)
    assert table.lesson.reached(1, 0)
    assert not table.lesson.reached(1, 1)
    table.drive('west')
    assert table.lesson.reached(1, 1)


def test_a_discarded_demonstration_can_be_tried_again_from_the_same_state(table: Table) -> None:
    first = table.ready().began().lesson.view.start_state
    table.drive('west')
    assert table.ask(EndDemonstration(Verdict.DISCARD, 0, 0, False)).ok
    view = table.lesson.view
    assert (view.phase, view.n_demonstrations, view.episode) == (Phase.READY, 0, 0)
    assert table.began().lesson.view.start_state == first


def test_a_start_state_that_was_asked_for_is_tried_again_too(table: Table) -> None:
    table.ready().began(START).end(Verdict.DISCARD)
    assert table.began().lesson.view.start_state == START


def test_start_states_depend_on_seed_person_option_and_number_alone(
    store: DemonstrationStore,
) -> None:
    first = Table(store, seed=3).ready()
    drawn = [first.began().lesson.view.start_state]
    first.drive('north')
    first.end()
    first.learned()
    drawn.append(first.began().lesson.view.start_state)
    resumed = Table(store, seed=3).opened()
    assert resumed.began().lesson.view.start_state == drawn[1] != drawn[0]
    other = Table(store, seed=4).opened()
    assert other.began().lesson.view.start_state != drawn[1]


@pytest.mark.parametrize(
    ('text', 'says'),
    [
        ('nowhere', 'nowhere'),
        ('taxi 9,9 passenger R destination G', '5 x 5'),
        ('taxi 0,0 passenger R destination R', 'over'),
    ],
)
def test_a_start_state_must_be_one_to_demonstrate_from(table: Table, text: str, says: str) -> None:
    answer = table.ready().ask(BeginDemonstration(text))
    assert answer.status is RequestStatus.BAD_STATE
    assert says in answer.detail
    assert table.ask(BeginDemonstration()).ok


def test_a_game_that_does_not_answer_leaves_the_lesson_ready(table: Table) -> None:
    preparing(table)
    answer = table.lesson.not_begun(RequestStatus.NO_GAME, 'game did not answer within 5 s')
    assert answer.status is RequestStatus.NO_GAME
    assert table.lesson.phase is Phase.READY
    assert 'game did not answer' in table.lesson.view.text
    assert table.ask(BeginDemonstration()).ok


def test_the_first_state_may_come_before_or_after_games_answer(table: Table) -> None:
    state = table.ready().ask(BeginDemonstration()).state
    table.episode = 4
    table.lesson.began(4, state)
    assert not table.lesson.reached(4, 0)
    table.arrives(state)
    assert table.lesson.reached(4, 0)
    assert table.drive('west').end().ok


def test_late_states_of_earlier_episodes_do_not_end_a_demonstration(table: Table) -> None:
    state = table.ready().ask(BeginDemonstration()).state
    table.lesson.began(4, state)
    table.episode = 3
    table.arrives(START)
    table.drive('west')
    assert table.lesson.phase is Phase.DEMONSTRATING
    table.episode = 4
    table.arrives(state)
    assert table.drive('west').end().ok


def test_a_reset_by_somebody_else_ends_the_demonstration(table: Table) -> None:
    table.ready().began(START).drive('west')
    table.episode += 1
    assert table.arrives(START)
    view = table.lesson.view
    assert view.phase is Phase.READY
    assert 'reset by somebody else' in view.text
    assert table.lesson.demonstrations() == []
    assert table.end().status is RequestStatus.WRONG_PHASE


def test_a_reset_before_the_first_state_came_ends_the_demonstration(table: Table) -> None:
    table.lesson.began(1, table.ready().ask(BeginDemonstration(START)).state)
    table.episode = 2
    assert table.arrives(START)
    assert 'reset by somebody else' in table.lesson.view.text


def test_a_machines_step_ends_the_demonstration(table: Table) -> None:
    table.ready().began(START).drive('west', source=Source.MACHINE)
    assert table.lesson.phase is Phase.READY
    assert 'option or a policy moved' in table.lesson.view.text


def test_a_lost_state_ends_the_demonstration(table: Table) -> None:
    table.ready().began(START).drive('west')
    assert table.here is not None
    table.lesson.add_transition(replace(table.here, step=3))
    assert table.lesson.phase is Phase.READY
    assert 'step 3 of episode 1 came after step 1' in table.lesson.view.text


def test_an_episode_that_begins_elsewhere_is_not_the_one_asked_for(table: Table) -> None:
    table.lesson.began(1, table.ready().ask(BeginDemonstration(START)).state)
    table.episode = 1
    assert table.arrives('taxi 4,4 passenger B destination R')
    assert 'began in taxi 4,4' in table.lesson.view.text


def test_steps_that_break_the_rules_are_refused_and_discarded(table: Table) -> None:
    table.ready().began(START).drive('west')
    assert table.here is not None
    table.here = replace(
        table.here, step=2, previous_action='north', state='taxi 4,4 passenger R destination G'
    )
    table.here = replace(
        table.here, features=tuple(TAXI.feature_values(TAXI.decode(table.here.state)).tolist())
    )
    table.lesson.add_transition(table.here)
    answer = table.end()
    assert answer.status is RequestStatus.REFUSED
    assert 'north does not lead' in answer.detail
    assert table.lesson.phase is Phase.READY
    assert table.lesson.demonstrations() == []


def test_a_reward_that_is_not_a_number_is_refused(table: Table) -> None:
    table.ready().began(START).drive('west')
    assert table.here is not None
    table.here = replace(table.here, step=2, reward=float('nan'))
    table.lesson.add_transition(table.here)
    assert 'not finite' in table.end().detail


def test_the_text_says_when_the_task_is_over(table: Table) -> None:
    table.ready().began('taxi 0,4 passenger aboard destination G').drive('dropoff')
    assert 'The task is over' in table.lesson.view.text
    kept = table.end().demonstration
    assert kept is not None
    assert kept.terminated


def test_what_cannot_be_written_is_not_lost_and_can_be_tried_again(
    table: Table, monkeypatch: pytest.MonkeyPatch
) -> None:
    table.ready().began(START).drive('west')
    with monkeypatch.context() as patch:
        fill_disk(patch)
        answer = table.end()
        assert answer.status is RequestStatus.NOT_SAVED
        assert 'disk is full' in answer.detail
        assert table.lesson.phase is Phase.DEMONSTRATING
    assert table.end().ok


def test_the_same_lesson_gives_the_same_uuids_and_any_difference_others(tmp_path: Path) -> None:
    def uuid(folder: str, *steps: str, seconds: float = 0.0) -> str:
        with DemonstrationStore(tmp_path / folder) as store:
            table = Table(store).ready().began(START)
            table.time += seconds
            kept = table.drive(*steps).end().demonstration
            assert kept is not None
            return kept.uuid

    assert uuid('a', 'west') == uuid('b', 'west', seconds=9.0)
    assert uuid('c', 'south') != uuid('d', 'west')


def test_a_game_that_is_started_again_ends_the_demonstration_under_way(table: Table) -> None:
    table.ready().began(START).drive('west')
    assert table.lesson.game_restarted()
    view = table.lesson.view
    assert view.phase is Phase.READY
    assert 'the game was started again' in view.text
    assert table.end().status is RequestStatus.WRONG_PHASE
    assert not table.lesson.game_restarted()  # nothing is under way
    table.began()
    assert table.lesson.view.start_state == START  # it is asked for again


def test_a_lesson_that_is_started_again_goes_on_where_the_other_was(table: Table) -> None:
    table.ready().shown()
    table.began(START).drive('west')
    again = Table(table.store)
    assert again.lesson.resume('p1', 's1').ok
    view = again.lesson.view
    assert (view.session, view.option_name, view.chosen_features) == ('s1', OPTION, CHOSEN)
    assert (view.phase, view.n_demonstrations) == (Phase.LEARNING, 1)
    assert 'was started again; a demonstration that was under way is given up' in view.text
    again.learned()  # the newest, of which the lesson does not know whether it is counted in
    assert again.lesson.phase is Phase.READY
    assert again.shown().lesson.view.n_demonstrations == 2
