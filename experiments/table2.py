"""
Table 2: what planning with each action set takes and comes to (sections 7.3 and 8).

One cell is whose options are planned with: one person's, those of one extraction, or none. They
are got once, from the usual game, and planned with by every action set that they belong to.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
import math
import time
from typing import Any

from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_env.domains.registry import make_domain
from humanopts_env.seeding import generator
from humanopts_learner.automatic.extract import find_options
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.planning.sampled.comparison import carried_over

from experiments import paper
from experiments.cells import Cell
from experiments.study import Study
from experiments.table2_exact import plan_exactly
from experiments.table2_kinds import GAMES, Kind, KINDS, MACHINE, NOBODY, PERSON
from experiments.table2_sampled import Effort, plan_from_samples
from experiments.taught import options_of, teachers

NAME = 'table2'
EFFORT = Effort()
COSTS = {  # of a cell, about seconds, by domain and whose options
    ('pacman', NOBODY): 45.0,
    ('pacman', PERSON): 180.0,
    ('pacman', MACHINE): 65.0,
    ('taxi', PERSON): 5.0,
    ('taxi', MACHINE): 4.0,
}


@dataclass(frozen=True)
class Owned:
    """Options, and what it cost to get them; None: it is not of that kind."""

    options: Sequence[Any]  # as planning in the domain takes them
    demonstrations: int | None = None
    minutes: float | None = None  # of teaching
    seconds: float | None = None  # of a processor, for an extraction
    game_steps: int | None = None

    @property
    def cost(self) -> dict[str, Any]:
        """The cost as JSON data."""
        names = ('demonstrations', 'minutes', 'seconds', 'game_steps')
        return {'options': len(self.options), **{name: getattr(self, name) for name in names}}


def cells(study: Study) -> list[Cell]:
    """Return one cell for each domain that somebody taught, and person, extraction, repetition."""
    found = []
    for domain in dict.fromkeys(game.domain for game in GAMES):
        people = [teacher.parameters for teacher in teachers(study, domain)]
        count = len(people)
        if not count:
            continue
        sources: dict[str, list[dict[str, Any]]] = {
            NOBODY: [{'number': number} for number in range(1, count + 1)],
            PERSON: [{'teacher': dict(known)} for known in people],
            MACHINE: [{'extraction': study.seed + number} for number in range(count)],
        }
        common = {
            'domain': domain,
            'plans': math.ceil(study.seeds / count),
            'seed': study.seed,
            'effort': asdict(EFFORT),
        }
        found += [
            Cell(
                NAME,
                {**common, 'whose': whose, **source},
                compute,
                COSTS.get((domain, whose), 1.0),
            )
            for whose, members in sources.items()
            for source in members
        ]
    return found


def compute(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """
    Plan with every action set that some options belong to, in every game of their domain.

    :return: by game and kind the cost of its options, and what planning came to.
    """
    effort, found = Effort(**parameters['effort']), _owned(parameters)
    played: dict[str, Any] = {}
    for game in GAMES:
        if game.domain != parameters['domain']:
            continue
        domain = make_domain(game.domain, game.parameters)
        asked = [(kind, _in_game(owned, domain)) for kind, owned in found]
        if is_enumerable(domain):
            played[game.name] = plan_exactly(domain, asked, parameters['plans'])
        else:
            seed = _seed(parameters, game.name)
            played[game.name] = plan_from_samples(domain, asked, parameters['plans'], effort, seed)
    return {'costs': {kind.name: owned.cost for kind, owned in found}, 'games': played}


def _in_game(owned: Owned, domain: Any) -> list[Any]:
    """Return options for use in a game with other parameters than they were taught in."""
    return [
        carried_over(option, domain) if isinstance(option, LearnedOption) else option
        for option in owned.options
    ]


def _owned(parameters: Mapping[str, Any]) -> list[tuple[Kind, Owned]]:
    """Return what is planned with, each with its options."""
    domain, whose = make_domain(parameters['domain']), parameters['whose']
    mine = [kind for kind in KINDS if kind.whose == whose and not kind.of_section_7]
    if whose == PERSON:
        taught = _taught(parameters['teacher'], domain)
        paper_only = [kind for kind in KINDS if kind.of_section_7] if len(taught) > 1 else []
        return [*((k, taught[-1]) for k in mine), *((k, taught[0]) for k in paper_only)]
    if whose == MACHINE:
        found = find_options(domain, parameters['extraction'], clock=time.process_time)
        options = found.tabled if is_enumerable(domain) else found.batched
        owned = Owned(options, seconds=found.seconds, game_steps=found.game_steps)
        return [(kind, owned) for kind in mine]
    return [(kind, Owned(())) for kind in mine]


def _taught(teacher: Mapping[str, Any], domain: Domain[Any]) -> list[Owned]:
    """Return what a person taught: as in section 7, and then, if there is more, all of it."""
    first = options_of(teacher, domain)
    found = [Owned(first.options, first.demonstrations, first.minutes)]
    names = paper.ALSO_NAMED.get(domain.name, ())
    if names and 'person' in teacher:
        more = options_of(teacher, domain, names)
        found.append(
            Owned(
                first.options + more.options,
                first.demonstrations + more.demonstrations,
                first.minutes + more.minutes,
            )
        )
    return found


def _seed(parameters: Mapping[str, Any], game: str) -> int:
    """Return a seed that differs between games, and between those whose options they are."""
    source = [str(parameters.get(name)) for name in ('number', 'teacher', 'extraction')]
    return int(generator(parameters['seed'], NAME, game, *source).integers(2**31))
