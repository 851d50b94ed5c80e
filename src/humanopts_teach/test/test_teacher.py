"""The simulated teacher: what it shows, how it errs, and a lesson with it in one process."""

from dataclasses import replace
from typing import Any

from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.domains.taxi import TaxiState
from humanopts_env.game import Transition
from humanopts_learner.demonstrations import version_of
from humanopts_learner.options.exam import exam_length
from humanopts_learner.options.judge import judge, Thresholds
from humanopts_teach import LessonRules, teach, TeacherSettings
from humanopts_teach.lesson.examiner import Examiner
from humanopts_teach.lesson.requests import (
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    Drive,
    EndDemonstration,
    LessonView,
    OpenSession,
    Phase,
    RunOption,
    Verdict,
)
from humanopts_teach.lesson.simulated_teacher import (
    ELSEWHERE,
    Finish,
    SimulatedTeacher,
    TeacherError,
    Wait,
    Watch,
)
import numpy as np
import pytest

TAXI = make_domain('taxi')
REFERENCES = reference_options(TAXI)
PICKUP, DROPOFF = 'go to passenger and pickup', 'go to destination and dropoff'
TEACHER = TeacherSettings(options=(PICKUP, DROPOFF))
LESSON = LessonView(Phase.READY, 'simulated', 'simulated', PICKUP)
WAITING = 'taxi 4,4 passenger R destination G'
ABOARD = 'taxi 4,4 passenger aboard destination G'
NAMES = [action.name for action in TAXI.actions]


def teacher(settings: TeacherSettings = TEACHER) -> SimulatedTeacher:
    return SimulatedTeacher(TAXI, settings)


def at(
    state: str, step: int = 0, *, terminated: bool = False, truncated: bool = False
) -> Transition:
    """Return a state of episode 1."""
    features = tuple(TAXI.feature_values(TAXI.decode(state)).tolist())
    return Transition(1, step, state, features, terminated=terminated, truncated=truncated)


def showing(state: str, option: str = PICKUP, given: int = 0) -> LessonView:
    """Return the view of a demonstration that started in ``state``."""
    return replace(
        LESSON,
        phase=Phase.DEMONSTRATING,
        option_name=option,
        n_demonstrations=given,
        start_state=state,
        episode=1,
    )


def show(
    by: SimulatedTeacher, start: str, option: str = PICKUP, given: int = 0
) -> tuple[list[str], EndDemonstration]:
    """Let the teacher demonstrate by the rules alone; return its actions and its verdict."""
    view, game, actions = showing(start, option, given), at(start), list[str]()
    while not isinstance(act := by.next_act(view, game), EndDemonstration):
        assert isinstance(act, Drive)
        assert (act.episode, act.step) == (1, game.step)
        actions.append(act.action)
        out = TAXI.step(TAXI.decode(game.state), NAMES.index(act.action), np.random.default_rng(0))
        game = at(TAXI.encode(out.state), game.step + 1, terminated=out.terminated)
    return actions, act


@pytest.mark.parametrize(
    ('lesson', 'act'),
    [
        (LessonView(Phase.NO_SESSION), OpenSession('simulated', 'simulated')),
        (replace(LESSON, participant='p9'), OpenSession('simulated', 'simulated')),
        (replace(LESSON, phase=Phase.NO_OPTION, option_name=''), DefineOption(PICKUP)),
        (replace(LESSON, option_name='something else'), DefineOption(PICKUP)),
        (
            replace(LESSON, phase=Phase.ASKING, question_id=3, question_feature='taxi_row'),
            AnswerQuestion(3, True),
        ),
        (
            replace(LESSON, phase=Phase.ASKING, question_id=4, question_feature='blocked_moves'),
            AnswerQuestion(4, False),
        ),
        (LESSON, BeginDemonstration()),
        (replace(LESSON, phase=Phase.LEARNING), Wait('the learner')),
        (showing(WAITING), Wait('the first state of the demonstration')),
        (
            replace(LESSON, paused='No space.'),
            Wait('the lesson to resume; it is paused: No space.'),
        ),
        (replace(LESSON, phase=Phase.FINISHED), DefineOption(DROPOFF)),
    ],
)
def test_each_phase_has_its_act(lesson: LessonView, act: object) -> None:
    assert teacher().next_act(lesson, Transition()) == act


def test_it_finishes_when_every_option_is_taught() -> None:
    by, finished = teacher(), replace(LESSON, phase=Phase.FINISHED)
    by.next_act(finished, Transition())
    assert by.next_act(replace(finished, option_name=DROPOFF), Transition()) == Finish()


def test_it_says_not_here_where_the_option_cannot_start_and_else_shows_a_shortest_way() -> None:
    not_here = [], EndDemonstration(Verdict.NOT_HERE, 1, 0)
    assert show(teacher(), ABOARD) == not_here
    assert show(teacher(TeacherSettings((DROPOFF,))), WAITING, DROPOFF) == not_here
    actions, end = show(teacher(), WAITING)
    assert (len(actions), end) == (9, EndDemonstration(Verdict.DONE, 1, 9))
    go = 'go to passenger'
    _, end = show(teacher(TeacherSettings((go,))), WAITING, go)
    there = TAXI.decode('taxi 0,0 passenger R destination G')
    assert end.can_start_at_end == REFERENCES[go].can_start(there)


def test_it_prefers_the_same_among_equally_good_actions_or_has_habits_of_its_own() -> None:
    actions, _ = show(teacher(), WAITING)
    assert actions[:2] == ['north', 'north']  # the domain's order; west is as good
    people = [TeacherSettings((PICKUP,), f'p{n}', own_habits=True) for n in range(12)]

    def first_acts() -> list[object]:
        views = [replace(showing(WAITING), participant=each.participant) for each in people]
        return [teacher(each).next_act(view, at(WAITING)) for each, view in zip(people, views)]

    assert first_acts() == first_acts()
    assert set(first_acts()) == {Drive('north', 1, 0), Drive('west', 1, 0)}


def test_needless_features_are_named_at_their_rate() -> None:
    liberal = teacher(replace(TEACHER, extra_feature_rate=0.5))
    needed, named, again = (
        {f.name for f in TAXI.features if by.depends_on(PICKUP, f.name)}
        for by in (teacher(), liberal, liberal)
    )
    assert needed == set(REFERENCES[PICKUP].features)
    assert needed < named == again


def test_it_errs_at_its_rate_with_every_wrong_action_alike() -> None:
    by = teacher(replace(TEACHER, error_rate=0.2))
    shown = [by.next_act(showing(WAITING, given=n), at(WAITING)) for n in range(2000)]
    actions = [act.action for act in shown if isinstance(act, Drive)]
    best = {NAMES[a] for a in REFERENCES[PICKUP].optimal_actions(TAXI.decode(WAITING))}
    wrong = [action for action in actions if action not in best]
    # 2000 draws at 0.2: mean 400, standard deviation 18; each of four actions 100, deviation 10.
    assert abs(len(wrong) - 400) < 75
    assert all(abs(wrong.count(name) - 100) < 40 for name in set(NAMES) - best)


def test_after_an_error_it_goes_on_from_where_that_led_and_a_seed_shows_the_same() -> None:
    def shown(seed: int) -> list[tuple[list[str], EndDemonstration]]:
        by = teacher(replace(TEACHER, error_rate=0.3, seed=seed))
        return [show(by, WAITING, given=n) for n in range(30)]

    one = shown(1)
    assert {len(actions) >= 9 for actions, _ in one} == {True}
    assert len({len(actions) for actions, _ in one}) > 1
    assert {end.verdict for _, end in one} == {Verdict.DONE}
    assert one == shown(1) != shown(2)


def test_what_does_not_end_is_tried_in_other_ways_then_elsewhere_until_it_gives_up() -> None:
    by = teacher(replace(TEACHER, error_rate=0.5, step_limit=3))
    first, end = show(by, WAITING)
    assert (len(first), end.verdict) == (3, Verdict.DISCARD)
    assert show(by, WAITING)[0] != first
    ready = replace(showing(WAITING), phase=Phase.READY)
    for attempt in range(3, (1 + ELSEWHERE) * TEACHER.attempts):
        assert show(by, WAITING)[1].verdict is Verdict.DISCARD
        begins = by.next_act(ready, at(WAITING, 0))
        assert isinstance(begins, BeginDemonstration)
        assert bool(begins.start_state) == (attempt >= TEACHER.attempts)
    with pytest.raises(TeacherError, match='cannot show'):
        show(by, WAITING)
    for over in ({'terminated': True}, {'truncated': True}):
        discard = EndDemonstration(Verdict.DISCARD, 1, 4)
        assert teacher().next_act(showing(WAITING), at(WAITING, 4, **over)) == discard


def test_an_end_that_an_error_led_to_is_discarded_and_tried_again() -> None:
    elsewhere = 'taxi 0,0 passenger aboard destination G'  # at R, where letting out is legal
    by = teacher(TeacherSettings((DROPOFF,), error_rate=0.5))
    first = [show(by, elsewhere, DROPOFF, given) for given in range(60)]
    let_out = {end.verdict for actions, end in first if actions == ['dropoff']}
    assert let_out == {Verdict.DISCARD}
    assert Verdict.DONE in {end.verdict for _, end in first}


@pytest.mark.parametrize(
    ('settings', 'says'),
    [
        (TeacherSettings(()), 'no option'),
        (TeacherSettings(('fly',)), "no reference option 'fly'"),
        (replace(TEACHER, error_rate=1.0), 'error_rate'),
        (replace(TEACHER, error_rate=-0.1), 'error_rate'),
        (replace(TEACHER, extra_feature_rate=float('nan')), 'extra_feature_rate'),
        (replace(TEACHER, step_limit=0), 'step_limit'),
    ],
)
def test_a_teacher_that_cannot_teach_says_why(settings: TeacherSettings, says: str) -> None:
    with pytest.raises(TeacherError, match=says):
        teacher(settings)


@pytest.mark.heavy
def test_it_teaches_until_the_criteria_hold_and_nothing_fails(taxi: Any) -> None:
    taught = teach(taxi, TeacherSettings((PICKUP,), error_rate=0.02))
    assert [option.name for option in taught.options] == [PICKUP]
    assert taught.options[0].uuids == tuple(d.uuid for d in taught.demonstrations)
    assert 10 <= len(taught.demonstrations) < LessonRules().budget
    assert (taught.cut_short, taught.seconds > 60) == ('', True)


def test_it_ends_where_the_caller_has_enough_the_budget_is_spent_or_nothing_can_be_shown(
    taxi: Any,
) -> None:
    rules = LessonRules('random', 7, until_no_failures=False)
    enough = teach(taxi, TeacherSettings((PICKUP,)), rules, lambda shown, option: len(shown) > 4)
    spent = teach(taxi, TeacherSettings((PICKUP,)), rules, lambda shown, option: False)
    assert (len(enough.demonstrations), len(spent.demonstrations)) == (5, 7)
    assert enough.demonstrations == spent.demonstrations[:5]  # by the same seeds
    taught = teach(taxi, TeacherSettings((PICKUP,), step_limit=1))
    assert 'did not reach the end' in taught.cut_short


def test_an_end_may_depend_on_the_start() -> None:
    class NextRow:
        name, features, definition = 'drive on', ('taxi_row',), ''

        def begun(self, state: TaxiState) -> 'NextRow':
            self.start = state
            return self

        def can_start(self, state: TaxiState) -> bool:
            return state.row > 0

        def ends(self, state: TaxiState) -> bool:
            return state.row == self.start.row - 1

        def optimal_actions(self, state: TaxiState) -> tuple[int, ...]:
            return (NAMES.index('north'),)

    by = SimulatedTeacher(TAXI, TeacherSettings(('drive on',)), {'drive on': NextRow()})
    shown, end = show(by, WAITING, 'drive on')
    assert (shown, end.verdict) == (['north'], Verdict.DONE)


def examined(*actions: str, start: str = WAITING, option: str = PICKUP) -> Examiner:
    """Let the examiner see a run."""
    state = TAXI.decode(start)
    found = Examiner(TAXI, REFERENCES[option], state)
    for action in actions:
        state = TAXI.step(state, NAMES.index(action), np.random.default_rng(0)).state
        found.see(state, action)
    return found


BEST = ('north', 'north', *('west',) * 4, 'north', 'north', 'pickup')  # from WAITING


@pytest.mark.parametrize(
    ('actions', 'right', 'failed', 'can_continue'),
    [
        (BEST, True, False, False),
        (BEST[:5], False, False, True),  # it stops too early
        ((*BEST, 'south'), False, True, False),  # it went on after the end
        (('north', 'south') * 4 + BEST, True, False, False),  # a detour of 8 steps
        (('north', 'south') * 5 + BEST, False, True, False),  # of 10: more than twice the steps
        (('north', 'south') * 10, False, True, True),
        ((), False, False, True),
    ],
)
def test_a_run_is_right_if_it_ends_where_the_reference_ends_within_twice_its_steps(
    actions: tuple[str, ...], right: bool, failed: bool, can_continue: bool
) -> None:
    seen = examined(*actions)
    assert (seen.right, seen.failed, seen.can_continue) == (right, failed, can_continue)


def test_a_run_from_where_the_reference_cannot_start_is_wrong_and_none_is_right() -> None:
    assert examined(start=ABOARD).right
    assert examined('south', start=ABOARD).failed


def test_with_chance_a_quarter_of_the_actions_may_be_other_than_the_best() -> None:
    domain = make_domain('pacman')
    reference = reference_options(domain)['go to the closest food']
    names, rng = [action.name for action in domain.actions], np.random.default_rng(3)

    def run(errors: int, steps: int = 12) -> bool | None:
        """Return whether a run with errors at first is right; None: it does not end in time."""
        state = domain.sample_states(rng, 1)[0]
        seen = Examiner(domain, reference, state)
        for step in range(steps):
            best = reference.optimal_actions(state)
            if not best:
                return None
            wrong = [action for action in range(len(names)) if action not in best]
            action = wrong[0] if step < errors else best[0]
            state = domain.step(state, action, rng).state
            seen.see(state, names[action])
            if reference.ends(state):
                assert seen.right == (errors <= (step + 1) / 4 or not errors)
                return seen.right
        return None

    assert {run(errors) for errors in (0, 1) for _ in range(60)} == {True, False, None}


def test_with_chance_bad_luck_is_right_and_a_wrong_end_is_not() -> None:
    domain = make_domain('rooms')
    reference = reference_options(domain)['north-west room to north doorway']
    start, other = domain.decode('cell 4,1'), domain.decode('cell 5,1')
    assert reference.ends(other)
    best, down = reference.optimal_actions(start)[0], 1
    for action, right in ((best, True), (down, False)):
        seen = Examiner(domain, reference, start)
        seen.see(other, domain.actions[action].name)
        assert seen.right == right


def test_the_examiner_watches_step_by_step_and_stops_a_run_that_has_gone_wrong() -> None:
    by = teacher()
    exam = replace(LESSON, phase=Phase.EXAM, exam_needed=5)
    assert by.next_act(exam, Transition()) == BeginDemonstration(exam=True)
    watched = replace(showing(WAITING), exam=True)
    assert by.next_act(watched, at(WAITING)) == RunOption(PICKUP, 'simulated')
    assert by.next_act(watched, at(WAITING), running=True) == Watch()
    away = 'taxi 3,4 passenger R destination G', WAITING
    for step in range(1, 19):
        assert by.next_act(watched, at(away[step % 2], step), running=True) == Watch()
    wrong = EndDemonstration(Verdict.WRONG, 1, 19, stopped=True)
    assert by.next_act(watched, at(away[1], 19), running=True) == wrong
    early = replace(wrong, step=1, stopped=False)
    by = teacher()
    by.next_act(watched, at(WAITING))
    assert by.next_act(watched, at(away[0], 1)) == early  # the run has ended


def test_it_answers_questions_about_runs_by_its_reference() -> None:
    asked = replace(LESSON, phase=Phase.CHECKING, question_id=7)
    moved = 'taxi 3,4 passenger R destination G'
    for states, right in (((ABOARD,), True), ((WAITING,), False), ((WAITING, moved), False)):
        act = teacher().next_act(replace(asked, question_states=states), Transition())
        assert act == AnswerQuestion(7, right)
    at_r = 'taxi 0,0 passenger R destination G', 'taxi 0,0 passenger aboard destination G'
    act = teacher().next_act(replace(asked, question_states=at_r), Transition())
    assert act == AnswerQuestion(7, yes=True)


def test_after_a_wrong_run_the_next_demonstration_starts_there(taxi: Any) -> None:
    """The criteria are met by anything, so that the exam finds what is wrong."""
    anything = Thresholds(0.0, 1e9, initiation_error=1.0, termination_error=1.0)
    rules = LessonRules('random', until_no_failures=False, ask_about_runs=False)
    taught = teach(taxi, TeacherSettings((PICKUP,)), rules, thresholds=anything)
    wrong = [run for run in taught.judged if not run.right]
    assert wrong
    for run in wrong:
        shown = sorted(taught.demonstrations, key=lambda demo: demo.number)
        count = next(n for n in range(60) if version_of(shown[:n]) == run.option_version)
        assert shown[count].states[0] == run.states[-1 if run.stopped else 0]
    (summary,) = taught.summaries
    assert summary.learned
    assert summary.exams_failed == len({run.option_version for run in wrong})
    assert summary.exam_runs == exam_length(5, summary.exams_failed)
    everything = [*taught.demonstrations, *taught.judged]
    assert judge(everything, taxi, anything, rules.seed) == summary  # as from a bag
