"""What a step did, in words: single steps by hand, in every domain of the package."""

from types import SimpleNamespace
from typing import Any

from humanopts_env.domains.base import action_index, Domain
from humanopts_env.domains.capabilities import step_effect, StepEffect
from humanopts_env.domains.registry import make_domain
import pytest

TAXI = make_domain('taxi')
ROOMS = make_domain('rooms')
PACMAN = make_domain('pacman', {'maze': '%%%%%%\n%P..o%\n%1   %\n%%%%%%', 'lives': 2})
LAKE = make_domain('gymnasium:FrozenLake-v1')
CLIFF = make_domain('gymnasium:CliffWalking-v1')
SLIPPERY_CLIFF = make_domain('gymnasium:CliffWalking-v1', {'is_slippery': True})
GYM_TAXI = make_domain('gymnasium:Taxi-v4')


def effect(domain: Domain[Any], before: str, action: str, after: str) -> StepEffect:
    """Return the effect of a step between two states in the domain's notation."""
    states = domain.decode(before), domain.decode(after)
    index = action_index(domain, action)
    assert domain.can_follow(states[0], index, states[1])
    return step_effect(domain, states[0], index, states[1])


def taxi(place: str, passenger: str) -> str:
    return f'taxi {place} passenger {passenger} destination B'


@pytest.mark.parametrize(
    ('before', 'action', 'after', 'expected'),
    [
        (('0,0', 'R'), 'pickup', ('0,0', 'aboard'), StepEffect('picked the passenger up')),
        (('2,2', 'R'), 'pickup', ('2,2', 'R'), StepEffect('nobody here to pick up', False)),
        (
            ('2,2', 'aboard'),
            'pickup',
            ('2,2', 'aboard'),
            StepEffect('the passenger is aboard already', False),
        ),
        (('4,3', 'aboard'), 'dropoff', ('4,3', 'B'), StepEffect('delivered the passenger')),
        (('0,0', 'aboard'), 'dropoff', ('0,0', 'R'), StepEffect('let the passenger out at R')),
        (
            ('2,2', 'aboard'),
            'dropoff',
            ('2,2', 'aboard'),
            StepEffect('passengers get out only at R, G, Y and B', False),
        ),
        (('0,0', 'R'), 'dropoff', ('0,0', 'R'), StepEffect('nobody aboard to let out', False)),
        (('0,0', 'R'), 'west', ('0,0', 'R'), StepEffect('wall: nothing moved', False)),
        (('0,1', 'R'), 'east', ('0,1', 'R'), StepEffect('wall: nothing moved', False)),
        (('0,0', 'R'), 'south', ('1,0', 'R'), StepEffect('went south')),
    ],
    ids=lambda value: getattr(value, 'name', str(value)),
)
def test_every_step_of_taxi_says_what_it_did(
    before: tuple[str, str], action: str, after: tuple[str, str], expected: StepEffect
) -> None:
    assert effect(TAXI, taxi(*before), action, taxi(*after)) == expected


def test_gymnasiums_taxi_says_the_same_as_ours() -> None:
    assert [a.name for a in GYM_TAXI.actions] == [a.name for a in TAXI.actions]
    for number in range(0, 500, 7):
        for action in range(len(TAXI.actions)):
            if not (TAXI.is_over(TAXI.state_at(number)) or GYM_TAXI.is_over(number)):
                to = int(TAXI.transitions().successor[number, action, 0])
                ours = step_effect(TAXI, TAXI.state_at(number), action, TAXI.state_at(to))
                assert step_effect(GYM_TAXI, number, action, to) == ours


@pytest.mark.parametrize(
    ('before', 'action', 'after', 'expected'),
    [
        ('2,3', 'left', '2,2', StepEffect('went left')),
        ('2,3', 'left', '1,3', StepEffect('slid up')),
        ('0,0', 'left', '0,0', StepEffect('wall: nothing moved', False)),
        ('0,0', 'down', '0,0', StepEffect('slid into a wall: nothing moved', False)),
        ('5,8', 'down', '6,8', StepEffect('went down and reached the goal')),
    ],
)
def test_a_slip_in_the_rooms_is_told(
    before: str, action: str, after: str, expected: StepEffect
) -> None:
    assert effect(ROOMS, f'cell {before}', action, f'cell {after}') == expected


def grid(place: str) -> str:
    row, col = place.split(',')
    return f'row {row}, col {col}'


@pytest.mark.parametrize(
    ('domain', 'before', 'action', 'after', 'expected'),
    [
        (LAKE, '0,0', 'right', '0,1', StepEffect('went right')),
        (LAKE, '0,0', 'right', '1,0', StepEffect('slid down')),
        (LAKE, '0,0', 'left', '0,0', StepEffect('wall: nothing moved', False)),
        (LAKE, '0,0', 'down', '0,0', StepEffect('slid into a wall: nothing moved', False)),
        (LAKE, '0,1', 'down', '1,1', StepEffect('went down and fell into a hole')),
        (LAKE, '1,0', 'down', '1,1', StepEffect('slid right and fell into a hole')),
        (LAKE, '3,2', 'right', '3,3', StepEffect('went right and reached the goal')),
        (CLIFF, '2,0', 'down', '3,0', StepEffect('went down')),
        (CLIFF, '2,5', 'down', '3,0', StepEffect('fell off the cliff: back at the start')),
        (
            CLIFF,
            '3,0',
            'right',
            '3,0',
            StepEffect('fell off the cliff: back at the start', False),
        ),
        (CLIFF, '3,0', 'left', '3,0', StepEffect('wall: nothing moved', False)),
        (CLIFF, '2,11', 'down', '3,11', StepEffect('went down and reached the goal')),
        (
            SLIPPERY_CLIFF,
            '3,0',
            'right',
            '3,0',
            StepEffect('wall or cliff: still at the start', False),
        ),
    ],
    ids=lambda value: getattr(value, 'name', str(value)),
)
def test_slips_holes_and_falls_of_gymnasiums_grids_are_told(
    domain: Domain[Any], before: str, action: str, after: str, expected: StepEffect
) -> None:
    assert effect(domain, grid(before), action, grid(after)) == expected


def pacman(row_col: str, ghost: str, food: str, pills: str, **rest: Any) -> str:
    scared, lives = rest.get('scared', 0), rest.get('lives', 2)
    heading, score = rest.get('heading', 'none'), rest.get('score', 0)
    return (
        f'pacman {row_col} ghost {ghost} heading {heading} scared {scared} food {food} '
        f'pills {pills} fruit none lives {lives} score {score} ate {rest.get("ate", "nothing")}'
    )


START = pacman('0,0', '1,3', '3', '1')


@pytest.mark.parametrize(
    ('before', 'action', 'after', 'expected'),
    [
        (
            START,
            'east',
            pacman('0,1', '1,2', '2', '1', heading='west', ate='food', score=10),
            StepEffect('ate food'),
        ),
        (
            START,
            'west',
            pacman('0,0', '1,2', '3', '1', heading='west'),
            StepEffect('wall: Pac-Man stayed', False),
        ),
        (
            START,
            'south',
            pacman('1,0', '1,2', '3', '1', heading='west'),
            StepEffect('went south'),
        ),
        (
            pacman('0,2', '1,0', '1', '1'),
            'east',
            pacman('0,3', '1,1', '1', '0', scared=40, ate='power-pill', score=50),
            StepEffect('ate a power pill'),
        ),
        (
            pacman('1,2', '1,3', '3', '0', scared=1),
            'east',
            pacman('1,3', '1,0', '3', '0', ate='ghost', score=200),
            StepEffect('ate a ghost'),
        ),
        (
            pacman('1,2', '1,3', '3', '1'),
            'east',
            pacman('0,0', '1,0', '3', '1', lives=1),
            StepEffect('lost a life: 1 left'),
        ),
        (
            pacman('1,2', '1,3', '3', '1', lives=1),
            'east',
            pacman('0,0', '1,0', '3', '1', lives=0),
            StepEffect('lost a life: it was the last'),
        ),
        (
            pacman('0,0', '1,3', '1', '1'),
            'east',
            pacman('0,1', '1,2', '0', '1', heading='west', ate='food', score=10),
            StepEffect('ate food and cleared the maze'),
        ),
    ],
)
def test_meals_walls_and_lost_lives_of_pac_man_are_told(
    before: str, action: str, after: str, expected: StepEffect
) -> None:
    assert effect(PACMAN, before, action, after) == expected


def test_a_domain_without_words_names_the_action() -> None:
    wordless: Any = SimpleNamespace(actions=TAXI.actions)
    assert step_effect(wordless, 3, 0, 4) == StepEffect('south')
    assert step_effect(wordless, 3, 0, 3) == StepEffect('nothing changed', changed=False)
