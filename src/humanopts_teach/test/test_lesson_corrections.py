"""What a person mends: watched options, contradictions, answers, names; pure."""

from pathlib import Path

from humanopts_env.game import Source
from humanopts_learner.demonstrations import Kind
from humanopts_learner.options.learn import learn_option
from humanopts_teach.lesson.requests import (
    AnswerQuestion,
    BeginDemonstration,
    ChangeOption,
    DefineOption,
    EndDemonstration,
    ListDemonstrations,
    OpenSession,
    Phase,
    RequestStatus,
    Verdict,
    WithdrawDemonstration,
)
from humanopts_teach.lesson.store import DemonstrationStore
import pytest
from teach_support.lesson import (
    CHOSEN,
    fill_disk,
    met,
    OPTION,
    START,
    Table,
    TAXI,
)

MACHINE = Source.MACHINE
NEW = 'fetch the passenger'


def watched(table: Table) -> Table:
    """Watch the machine take two steps from a chosen start."""
    table.ready().began(START, watch=True)
    return table.drive('west', 'east', source=MACHINE)


def test_a_correction_begins_where_the_person_took_over_unless_the_steps_before_count(
    table: Table,
) -> None:
    watched(table)
    assert (table.lesson.view.machine_steps, table.lesson.phase) == (2, Phase.DEMONSTRATING)
    table.drive('south', 'west')
    assert table.lesson.view.machine_steps == 2
    kept = table.end().demonstration
    assert kept is not None
    assert (kept.actions, kept.machine_steps) == (('south', 'west'), 0)
    assert (len(kept.states), kept.states[0]) == (3, START)  # west and east led back
    table.learned()
    table.began(START, watch=True).drive('west', source=MACHINE).drive('south')
    whole = table.end(machine=True).demonstration
    assert whole is not None
    assert (whole.actions, whole.machine_steps) == (('west', 'south'), 1)
    assert table.lesson.demonstrations() == [kept, whole]


def test_the_same_steps_are_another_demonstration_where_the_machine_took_them(
    tmp_path: Path,
) -> None:
    def uuid(source: Source) -> str:
        with DemonstrationStore(tmp_path / source.name) as store:
            table = Table(store).ready().began(START, watch=True)
            kept = table.drive('west', source=source).drive('south').end(machine=True)
            return kept.uuid

    assert uuid(Source.PERSON) != uuid(MACHINE)


def test_a_machine_that_moves_after_the_person_ends_a_correction(table: Table) -> None:
    watched(table).drive('south').drive('south', source=MACHINE)
    assert table.lesson.phase is Phase.READY
    assert 'option or a policy moved' in table.lesson.view.text


def test_a_run_that_is_watched_to_its_end_counts_only_if_the_person_says_so(
    table: Table,
) -> None:
    watched(table)
    assert table.end().status is RequestStatus.NO_STEPS
    kept = table.end(machine=True).demonstration
    assert kept is not None
    assert (kept.actions, kept.machine_steps) == (('west', 'east'), 2)


def test_a_start_that_the_machine_should_not_start_from_is_not_here(table: Table) -> None:
    kept = watched(table).end(Verdict.NOT_HERE).demonstration
    assert kept is not None
    assert (kept.kind, kept.states, kept.machine_steps) == (Kind.NOT_HERE, (START,), 0)
    table.learned()
    table.began(START, watch=True).drive('west', source=MACHINE).drive('south')
    assert table.end(Verdict.NOT_HERE).status is RequestStatus.STEPS_TAKEN


def test_a_start_that_was_watched_and_discarded_is_not_asked_for(table: Table) -> None:
    watched(table).end(Verdict.DISCARD)
    drawn = table.ask(BeginDemonstration()).state
    assert drawn == Table(table.store).opened().ask(BeginDemonstration()).state


def test_a_finished_lesson_takes_another_demonstration_while_the_budget_lasts(
    table: Table,
) -> None:
    met(table)
    table.began(START).drive('west')
    assert table.end().ok
    table.learned(met=True)
    view = table.lesson.view
    assert (view.phase, view.n_demonstrations) == (Phase.FINISHED, 2)


def test_going_back_opens_the_question_before_again(table: Table) -> None:
    table.defined()
    first = table.lesson.view
    table.ask(AnswerQuestion(first.question_id, yes=True))
    second = table.lesson.view
    assert second.chosen_features == (first.question_feature,)
    assert table.ask(AnswerQuestion(second.question_id, back=True)).ok
    again = table.lesson.view
    assert (again.question_feature, again.chosen_features) == (first.question_feature, ())
    assert again.question_id > second.question_id
    stale = table.ask(AnswerQuestion(second.question_id, back=True))
    assert stale.status is RequestStatus.NOT_ASKED
    none = table.ask(AnswerQuestion(again.question_id, back=True))
    assert none.status is RequestStatus.NOT_ASKED
    assert Table(table.store).opened().lesson.view.question_feature == first.question_feature


def test_the_last_answer_can_be_taken_back_once_all_are_given(table: Table) -> None:
    table.ready()
    assert table.ask(AnswerQuestion(0, back=True)).ok
    view = table.lesson.view
    assert (view.phase, view.question_feature) == (Phase.ASKING, TAXI.features[-1].name)
    assert view.chosen_features == CHOSEN


def test_a_list_holds_what_was_taken_back_too_and_only_of_that_option_and_person(
    table: Table,
) -> None:
    table.ready().shown().shown()
    first, second = table.lesson.demonstrations()
    table.ask(WithdrawDemonstration(first.uuid))
    listed = table.ask(ListDemonstrations()).demonstrations
    assert [(d.uuid, d.withdrawn) for d in listed] == [(first.uuid, True), (second.uuid, False)]
    table.ask(DefineOption('another'))
    assert table.ask(ListDemonstrations()).demonstrations == ()
    assert table.ask(ListDemonstrations(OPTION)).demonstrations == listed
    assert table.ask(ListDemonstrations('unknown')).status is RequestStatus.NO_OPTION
    table.ask(OpenSession('p2', 's1'))
    assert table.ask(ListDemonstrations(OPTION)).status is RequestStatus.NO_OPTION


def test_a_renamed_option_is_the_same_under_its_new_name_also_after_a_restart(
    table: Table,
) -> None:
    table.ready().shown().shown()
    before = table.lesson.demonstrations()
    answer = table.ask(ChangeOption(OPTION, NEW))
    assert answer.ok
    assert answer.known_options == (NEW,)
    moved, taken = answer.unsent[:2], answer.unsent[2:]
    assert [(d.uuid, d.withdrawn) for d in taken] == [(d.uuid, True) for d in before]
    for old, new in zip(before, moved):
        assert (new.option_name, new.states, new.actions) == (NEW, old.states, old.actions)
        assert not new.withdrawn
    assert {d.uuid for d in moved}.isdisjoint(d.uuid for d in before)
    view = table.lesson.view
    assert (view.option_name, view.chosen_features) == (NEW, CHOSEN)
    assert (view.phase, view.n_demonstrations) == (Phase.LEARNING, 2)
    resumed = Table(table.store).opened().lesson.view
    assert (resumed.option_name, resumed.n_demonstrations) == (NEW, 2)
    assert learn_option(moved, TAXI, 0).n_demonstrations == 2


def test_a_name_can_be_given_back_and_no_uuid_is_used_twice(table: Table) -> None:
    table.ready().shown()
    for old, new in ((OPTION, NEW), (NEW, OPTION)):
        assert table.ask(ChangeOption(old, new)).ok
        table.lesson.learner_silent()
    counted = [demo for demo in table.lesson.demonstrations() if not demo.withdrawn]
    assert [(demo.option_name, demo.number) for demo in counted] == [(OPTION, 2)]
    assert table.lesson.view.n_demonstrations == 1


@pytest.mark.parametrize(
    ('name', 'new', 'answered'),
    [
        (OPTION, OPTION, RequestStatus.NAME_TAKEN),
        (OPTION, ' another ', RequestStatus.NAME_TAKEN),
        (OPTION, '  ', RequestStatus.BAD_NAME),
        (OPTION, 'x' * 61, RequestStatus.BAD_NAME),
        (OPTION, 'action:north', RequestStatus.BAD_NAME),
        ('unknown', NEW, RequestStatus.NO_OPTION),
        ('unknown', '', RequestStatus.NO_OPTION),
    ],
)
def test_a_change_that_cannot_be_made_changes_nothing(
    table: Table, name: str, new: str, answered: RequestStatus
) -> None:
    table.defined()
    table.ask(DefineOption('another'))
    table.ask(DefineOption(OPTION))
    entries, view = table.store.entries('p1'), table.lesson.view
    assert table.ask(ChangeOption(name, new)).status is answered
    assert (table.store.entries('p1'), table.lesson.view) == (entries, view)


def test_a_rename_that_cannot_be_written_changes_nothing(
    table: Table, monkeypatch: pytest.MonkeyPatch
) -> None:
    table.ready().shown()
    before = table.lesson.demonstrations()
    with monkeypatch.context() as patch:
        fill_disk(patch)
        assert table.ask(ChangeOption(OPTION, NEW)).status is RequestStatus.NOT_SAVED
    assert table.lesson.demonstrations() == before
    assert table.lesson.view.option_name == OPTION


def test_a_deleted_option_leaves_its_demonstrations_withdrawn_and_its_name_free(
    table: Table,
) -> None:
    table.ready().shown()
    (shown,) = table.lesson.demonstrations()
    answer = table.ask(ChangeOption(OPTION))
    assert answer.known_options == ()
    assert [(d.uuid, d.withdrawn) for d in answer.unsent] == [(shown.uuid, True)]
    assert table.lesson.phase is Phase.NO_OPTION
    assert table.lesson.demonstrations()[0].withdrawn
    assert Table(table.store).opened().lesson.phase is Phase.NO_OPTION
    again = table.ask(DefineOption(OPTION))
    assert (again.resumed, table.lesson.phase) == (False, Phase.ASKING)
    table.answer_all()
    kept = table.began(START).drive('west').end().demonstration
    assert kept is not None
    assert kept.number == 2  # the first number is that of what was deleted


def test_an_option_of_somebody_else_cannot_be_deleted(table: Table) -> None:
    table.ready().shown()
    table.ask(OpenSession('p2', 's1'))
    assert table.ask(ChangeOption(OPTION)).status is RequestStatus.NO_OPTION
    assert not table.lesson.demonstrations()[0].withdrawn


def aboard_too(table: Table) -> Table:
    """Let the option depend on whether the passenger is aboard, too."""
    table.defined().answer_all((*CHOSEN, 'passenger_in_taxi'))
    return table


def test_another_way_in_the_same_situation_is_told_with_the_demonstration_that_showed_it(
    table: Table,
) -> None:
    aboard_too(table).began(START).drive('west', 'pickup')
    first = table.end().demonstration
    assert first is not None
    table.learned()
    table.began(START).drive('south', 'west', 'north', 'pickup')
    answer = table.end()
    assert answer.ok
    assert 'now south, in demonstration 1 west' in answer.contradiction
    assert (answer.contradicts, answer.situation) == (first.uuid, START)


def test_an_end_that_was_passed_by_before_is_told_before_a_way(table: Table) -> None:
    aboard_too(table).began(START).drive('west', 'pickup').end()
    table.learned()
    answer = table.began(START).drive('west').end()
    assert 'now the end, in demonstration 1 not the end' in answer.contradiction
    assert answer.situation == 'taxi 0,0 passenger R destination G'


def test_what_was_shown_in_two_ways_already_contradicts_nothing(table: Table) -> None:
    aboard_too(table)
    for steps in (('west', 'pickup'), ('south', 'west', 'north', 'pickup')):
        table.began(START).drive(*steps).end()
        table.learned()
    assert table.began(START).drive('west', 'pickup').end().contradiction == ''


def test_by_goal_ways_contradict_nothing_and_ends_do(table: Table) -> None:
    aboard_too(table)
    table.ask(DefineOption(OPTION, method='goal'))
    table.began(START).drive('west', 'pickup').end()
    table.learned()
    assert not table.began(START).drive('south', 'west', 'north', 'pickup').end().contradiction
    table.learned()
    assert 'the end' in table.began(START).drive('west').end().contradiction


def test_not_here_contradicts_a_start_that_was_shown(table: Table) -> None:
    aboard_too(table).began(START).drive('west', 'pickup').end()
    table.learned()
    answer = table.began(START).end(Verdict.NOT_HERE)
    assert 'now cannot start here, in demonstration 1 can start here' in answer.contradiction
    assert answer.situation == START


def test_what_is_deleted_contradicts_nothing(table: Table) -> None:
    aboard_too(table).began(START).drive('west', 'pickup').end()
    table.learned()
    assert table.ask(WithdrawDemonstration()).ok
    table.lesson.update_summaries([])
    assert not table.began(START).drive('south', 'north').end().contradiction


def test_a_verdict_that_counts_machine_steps_where_there_are_none_changes_nothing(
    table: Table,
) -> None:
    aboard_too(table).began(START).drive('west')
    kept = table.end(machine=True).demonstration
    assert kept is not None
    assert (kept.actions, kept.machine_steps) == (('west',), 0)
    assert EndDemonstration(Verdict.DONE, 1, 1) == EndDemonstration(Verdict.DONE, 1, 1, False)
