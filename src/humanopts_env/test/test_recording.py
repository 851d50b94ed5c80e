"""Which topics are recorded."""

from humanopts_ros.recording import Selection
import pytest


@pytest.mark.parametrize(
    ('pattern', 'topic'),
    [
        ('/lesson/state', '/lesson/state'),
        ('lesson/*', '/lesson/state'),
        ('lesson/*', '/lesson/answer/_service_event'),
        ('*/_action/feedback', '/plan/_action/feedback'),
        ('game_stat[ef]', '/game_state'),
        ('rosout', '/rosout'),
    ],
)
def test_a_pattern_is_for_the_whole_name_or_what_follows_the_namespace(
    pattern: str, topic: str
) -> None:
    assert Selection('/', include=[pattern]).wants(topic)
    assert not Selection('/', exclude=[pattern]).wants(topic)
    assert not Selection('/', include=[pattern]).wants('/another')
    assert Selection('/', exclude=[pattern]).wants('/another')


@pytest.mark.parametrize('pattern', ['lesson/*', 'room_1/lesson/*', '/room_1/lesson/*'])
def test_in_a_namespace_it_may_be_named_or_left_out(pattern: str) -> None:
    selection = Selection('/room_1', include=[pattern])
    assert selection.wants('/room_1/lesson/state')
    assert not selection.wants('/room_2/lesson/state')


def test_without_patterns_the_namespace_and_the_log_are_recorded() -> None:
    selection = Selection('/a')
    assert selection.wants('/a/game_state')
    assert selection.wants('/rosout')
    assert not selection.wants('/ab/game_state')
    assert not selection.wants('/game_state')


def test_what_is_excluded_is_not_recorded_though_it_is_included() -> None:
    selection = Selection('/', include=['lesson/*'], exclude=['*_event'])
    assert selection.wants('/lesson/state')
    assert not selection.wants('/lesson/define_option/_service_event')


@pytest.mark.parametrize(
    ('selection', 'lacking'),
    [
        (Selection('/a'), ''),
        (Selection('/a', include=['demonstrations', 'domain_info']), ''),
        (Selection('/a', exclude=['domain*']), 'domain_info will not'),
        (Selection('/a', include=['game_state']), 'demonstrations and domain_info will not'),
    ],
)
def test_a_selection_says_what_an_evaluation_would_lack(
    selection: Selection, lacking: str
) -> None:
    assert selection.unevaluable.startswith(lacking)
    assert bool(selection.unevaluable) == bool(lacking)
