"""The simulated teacher: what it shows, how it errs, and a lesson with it in one process."""

from copy import copy
from dataclasses import replace
from typing import Any

from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.game import Transition
from humanopts_teach import LessonRules, teach, TeacherSettings
from humanopts_teach.lesson.requests import (
    AnswerQuestion,
    BeginDemonstration,
    DefineOption,
    Drive,
    EndDemonstration,
    LessonView,
    OpenSession,
    Phase,
    Verdict,
)
from humanopts_teach.lesson.simulated_teacher import (
    ATTEMPTS,
    Finish,
    SimulatedTeacher,
    TeacherError,
    Wait,
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
        (
            replace(LESSON, paused='No space.'),
            Wait('the lesson to go on; it is paused: No space.'),
        ),
        (replace(LESSON, phase=Phase.FINISHED), DefineOption(DROPOFF)),
    ],
)
def test_each_phase_has_its_act(lesson: LessonView, act: object) -> None:
    assert teacher().next_act(lesson, None) == act


def test_it_finishes_when_every_option_is_taught() -> None:
    by = teacher()
    finished = replace(LESSON, phase=Phase.FINISHED)
    by.next_act(finished, None)
    assert by.next_act(replace(finished, option_name=DROPOFF), None) == Finish()


def test_it_waits_for_the_first_state_of_the_demonstration() -> None:
    view = replace(showing(WAITING), episode=2)
    assert isinstance(teacher().next_act(view, None), Wait)
    assert isinstance(teacher().next_act(view, at(WAITING, 7)), Wait)


def test_it_says_not_here_exactly_where_the_option_cannot_start() -> None:
    assert show(teacher(), ABOARD) == ([], EndDemonstration(Verdict.NOT_HERE, 1, 0))
    assert show(teacher(TeacherSettings((DROPOFF,))), WAITING, DROPOFF) == (
        [],
        EndDemonstration(Verdict.NOT_HERE, 1, 0),
    )


def test_without_errors_it_shows_a_shortest_way_and_says_done_at_its_end() -> None:
    actions, end = show(teacher(), WAITING)
    assert sorted(actions) == ['north'] * 4 + ['pickup'] + ['west'] * 4
    assert actions[-1] == 'pickup'
    assert end == EndDemonstration(Verdict.DONE, 1, 9)


def test_an_option_that_could_start_again_at_its_end_is_said_so() -> None:
    end = show(teacher(TeacherSettings(options=('go to passenger',))), WAITING, 'go to passenger')[
        1
    ]
    reference = REFERENCES['go to passenger']
    assert end.can_start_at_end == reference.can_start(
        TAXI.decode('taxi 0,0 passenger R destination G')
    )


@pytest.mark.heavy
def test_it_always_prefers_the_same_among_equally_good_actions() -> None:
    reference, new = REFERENCES[PICKUP], teacher()
    states = TAXI.sample_states(np.random.default_rng(0), 100)
    for state in filter(reference.can_start, states):
        act = copy(new).next_act(showing(TAXI.encode(state)), at(TAXI.encode(state)))
        assert isinstance(act, Drive)
        assert act.action == NAMES[min(reference.optimal_actions(state))]


@pytest.mark.heavy
def test_own_habits_are_drawn_for_the_participant_and_kept() -> None:
    def first_act(participant: str) -> object:
        settings = TeacherSettings((PICKUP,), participant, own_habits=True)
        view = replace(showing(WAITING), participant=participant)
        return teacher(settings).next_act(view, at(WAITING))

    first = [first_act(f'p{number}') for number in range(12)]
    assert first == [first_act(f'p{number}') for number in range(12)]
    assert {act.action for act in first if isinstance(act, Drive)} == {'north', 'west'}


def test_needless_features_are_named_at_their_rate() -> None:
    plain = teacher()
    liberal = teacher(replace(TEACHER, extra_feature_rate=0.5))
    named = [f.name for f in TAXI.features if liberal.depends_on(PICKUP, f.name)]
    needed = [f.name for f in TAXI.features if plain.depends_on(PICKUP, f.name)]
    assert set(needed) == set(REFERENCES[PICKUP].features)
    assert set(needed) < set(named)
    assert named == [f.name for f in TAXI.features if liberal.depends_on(PICKUP, f.name)]


def test_it_errs_at_its_rate_with_every_wrong_action_alike() -> None:
    by = teacher(replace(TEACHER, error_rate=0.2))
    shown = [by.next_act(showing(WAITING, given=n), at(WAITING)) for n in range(2000)]
    actions = [act.action for act in shown if isinstance(act, Drive)]
    best = {NAMES[a] for a in REFERENCES[PICKUP].optimal_actions(TAXI.decode(WAITING))}
    wrong = [action for action in actions if action not in best]
    # 2000 draws at 0.2: mean 400, standard deviation 18; each of four actions 100, deviation 10.
    assert abs(len(wrong) - 400) < 75
    assert all(abs(wrong.count(name) - 100) < 40 for name in set(NAMES) - best)


def test_after_an_error_it_goes_on_from_where_that_led() -> None:
    by = teacher(replace(TEACHER, error_rate=0.3))
    lengths = [len(show(by, WAITING, given=n)[0]) for n in range(30)]
    assert min(lengths) >= 9
    assert max(lengths) > 9
    assert {show(by, WAITING, given=n)[1].verdict for n in range(30)} == {Verdict.DONE}


def test_the_same_seed_shows_the_same_and_another_seed_does_not() -> None:
    def shown(seed: int) -> list[list[str]]:
        by = teacher(replace(TEACHER, error_rate=0.3, seed=seed))
        return [show(by, WAITING, given=n)[0] for n in range(5)]

    assert shown(1) == shown(1)
    assert shown(1) != shown(2)


def test_a_demonstration_that_does_not_end_is_discarded_and_tried_another_way() -> None:
    by = teacher(replace(TEACHER, error_rate=0.5, step_limit=3))
    first, verdict = show(by, WAITING)
    assert (len(first), verdict.verdict) == (3, Verdict.DISCARD)
    assert show(by, WAITING)[0] != first


def test_an_end_that_an_error_led_to_is_discarded_and_tried_again() -> None:
    elsewhere = 'taxi 0,0 passenger aboard destination G'  # at R, where letting out is legal
    by = teacher(TeacherSettings((DROPOFF,), error_rate=0.5))
    first = [show(by, elsewhere, DROPOFF, given) for given in range(60)]
    let_out = [end.verdict for actions, end in first if actions == ['dropoff']]
    assert set(let_out) == {Verdict.DISCARD}
    assert Verdict.DONE in {end.verdict for _, end in first}


def test_it_gives_up_when_nothing_it_tries_comes_to_the_end() -> None:
    by = teacher(replace(TEACHER, step_limit=3))
    for _ in range(ATTEMPTS - 1):
        assert show(by, WAITING)[1].verdict is Verdict.DISCARD
    with pytest.raises(TeacherError, match='cannot show'):
        show(by, WAITING)


@pytest.mark.parametrize('over', ['terminated', 'truncated'])
def test_an_episode_that_is_over_too_early_is_discarded(over: str) -> None:
    game = at(WAITING, 4, terminated=over == 'terminated', truncated=over == 'truncated')
    assert teacher().next_act(showing(WAITING), game) == EndDemonstration(Verdict.DISCARD, 1, 4)


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


OPTION = 'go to passenger and pickup'


@pytest.mark.heavy
def test_it_teaches_until_the_criteria_hold_and_nothing_fails(taxi: Any) -> None:
    taught = teach(taxi, TeacherSettings((OPTION,), error_rate=0.02))
    assert [option.name for option in taught.options] == [OPTION]
    assert taught.options[0].uuids == tuple(d.uuid for d in taught.demonstrations)
    assert 10 <= len(taught.demonstrations) < LessonRules().budget
    assert (taught.cut_short, taught.seconds > 60) == ('', True)


def test_it_ends_where_the_caller_has_enough_or_the_budget_is_spent(taxi: Any) -> None:
    rules = LessonRules('random', 7, until_no_failures=False)
    enough = teach(taxi, TeacherSettings((OPTION,)), rules, lambda shown, option: len(shown) > 4)
    spent = teach(taxi, TeacherSettings((OPTION,)), rules, lambda shown, option: False)
    assert (len(enough.demonstrations), len(spent.demonstrations)) == (5, 7)
    assert enough.demonstrations == spent.demonstrations[:5]  # by the same seeds


def test_a_teacher_that_cannot_show_the_option_cuts_the_lesson_short(taxi: Any) -> None:
    with pytest.raises(TeacherError, match="no reference option 'fly'"):
        teach(taxi, TeacherSettings(('fly',)))
    taught = teach(taxi, TeacherSettings((OPTION,), step_limit=1))
    assert 'did not come to the end' in taught.cut_short
