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


NOTHING = 'no effect: '
GAME = (
    'pacman {} ghost {} heading {} scared {} food {} pills {} fruit none lives {} score {} ate {}'
)


@pytest.mark.parametrize(
    ('domain', 'before', 'action', 'after', 'text'),
    [
        (
            TAXI,
            'taxi 0,0 passenger R destination B',
            'pickup',
            'taxi 0,0 passenger aboard destination B',
            'picked the passenger up',
        ),
        (
            TAXI,
            'taxi 2,2 passenger R destination B',
            'pickup',
            '',
            'no effect: no passenger here',
        ),
        (
            TAXI,
            'taxi 2,2 passenger aboard destination B',
            'pickup',
            '',
            'no effect: the passenger is aboard already',
        ),
        (
            TAXI,
            'taxi 4,3 passenger aboard destination B',
            'dropoff',
            'taxi 4,3 passenger B destination B',
            'delivered the passenger',
        ),
        (
            TAXI,
            'taxi 0,0 passenger aboard destination B',
            'dropoff',
            'taxi 0,0 passenger R destination B',
            'let the passenger out at R',
        ),
        (
            TAXI,
            'taxi 2,2 passenger aboard destination B',
            'dropoff',
            '',
            'no effect: passengers get out only at R, G, Y and B',
        ),
        (
            TAXI,
            'taxi 0,0 passenger R destination B',
            'dropoff',
            '',
            'no effect: no passenger aboard',
        ),
        (TAXI, 'taxi 0,0 passenger R destination B', 'west', '', 'no effect: wall: nothing moved'),
        (TAXI, 'taxi 0,1 passenger R destination B', 'east', '', 'no effect: wall: nothing moved'),
        (
            TAXI,
            'taxi 0,0 passenger R destination B',
            'south',
            'taxi 1,0 passenger R destination B',
            'went south',
        ),
        (ROOMS, 'cell 2,3', 'left', 'cell 2,2', 'went left'),
        (ROOMS, 'cell 2,3', 'left', 'cell 1,3', 'slid up'),
        (ROOMS, 'cell 0,0', 'left', '', 'no effect: wall: nothing moved'),
        (ROOMS, 'cell 0,0', 'down', '', 'no effect: slid into a wall: nothing moved'),
        (ROOMS, 'cell 5,8', 'down', 'cell 6,8', 'went down and reached the goal'),
        (LAKE, 'row 0, col 0', 'right', 'row 1, col 0', 'slid down'),
        (LAKE, 'row 0, col 0', 'down', '', 'no effect: slid into a wall: nothing moved'),
        (LAKE, 'row 0, col 1', 'down', 'row 1, col 1', 'went down and fell into a hole'),
        (LAKE, 'row 1, col 0', 'down', 'row 1, col 1', 'slid right and fell into a hole'),
        (CLIFF, 'row 2, col 0', 'down', 'row 3, col 0', 'went down'),
        (CLIFF, 'row 2, col 5', 'down', 'row 3, col 0', 'fell off the cliff: back at the start'),
        (CLIFF, 'row 3, col 0', 'right', '', 'no effect: wall or cliff: still at the start'),
        (CLIFF, 'row 2, col 11', 'down', 'row 3, col 11', 'went down and reached the goal'),
        (
            PACMAN,
            '0,0 1,3 none 0 3 1 2 0 nothing',
            'east',
            '0,1 1,2 west 0 2 1 2 10 food',
            'ate food',
        ),
        (
            PACMAN,
            '0,0 1,3 none 0 3 1 2 0 nothing',
            'west',
            '0,0 1,2 west 0 3 1 2 0 nothing',
            'no effect: wall: Pac-Man stayed',
        ),
        (
            PACMAN,
            '0,0 1,3 none 0 3 1 2 0 nothing',
            'south',
            '1,0 1,2 west 0 3 1 2 0 nothing',
            'went south',
        ),
        (
            PACMAN,
            '0,2 1,0 none 0 1 1 2 0 nothing',
            'east',
            '0,3 1,1 none 40 1 0 2 50 power-pill',
            'ate a power pill',
        ),
        (
            PACMAN,
            '1,2 1,3 none 1 3 0 2 0 nothing',
            'east',
            '1,3 1,0 none 0 3 0 2 200 ghost',
            'ate a ghost',
        ),
        (
            PACMAN,
            '1,2 1,3 none 0 3 1 2 0 nothing',
            'east',
            '0,0 1,0 none 0 3 1 1 0 nothing',
            'lost a life: 1 left',
        ),
        (
            PACMAN,
            '1,2 1,3 none 0 3 1 1 0 nothing',
            'east',
            '0,0 1,0 none 0 3 1 0 0 nothing',
            'lost a life: it was the last',
        ),
        (
            PACMAN,
            '0,0 1,3 none 0 1 1 2 0 nothing',
            'east',
            '0,1 1,2 west 0 0 1 2 10 food',
            'ate food and cleared the maze',
        ),
    ],
    ids=lambda value: getattr(value, 'name', str(value)),
)
def test_a_step_says_what_it_did(
    domain: Domain, before: str, action: str, after: str, text: str
) -> None:
    """
    States are in the notation of their domain, those of Pac-Man what fills ``GAME``.

    :param after: empty: the state is the same.
    """
    texts = [
        GAME.format(*each.split()) if domain is PACMAN else each
        for each in (before, after or before)
    ]
    states = [domain.decode(text) for text in texts]
    index, changed = action_index(domain, action), not text.startswith(NOTHING)
    assert domain.can_follow(states[0], index, states[1])
    effect = step_effect(domain, states[0], index, states[1])
    assert effect == StepEffect(text.removeprefix(NOTHING), changed)


def test_a_domain_without_words_names_the_action() -> None:
    wordless: Any = SimpleNamespace(actions=TAXI.actions)
    assert step_effect(wordless, 3, 0, 4) == StepEffect('south')
    assert step_effect(wordless, 3, 0, 3) == StepEffect('nothing changed', changed=False)
