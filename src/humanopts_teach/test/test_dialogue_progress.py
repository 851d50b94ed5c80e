"""What the person is told of the criteria, and of rows that contradict each other."""

from dataclasses import replace

from humanopts_learner.demonstrations import GOAL
from humanopts_learner.options.criteria import Criterion, FEWEST
from humanopts_teach.lesson.requests import Phase
from teach_support.person import criteria, Person


def test_each_criterion_shows_value_target_and_whether_it_can_be_measured(
    shower: Person,
) -> None:
    shower.world.progress = [
        criteria(('return', 0.25, 1.0), ('initiation', 0.125, 0.05), ('termination', None, 0.05))
    ]
    screen = shower.sees()
    for line in (
        'By trees, on starts it has not seen:',
        '✓ return       0.25 worse    ≤ 1.00',
        '· initiation   12.5 % wrong  ≤ 5.0 %',
        '· termination  not measured  ≤ 5.0 %',
        'Perhaps 1 to 18 more are needed.',
    ):
        assert line in screen


def test_a_criterion_whose_limit_is_too_large_is_not_yet_known(shower: Person) -> None:
    few = (Criterion('return', 0.25, 1.0, met=False),)
    shower.world.progress = [replace(criteria(), criteria=few)]
    assert '? return  0.25 worse  ≤ 1.00' in shower.sees()
    assert shower.sees_words(
        'Perhaps 1 to 18 more are needed: return is not yet known well enough.'
    )


def test_an_estimate_that_cannot_be_made_is_not_made(shower: Person) -> None:
    shower.world.progress = [criteria(('return', 0.0, 1.0), more_needed=-1)]
    assert 'How many more it takes cannot be told yet.' in shower.sees()


def test_a_person_is_told_why_a_lesson_goes_on_whose_criteria_hold(shower: Person) -> None:
    shower.world.progress = [criteria(('return', 0.0, 1.0), criteria_met=True)]
    assert shower.sees_words('All criteria hold, but from some starts it still fails.')
    shower.lesson(Phase.FINISHED)
    assert shower.sees_words('All criteria hold. ')


def test_a_person_is_told_when_the_criteria_will_be_measured(shower: Person) -> None:
    few = {'n_demonstrations': FEWEST - 1, 'more_needed': -1}
    shower.world.progress = [criteria(('return', None, 1.0), **few)]
    assert f'Measured from {FEWEST} demonstrations on.' in shower.sees()


def test_a_planned_policy_is_named_and_measured_sooner(shower: Person) -> None:
    shower.lesson(Phase.DEMONSTRATING, method=GOAL)
    progress = replace(criteria(('return', None, 1.0)), n_demonstrations=2, more_needed=-1)
    shower.world.progress = [progress]
    assert shower.sees_words('These are for the earlier answers: show one more.')
    shower.world.progress = [replace(progress, method=GOAL)]
    assert not shower.sees_words('These are for the earlier answers')
    assert shower.sees_words('policy planned: best ways to an end like the shown ones')
    assert shower.sees_words('By goal, on starts it has not seen:')
    assert shower.sees_words('Measured from 3 demonstrations on.')
    shower.world.progress = [
        replace(progress, method=GOAL, n_demonstrations=5, more_needed=4),
    ]
    assert shower.sees_words('How many more it takes cannot be told yet.')


def test_conflicts_come_with_the_feature_that_would_tell_them_apart(shower: Person) -> None:
    progress = criteria(('return', 0.0, 1.0))
    clash = 'taxi row 0: pickup, but also east'
    shower.world.progress = [
        replace(progress, conflicts=(clash, 'more'), suggested_feature='passenger_in_taxi')
    ]
    assert shower.sees_words(clash)
    assert shower.sees_words('Add "passenger in taxi" (e): it tells most apart.')


def test_a_start_that_contradicts_an_end_is_explained_by_a_key(shower: Person) -> None:
    words = (
        'If the last one was a slip, delete it (l). '
        'Where an end can be a start, press s before done.'
    )
    shower.world.progress = [replace(criteria(), conflicts=('taxi row 4: the end (2x)',))]
    assert not shower.sees_words(words)
    conflict = 'taxi row 4: cannot start here (2x), can start here (1x)'
    shower.world.progress = [replace(criteria(), conflicts=('another', conflict))]
    assert shower.sees_words(words)
    missing = replace(shower.world.progress[0], suggested_feature='passenger_in_taxi')
    shower.world.progress = [missing]
    assert not shower.sees_words(words)
