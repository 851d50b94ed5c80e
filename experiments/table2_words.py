"""What the report says of Table 2: the paper's statements, and our goals, computed."""

from collections.abc import Iterator, Sequence

from experiments import paper
from experiments.sections import agreement, Comparison, goal, Verdict
from experiments.table2_kinds import (
    AS_IN_PAPER,
    CHASE,
    GAMES,
    OTHER_WAYS,
    TAXI,
    UNIFORM,
)
from experiments.table2_series import Gain, Line

OURS = 'goal of this project'
ROUNDING = 1e-9  # reward units
WANTED_UNIFORM, WANTED_MORE = 1900.0, 300.0  # points
TENTH = 10.0
Lines = dict[str, Line]  # of one game by kind


def comparisons(lines: Sequence[Line], gains: Sequence[Gain]) -> list[Comparison]:
    """Return what can be said of the lines that there are."""
    games = {
        game.name: {line.kind.name: line for line in lines if line.game == game} for game in GAMES
    }
    found: list[Comparison] = []
    for mine in games.values():
        found += _of_the_paper(mine)
        found += _beats_automatic(mine)
    found += _goals(games[UNIFORM.name], games[CHASE.name])
    found += _never_worse(gains)
    found += _gains(gains)
    return found


def _of_the_paper(mine: Lines) -> Iterator[Comparison]:
    """Compare the statements about order, and say why absolute numbers do not compare."""
    said = paper.TABLE_2_SAID
    primitive, human, automatic = (mine.get(n) for n in ('primitive', 'human', 'automatic'))
    if primitive is None:
        return
    for other, key in ((human, 'human faster'), (automatic, 'automatic faster')):
        if other is not None:
            faster, text = _race(other, primitive)
            yield Comparison(said[key].text, said[key].where, text, agreement(faster))
    options = [line for line in (human, automatic) if line is not None]
    if options:
        best = max(line.value().mean for line in options)
        yield Comparison(
            said['never as good'].text,
            said['never as good'].where,
            _returns([primitive, *options]) + _still_rising(primitive),
            agreement(best < primitive.value().mean - ROUNDING),
        )
    if primitive.game in (TAXI, UNIFORM):
        three = [mine[AS_IN_PAPER]] if AS_IN_PAPER in mine else []
        yield from _not_comparable(primitive.game.domain, [primitive, *options, *three])


def _still_rising(line: Line) -> str:
    """Tell what more samples would bring, by what the last doubling brought."""
    if line.game.exact or len(line.points) < 2:
        return ''
    before, last = line.points[-2:]
    return (
        f' The last doubling of game steps brought {line.kind.name} actions '
        f'{last.value.mean - before.value.mean:+,.0f} points.'
    )


def _not_comparable(domain: str, lines: Sequence[Line]) -> Iterator[Comparison]:
    known, said = paper.TABLE_2[domain], paper.TABLE_2_SAID
    theirs = '; '.join(f'{name} {row.seconds:g} s' for name, row in known.items())
    mine = '; '.join(f'{line.kind.name} {_seconds(line.seconds)}' for line in lines)
    yield Comparison(
        f'{said["seconds"].text[:-1]}: {theirs}.',
        said['seconds'].where,
        f'{lines[0].game.name}: {mine}. Those of the paper are of a computer of 2011, and '
        'it does not say which work they count.',
        Verdict.NOT_COMPARABLE,
    )
    rewards = '; '.join(f'{name} {row.mean_return:g}' for name, row in known.items())
    why = (
        'The shortest trips take about ten steps on the mean, each of which costs 1, so those of '
        'the paper are probably discounted; it gives no gamma.'
        if domain == TAXI.domain
        else 'The paper gives neither maze nor points, nor how its ghosts move; its human options '
        'are those without eating ghosts.'
    )
    yield Comparison(
        f'{said["returns"].text[:-1]}: {rewards}.',
        said['returns'].where,
        f'{_returns(lines)} {why}',
        Verdict.NOT_COMPARABLE,
    )


def _beats_automatic(mine: Lines) -> Iterator[Comparison]:
    """Compare human options with automatic ones, in time and return."""
    if 'human' not in mine or 'automatic' not in mine:
        return
    human, automatic = mine['human'], mine['automatic']
    faster, times = _race(human, automatic)
    better = human.value().mean > automatic.value().mean
    words = {
        (True, True): 'Human options are ahead in both',
        (True, False): 'Human options are ahead in time, and not in return',
        (False, True): 'Human options are ahead in return, and not in time',
        (False, False): 'Human options are ahead in neither',
    }[faster, better]
    minutes, seconds = human.cost('minutes') or 0.0, automatic.cost('seconds') or 0.0
    cost = (
        f'Not counted: {minutes:.1f} minutes of teaching, and {_seconds(seconds)} of extraction.'
    )
    text = f'{words}. {times} {_returns([human, automatic])} {cost}'
    said = paper.TABLE_2_SAID['efficient']
    yield Comparison(said.text, said.where, text, agreement(faster and better))


def _goals(uniform: Lines, chase: Lines) -> Iterator[Comparison]:
    ways = [kind.name for kind in OTHER_WAYS]
    mine = [uniform[name] for name in ways if name in uniform]
    if mine and 'primitive' in uniform:
        best, primitive = max(mine, key=_mean), uniform['primitive']
        value = _mean(best)
        both = [best, primitive]
        text = f'The best is {best.kind.name}: {_returns(both)} {_times(best, primitive)}.'
        yield Comparison(
            'Random ghosts: interrupted or as modules, human options come to '
            f'{WANTED_UNIFORM:,.0f} points and to no less than primitive actions, in a tenth of '
            'the planning time.',
            OURS,
            text,
            goal(
                value >= max(WANTED_UNIFORM, _mean(primitive))
                and TENTH * best.seconds <= primitive.seconds
            ),
        )
    mine = [chase[name] for name in ways if name in chase]
    if mine and 'primitive' in chase and 'human' in chase:
        best, to_end, primitive = max(mine, key=_mean), chase['human'], chase['primitive']
        value = _mean(best)
        text = (
            f'The best is {best.kind.name}, {value - _mean(to_end):+,.0f} points: '
            f'{_returns([best, to_end, primitive])}'
        )
        yield Comparison(
            f'Chasing ghosts: interrupted or as modules, human options come to {WANTED_MORE:.0f} '
            'points more than run to their end, and to no less than primitive actions.',
            OURS,
            text,
            goal(value >= max(_mean(to_end) + WANTED_MORE, _mean(primitive))),
        )


def _never_worse(gains: Sequence[Gain]) -> Iterator[Comparison]:
    """Check the theorem of interruption, which holds where models are exact."""
    exact = [
        gain
        for gain in gains
        if gain.game.exact
        and 'greatest mass' not in gain.kind.name  # of which there is no theorem
    ]
    if exact:
        least = {gain.kind.name: float(gain.states[0]) for gain in exact}
        text = '; '.join(f'{name}: {value:+.2g} at the least' for name, value in least.items())
        yield Comparison(
            'Exact models: interrupted, or with the strongest module, no state is worth less '
            'than run to the end.',
            OURS,
            f'{text}, by all states and people.',
            goal(min(least.values()) >= -ROUNDING),
        )


def _gains(gains: Sequence[Gain]) -> Iterator[Comparison]:
    """Compare what it gains in Pac-Man to stop the options of the same plan."""
    said = paper.TABLE_2_SAID['interrupted']
    for game in (UNIFORM, CHASE):
        mine = [gain for gain in gains if gain.game == game]
        if mine:
            text = '; '.join(f'{gain.kind.name} {gain.games.text}' for gain in mine)
            yield Comparison(
                said.text,
                said.where,
                f'{game.name}, points gained by the same plan over running to the end: {text}.',
                agreement(any(_least(gain) > 0.0 for gain in mine)),
            )


def _least(gain: Gain) -> float:
    """Return the low limit of a gain in games; of one person, what it was."""
    found = gain.games
    return found.mean if found.low is None else found.low


def _mean(line: Line) -> float:
    return line.value().mean


def _returns(lines: Sequence[Line]) -> str:
    name = lines[0].game.name
    return f'{name}, return: ' + '; '.join(f'{x.kind.name} {x.value().text}' for x in lines) + '.'


def _times(first: Line, second: Line) -> str:
    return (
        f'{first.game.name}, planning: {first.kind.name} {_seconds(first.seconds)}, '
        f'{second.kind.name} {_seconds(second.seconds)}'
    )


def _race(first: Line, second: Line) -> tuple[bool, str]:
    """
    Tell whether one kind of plan takes less time than another, and how long both take.

    Plans with exact models end by themselves. Sampled ones take as long as they are let, so they
    are compared by when they come to what the worse of the two comes to.
    """
    if first.game.exact:
        return first.seconds < second.seconds, f'{_times(first, second)}.'
    level = min(max(p.value.mean for p in line.points) for line in (first, second))
    mine, other = (line.seconds_to_reach(level) or 0.0 for line in (first, second))
    text = (
        f'{first.game.name}, planning until {level:,.0f} points: {first.kind.name} '
        f'{_seconds(mine)}, {second.kind.name} {_seconds(other)}.'
    )
    return mine < other, text


def _seconds(value: float) -> str:
    return f'{1e3 * value:.3g} ms' if value < 0.1 else f'{value:.3g} s'
