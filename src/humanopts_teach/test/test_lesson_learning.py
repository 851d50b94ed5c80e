"""The learner's word, criteria, budget, restarts, and what is taken back."""

from dataclasses import replace

from humanopts_env.domains.pacman.domain import PacMan
from humanopts_learner.demonstrations import GOAL, TREES
from humanopts_teach.lesson.requests import (
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    OpenSession,
    Phase,
    RequestStatus,
    Verdict,
    WithdrawDemonstration,
)
from humanopts_teach.lesson.store import DemonstrationStore, Entry
import pytest
from teach_support.lesson import (
    CHOSEN,
    fill_disk,
    learning,
    met,
    OPTION,
    OTHER,
    spent,
    START,
    status,
    Table,
)


def test_the_lesson_waits_until_the_newest_demonstration_is_counted_in(table: Table) -> None:
    learning(table)
    table.lesson.update_summaries([status(last_uuid='older', met=True)])
    assert table.lesson.phase is Phase.LEARNING
    table.lesson.update_summaries([status('p2', last_uuid=table.lesson.awaited, met=True)])
    assert table.lesson.phase is Phase.LEARNING
    table.learned()
    assert table.lesson.phase is Phase.READY


def test_the_lesson_waits_until_start_states_know_of_the_demonstration(table: Table) -> None:
    table.starts.known = set()
    learning(table).learned()
    assert table.lesson.phase is Phase.LEARNING
    table.starts.known.add(table.lesson.awaited)
    table.lesson.update_option('p1', OPTION, 'what start states know of')
    assert table.lesson.phase is Phase.READY


def test_not_here_alone_teaches_start_states_nothing(table: Table) -> None:
    table.starts.known = set()
    assert table.ready().began().end(Verdict.NOT_HERE).ok
    table.learned()
    assert table.lesson.phase is Phase.READY


def test_a_learner_that_refuses_is_quoted(table: Table) -> None:
    uuid = learning(table).lesson.awaited
    table.lesson.learner_refused('another', 'not this one')
    assert table.lesson.phase is Phase.LEARNING
    table.lesson.learner_refused(uuid, 'it has no steps')
    assert table.lesson.phase is Phase.READY
    assert 'it has no steps' in table.lesson.view.text


def test_a_silent_learner_does_not_stop_the_lesson(table: Table) -> None:
    learning(table).lesson.learner_silent()
    assert table.lesson.phase is Phase.READY
    assert 'learner does not answer' in table.lesson.view.text
    assert table.shown().lesson.view.n_demonstrations == 2


def test_criteria_that_hold_finish_the_option(table: Table) -> None:
    view = met(table).lesson.view
    assert (view.phase, view.criteria_met) == (Phase.FINISHED, True)
    assert 'All criteria hold' in view.text
    assert table.ask(DefineOption('the next')).ok
    assert table.lesson.phase is Phase.ASKING
    table.ask(DefineOption(OPTION))
    assert table.lesson.phase is Phase.FINISHED


def test_a_strategy_with_something_left_to_ask_goes_on(table: Table) -> None:
    table.starts.more = True
    met(table)
    assert (table.lesson.phase, table.lesson.criteria_met) == (Phase.READY, True)
    table.starts.more = False
    table.shown()
    assert table.lesson.phase is Phase.READY  # the criteria hold no longer
    table.learned(met=True)
    assert table.lesson.phase is Phase.FINISHED


def test_a_person_is_told_why_a_lesson_goes_on_whose_criteria_hold(table: Table) -> None:
    why = 'All criteria hold, but from some starts it still fails.'
    table.starts.more = True
    assert why in met(table).lesson.view.text
    assert why in table.began().lesson.view.text
    table.starts.more = False
    table.drive('west').end()
    table.learned(met=True)
    assert table.lesson.phase is Phase.FINISHED
    assert why not in table.began().lesson.view.text  # one more, though none is needed


@pytest.mark.parametrize('not_here', [0, 2])
def test_the_budget_ends_the_lesson_whatever_the_criteria_say(table: Table, not_here: int) -> None:
    table.ready()
    for number in range(5):
        assert table.lesson.phase is Phase.READY
        table.began(START)
        verdict = Verdict.NOT_HERE if number < not_here else Verdict.DONE
        table.drive(*(() if number < not_here else ('west',)))
        assert table.end(verdict).ok
        table.learned()
    assert table.lesson.phase is Phase.FINISHED
    assert 'budget of 5 is spent. Not all criteria hold.' in table.lesson.view.text
    assert table.ask(BeginDemonstration()).status is RequestStatus.BUDGET_SPENT


def test_the_budget_counts_for_each_option(table: Table) -> None:
    spent(table)
    assert table.ask(DefineOption('another')).ok
    table.answer_all()
    assert table.lesson.phase is Phase.READY


def test_a_lesson_is_taken_up_after_a_restart_where_it_was_left(
    store: DemonstrationStore,
) -> None:
    table = Table(store).ready().shown()
    table.ask(DefineOption('half asked'))
    table.ask(AnswerQuestion(table.lesson.view.question_id, True))
    left = table.lesson.view

    resumed = Table(store)
    answer = resumed.ask(OpenSession('p1', 's1'))
    assert answer.known_options == (OPTION, 'half asked')
    assert resumed.lesson.view == replace(left, episode=0)  # nothing was begun since
    assert resumed.ask(DefineOption(OPTION)).resumed
    assert resumed.lesson.view.chosen_features == CHOSEN
    kept = resumed.began().drive('west').end().demonstration
    assert kept is not None
    assert kept.number == 2
    assert [demo.number for demo in resumed.lesson.demonstrations()] == [1, 2]


def test_how_an_option_is_learned_is_chosen_and_kept_over_a_restart(
    store: DemonstrationStore,
) -> None:
    table = Table(store).ready()
    assert table.lesson.view.method == TREES
    assert table.ask(DefineOption(OPTION, method=GOAL)).ok
    assert table.lesson.view.method == GOAL
    resumed = Table(store)
    resumed.ask(OpenSession('p1', 's1'))
    resumed.ask(DefineOption(OPTION))
    kept = resumed.began().drive('west').end().demonstration
    assert kept is not None
    assert kept.method == GOAL
    resumed.learned(met=True)  # by trees, so it says nothing of what is chosen now
    assert not resumed.lesson.criteria_met
    resumed.ask(DefineOption(OPTION, method=TREES))
    assert resumed.lesson.criteria_met
    assert resumed.ask(DefineOption('another')).ok
    assert resumed.lesson.view.method == TREES


def test_an_option_that_is_begun_is_learned_on_as_before_whatever_is_usual(
    store: DemonstrationStore,
) -> None:
    began = Table(store, method=GOAL).ready()
    assert began.began().drive('west').end().demonstration.method == GOAL
    resumed = Table(store).opened()
    resumed.ask(DefineOption(OPTION))
    assert resumed.lesson.view.method == GOAL
    resumed.ask(DefineOption('another'))
    assert resumed.lesson.view.method == TREES


def test_a_way_to_learn_that_is_not_possible_is_refused(store: DemonstrationStore) -> None:
    for table, method in ((Table(store, domain=PacMan()), GOAL), (Table(store), 'maps')):
        answer = table.opened().ask(DefineOption(OPTION, method=method))
        assert answer.status is RequestStatus.BAD_METHOD
        assert answer.detail
        assert table.lesson.phase is Phase.NO_OPTION


def test_another_session_begins_without_an_option_and_keeps_the_counts(
    store: DemonstrationStore,
) -> None:
    Table(store).ready().shown()
    resumed = Table(store)
    assert resumed.ask(OpenSession('p1', 's2')).known_options == (OPTION,)
    assert resumed.lesson.phase is Phase.NO_OPTION
    resumed.ask(DefineOption(OPTION))
    assert resumed.lesson.view.n_demonstrations == 1


def test_participants_and_domains_are_kept_apart(store: DemonstrationStore) -> None:
    Table(store).ready().shown()
    assert Table(store).ask(OpenSession('p2', 's1')).known_options == ()
    other: list[Entry] = [
        replace(demo, domain_parameters='{"rows": 9}')
        for demo in Table(store).lesson.demonstrations()
    ]
    store.append(other[0])
    assert len(Table(store).lesson.demonstrations()) == 1
    assert Table(store).defined().lesson.view.n_demonstrations == 1


def test_criteria_learned_before_a_restart_still_hold(store: DemonstrationStore) -> None:
    met(Table(store))
    resumed = Table(store)
    resumed.learned(met=True)
    resumed.opened()
    assert resumed.lesson.phase is Phase.FINISHED


def test_the_newest_demonstration_can_be_taken_back_and_shown_anew(table: Table) -> None:
    table.ready().shown()
    first = table.lesson.view.last_uuid
    table.began(OTHER).drive('west').end()
    table.learned()
    newest = table.lesson.view.last_uuid
    answer = table.ask(WithdrawDemonstration(newest))
    assert answer.ok
    assert answer.demonstration is not None
    assert (answer.demonstration.uuid, answer.demonstration.withdrawn) == (newest, True)
    view = table.lesson.view
    assert (view.phase, view.n_demonstrations, view.last_uuid) == (Phase.LEARNING, 1, first)
    table.learned()
    assert table.lesson.phase is Phase.LEARNING  # the learner has not counted it out yet
    table.lesson.update_summaries([status(last_uuid=first)])
    assert table.ask(BeginDemonstration()).state == OTHER


def test_what_was_taken_back_gives_its_place_in_the_budget_but_not_its_number(
    table: Table,
) -> None:
    spent(table)
    assert table.ask(BeginDemonstration()).status is RequestStatus.BUDGET_SPENT
    assert table.ask(WithdrawDemonstration()).ok
    table.lesson.update_summaries([])
    assert table.lesson.phase is Phase.READY
    again = table.began().drive('west').end().demonstration
    assert again is not None
    assert again.number == 6


def test_a_lesson_that_was_finished_goes_on_without_what_made_it_so(table: Table) -> None:
    met(table)
    assert table.ask(WithdrawDemonstration()).ok
    table.lesson.update_summaries([])  # the option has no demonstration left
    assert (table.lesson.phase, table.lesson.criteria_met) == (Phase.READY, False)


def test_any_demonstration_of_the_option_that_is_taught_can_be_taken_back_and_no_other(
    table: Table,
) -> None:
    table.ready().shown()
    older = table.lesson.view.last_uuid
    newest = table.shown().lesson.view.last_uuid
    table.ask(DefineOption('another'))
    assert table.ask(WithdrawDemonstration(older)).status is RequestStatus.NO_DEMONSTRATION
    table.ask(OpenSession('p2', 's1'))
    table.ask(DefineOption(OPTION))
    assert table.ask(WithdrawDemonstration(older)).status is RequestStatus.NO_DEMONSTRATION
    table.ask(OpenSession('p1', 's1'))
    table.ask(DefineOption(OPTION))
    unknown = table.ask(WithdrawDemonstration('no such'))
    assert unknown.status is RequestStatus.NO_DEMONSTRATION
    assert 'no such' in unknown.detail
    assert table.ask(WithdrawDemonstration(older)).ok
    table.lesson.update_summaries([status(n_demonstrations=2, last_uuid=newest)])
    assert table.lesson.phase is Phase.LEARNING  # the learner still counts both
    table.lesson.update_summaries([status(n_demonstrations=1, last_uuid=newest)])
    assert table.lesson.phase is Phase.READY
    assert table.ask(WithdrawDemonstration(older)).status is RequestStatus.NO_DEMONSTRATION
    assert [demo.withdrawn for demo in table.lesson.demonstrations()] == [True, False]


def test_what_was_taken_back_stays_so_after_a_restart_and_is_told_to_the_learner(
    store: DemonstrationStore,
) -> None:
    table = Table(store).ready().shown().shown()
    newest = table.lesson.view.last_uuid
    table.ask(WithdrawDemonstration())
    resumed = Table(store)
    resumed.ask(OpenSession('p1', 's1'))
    assert resumed.lesson.view.n_demonstrations == 1
    told = [(demo.uuid, demo.withdrawn) for demo in resumed.lesson.demonstrations()]
    assert told == [(resumed.lesson.view.last_uuid, False), (newest, True)]


def test_a_withdrawal_that_cannot_be_written_changes_nothing(
    table: Table, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = table.ready().shown().lesson.view
    with monkeypatch.context() as patch:
        fill_disk(patch)
        assert table.ask(WithdrawDemonstration()).status is RequestStatus.NOT_SAVED
    assert table.lesson.view == view
    assert table.ask(WithdrawDemonstration()).ok


def test_a_learner_that_does_not_take_a_withdrawal_is_quoted(table: Table) -> None:
    table.ready().shown().ask(WithdrawDemonstration())
    table.lesson.learner_refused(table.lesson.awaited, 'cannot write')
    assert table.lesson.phase is Phase.READY
    assert 'did not take the demonstration back: cannot write' in table.lesson.view.text
    table.shown().ask(WithdrawDemonstration())
    table.lesson.learner_silent()
    assert 'taken back is on disk' in table.lesson.view.text


def test_start_states_are_drawn_only_once_they_know_of_a_withdrawal(table: Table) -> None:
    table.ready().shown().shown()
    uuid = table.lesson.view.last_uuid
    table.starts.known = {uuid}
    table.ask(WithdrawDemonstration())
    table.lesson.update_summaries([])
    assert table.lesson.phase is Phase.LEARNING
    table.starts.known.clear()
    table.lesson.update_option('p1', OPTION, 'what start states know of')
    assert table.lesson.phase is Phase.READY


@pytest.mark.parametrize('how', ['silent', 'refused'])
def test_criteria_that_rest_on_what_was_taken_back_hold_no_more(table: Table, how: str) -> None:
    met(table).ask(WithdrawDemonstration())
    if how == 'silent':
        table.lesson.learner_silent()
    else:
        table.lesson.learner_refused(table.lesson.awaited, 'cannot write')
    assert (table.lesson.phase, table.lesson.criteria_met) == (Phase.READY, False)
    assert table.ask(BeginDemonstration()).ok


def test_what_was_taken_back_is_shown_anew_after_a_restart_and_another_option_too(
    store: DemonstrationStore,
) -> None:
    table = Table(store).ready().began(OTHER).drive('west')
    assert table.end().ok
    table.learned()
    table.ask(WithdrawDemonstration())
    resumed = Table(store)
    resumed.ask(OpenSession('p1', 's1'))
    resumed.ask(DefineOption('another'))
    resumed.ask(DefineOption(OPTION))
    assert resumed.began().lesson.view.start_state == OTHER
    assert resumed.drive('west').end().ok
    resumed.learned()
    assert resumed.ask(BeginDemonstration()).state != OTHER


def test_what_was_taken_back_is_shown_anew_one_by_one(table: Table) -> None:
    table.ready()
    for start in (START, OTHER):
        assert table.began(start).drive('west').end().ok
        table.learned()
    for _ in range(2):
        assert table.ask(WithdrawDemonstration()).ok
        table.lesson.update_summaries([])
    for start in (START, OTHER):
        assert table.began().lesson.view.start_state == start
        assert table.drive('west').end().ok
        table.learned()


def test_questions_that_are_asked_again_keep_what_was_chosen_before(
    store: DemonstrationStore,
) -> None:
    table = Table(store).ready()
    assert table.lesson.view.earlier_features == ()
    table.ask(DefineOption(OPTION, ask_again=True))
    table.ask(AnswerQuestion(table.lesson.view.question_id, False))
    resumed = Table(store).opened()
    assert (resumed.lesson.view.phase, resumed.lesson.view.chosen_features) == (Phase.ASKING, ())
    assert resumed.lesson.view.earlier_features == CHOSEN
    resumed.ask(DefineOption(OPTION, ask_again=True))
    assert resumed.lesson.view.earlier_features == CHOSEN
    assert resumed.answer_all().ok
    assert resumed.lesson.view.earlier_features == ()
