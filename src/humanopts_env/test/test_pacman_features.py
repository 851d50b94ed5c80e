"""Pac-Man's features, their groups, and its drawing, by hand."""

from humanopts_env.domains.capabilities import feature_groups
from humanopts_env.domains.pacman.domain import PacMan
from humanopts_env.domains.pacman.games import (
    arrival_steps,
    PLANNING_FEATURES,
)
from humanopts_env.domains.pacman.paths import STAY
from humanopts_env.seeding import generator
import pytest

MAZE = """\
%%%%%%%
%P...o%
%.%%%.%
%.G  G%
%%%%%%%"""
DOMAIN = PacMan(MAZE)
START = DOMAIN.encode(DOMAIN.reset(generator(0, 'start')))
LATER = (
    'pacman 2,0 ghost 2,3 heading west scared 7 ghost 0,3 heading east scared 0 food 0d '
    'pills 0 fruit 0,1 for 3 lives 2 score 360 ate food+ghost'
)


def features_of(text: str) -> dict[str, str]:
    """Return how each feature of a state reads to a person."""
    values = DOMAIN.feature_values(DOMAIN.decode(text))
    return {f.name: f.text(value) for f, value in zip(DOMAIN.features, values)}


def test_features_of_the_start() -> None:
    """Both food beside Pac-Man are nearest: the one in the row above comes first."""
    assert features_of(START) == {
        'pacman_row': '0',
        'pacman_col': '0',
        'ghost_1_row': '2',
        'ghost_1_col': '1',
        'ghost_1_direction': 'south',
        'ghost_1_distance': '3',
        'ghost_1_scared': 'no',
        'ghost_2_row': '2',
        'ghost_2_col': '4',
        'ghost_2_direction': 'east',
        'ghost_2_distance': '6',
        'ghost_2_scared': 'no',
        'food_row': '0',
        'food_col': '1',
        'food_direction': 'east',
        'food_distance': '1',
        'pill_row': '0',
        'pill_col': '4',
        'pill_direction': 'east',
        'pill_distance': '4',
        'fruit_row': 'none',
        'fruit_col': 'none',
        'fruit_direction': 'none',
        'fruit_distance': 'none',
        'danger_direction': 'south',
        'danger_distance': '3',
        'prey_direction': 'none',
        'prey_distance': 'none',
        'ate': 'nothing',
        'legal_moves': 'east and south',
    }


def test_features_of_a_later_state() -> None:
    """No pill is left, one ghost is scared, and the last step ate two things."""
    values = features_of(LATER)
    assert (values['ghost_1_scared'], values['ghost_2_scared']) == ('7 steps', 'no')
    assert (values['prey_direction'], values['prey_distance']) == ('east', '3')
    assert (values['danger_direction'], values['danger_distance']) == ('north', '5')
    assert {values[f'pill_{part}'] for part in ('row', 'col', 'direction', 'distance')} == {'none'}
    assert [values[f'food_{part}'] for part in ('row', 'col', 'direction')] == ['1', '0', 'north']
    fruit = [values[f'fruit_{part}'] for part in ('row', 'col', 'direction', 'distance')]
    assert fruit == ['0', '1', 'north', '3']
    assert values['ate'] == 'food and ghost'


def test_the_papers_list_is_positions_and_timers() -> None:
    """No direction, distance or wall; every value is that of the full list."""
    named = PacMan(MAZE, features='paper')
    places = ('pacman', 'ghost_1', 'ghost_2', 'food', 'pill', 'fruit')
    wanted = {f'{place}_{axis}' for place in places for axis in ('row', 'col')}
    names = [feature.name for feature in named.features]
    assert set(names) == {*wanted, 'ghost_1_scared', 'ghost_2_scared', 'ate'}
    for text in (START, LATER):
        values = named.feature_values(named.decode(text))
        said = {f.name: f.text(value) for f, value in zip(named.features, values)}
        assert said == {name: features_of(text)[name] for name in names}


def buckets_of(text: str) -> dict[str, int]:
    """Return the planning features of one state."""
    values = DOMAIN.games([DOMAIN.decode(text)]).planning_features()[0].tolist()
    return dict(zip(PLANNING_FEATURES, values))


def test_planning_features_by_hand() -> None:
    """A ghost is 3 steps away, and 4 from either cell beside Pac-Man; the pill is 4 away."""
    assert buckets_of(START) == {
        'danger': 2,  # 3
        'danger_to_food': 3,  # 4 to 5
        'danger_to_pill': 3,  # 4 or more
        'danger_to_prey': 0,  # none
        'danger_in_flight': 3,  # 4 to 5
        'food_distance': 0,  # 1
        'pill_distance': 2,  # 4 to 6
        'prey_distance': 5,  # none
        'prey_time': 0,  # none
        'danger_to_fruit': 0,  # none
        'fruit_distance': 3,  # none
        'food_left': 1,  # 6 to 35
        'pills_left': 1,
        'lives': 1,  # 2 or more
    }
    later = buckets_of(LATER)
    assert (later['prey_distance'], later['prey_time']) == (1, 2)  # 2 to 3; 7 - 3 = 4
    assert (later['pill_distance'], later['pills_left']) == (5, 0)  # none
    assert (later['fruit_distance'], later['food_left']) == (0, 0)  # 3; 3
    assert later['danger_to_fruit'] == 3  # 4 or more


@pytest.mark.parametrize(('heading', 'bucket'), [('east', 4), ('west', 3), ('none', 3)])
def test_a_ghost_that_has_passed_is_as_far_away_as_it_must_go(heading: str, bucket: int) -> None:
    """To the cell 5 steps west of it a ghost that heads east goes 7 steps, all the way round."""
    text = LATER.replace('ghost 0,3 heading east', f'ghost 0,3 heading {heading}')
    assert buckets_of(text)['danger'] == bucket


def test_nobody_arrives_sooner_than_by_a_shortest_path() -> None:
    """Without a heading a ghost comes by a shortest path; with one, no sooner."""
    for maze in ('gardens', 'yard', MAZE):
        paths = PacMan(maze).rules.paths
        steps = arrival_steps(paths)
        assert (steps[:, STAY] == paths.distance).all()
        assert (steps >= paths.distance[:, None]).all()


def test_pac_mans_features_are_grouped_by_the_thing_that_they_are_about() -> None:
    groups = {group.words: group.features for group in feature_groups(PacMan())}
    assert list(groups) == ['Pac-Man', 'the ghosts', 'the food', 'the power pills', 'the fruit']
    assert groups['Pac-Man'] == ('pacman_row', 'pacman_col', 'legal_moves')
    assert groups['the food'] == ('food_row', 'food_col', 'food_direction', 'food_distance')
    ghosts = ('ghost_1_scared', 'ghost_2_direction', 'danger_distance', 'prey_direction')
    assert set(ghosts) <= set(groups['the ghosts'])
    grouped = {name for names in groups.values() for name in names}
    assert {feature.name for feature in PacMan().features} - grouped == {'ate'}
