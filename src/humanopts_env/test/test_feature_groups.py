"""Groups of features: what a person is asked about first."""

from humanopts_env.domains.capabilities import feature_groups
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.registry import make_domain


def test_pac_mans_features_are_grouped_by_the_thing_that_they_are_about() -> None:
    groups = {group.words: group.features for group in feature_groups(PacMan())}
    assert list(groups) == ['Pac-Man', 'the ghosts', 'the food', 'the power pills', 'the fruit']
    assert groups['Pac-Man'] == ('pacman_row', 'pacman_col', 'legal_moves')
    assert groups['the food'] == ('food_row', 'food_col', 'food_direction', 'food_distance')
    ghosts = ('ghost_1_scared', 'ghost_2_direction', 'danger_distance', 'prey_direction')
    assert set(ghosts) <= set(groups['the ghosts'])
    grouped = {name for names in groups.values() for name in names}
    assert {feature.name for feature in PacMan().features} - grouped == {'ate'}


def test_groups_have_only_features_of_the_game() -> None:
    paper = {group.words: group.features for group in feature_groups(PacMan(features='paper'))}
    assert paper['Pac-Man'] == ('pacman_row', 'pacman_col')
    lonely = PacMan(maze='%%%%%\n%P..%\n%%%%%')
    assert 'ghost_1_row' not in {feature.name for feature in lonely.features}
    named = [group.words for group in feature_groups(lonely)]
    assert named[0] == 'Pac-Man'


def test_a_domain_need_not_have_groups() -> None:
    assert feature_groups(make_domain('taxi')) == ()
