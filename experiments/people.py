"""
The owners of options: people in bags, simulated people, extractions, or none.

There are two groups of simulated participants, since the paper makes two kinds of claims.
*Careful* people make no errors; they differ only in their preference among equally good actions.
*Varied* people also differ in their error rates (share of wrong steps, from 0 to ``MAX_ERRORS``)
and in their rates of needless answers (probability of answering yes to a question about an
irrelevant feature, from 0 to ``MAX_NEEDLESS``). Their rates follow a quasirandom sequence with a
random offset, which fills a square evenly with any number of people (Roberts 2018, The
unreasonable effectiveness of quasirandom sequences: R2).
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
import hashlib
from pathlib import Path
import time
from typing import Any

from humanopts_env.domains.base import Domain, is_enumerable
from humanopts_env.domains.registry import domain_from_json, parameters_json
from humanopts_env.seeding import generator
from humanopts_learner.automatic.extract import AutomaticOptions, find_options, to_learned_options
from humanopts_learner.demonstrations import Demonstration, Kind, shown
from humanopts_learner.options.learn import learn_option
from humanopts_teach.bags import BagError
from humanopts_teach.bags.contents import read_demonstrations, read_domain
from humanopts_teach.bags.reader import Bag, open_bag
from humanopts_teach.evaluation.bag_evaluation import usable_demonstrations
from humanopts_teach.evaluation.settings import settings_from_facts
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.simulated_teacher import TeacherSettings

from experiments import paper

NOBODY, PERSON, MACHINE = 'nobody', 'person', 'machine'  # kinds of owner
CLOCK = time.process_time
CAREFUL, VARIED = 'careful', 'varied'
MAX_ERRORS = 0.05
MAX_NEEDLESS = 0.2
STEPS = (0.7548776662466927, 0.5698402909980532)  # 1 / g, 1 / g**2, where g**3 = g + 1


@dataclass(frozen=True)
class Participant:
    """One simulated person; all further random draws are keyed by code and seed."""

    group: str
    code: str
    error_rate: float  # share of wrong steps
    needless_rate: float  # probability of a needless yes for each feature
    seed: int  # seed of the study

    def teaching(self, *options: str) -> TeacherSettings:
        """Return the teacher settings of this person for some options."""
        return TeacherSettings(
            options=options,
            participant=self.code,
            session='study',
            error_rate=self.error_rate,
            extra_feature_rate=self.needless_rate,
            own_habits=True,
            seed=self.seed,
        )


def participants(group: str, count: int, seed: int) -> list[Participant]:
    """Draw people of a group; a larger count adds people without changing the others."""
    offsets = generator(seed, 'participants', group).uniform(size=2).tolist()
    found = []
    for number in range(1, count + 1):
        errors, needless = ((x + number * step) % 1.0 for x, step in zip(offsets, STEPS))
        rates = (errors * MAX_ERRORS, needless * MAX_NEEDLESS) if group == VARIED else (0.0, 0.0)
        error_rate, needless_rate = (round(rate, 4) for rate in rates)
        found.append(Participant(group, f'{group}{number}', error_rate, needless_rate, seed))
    return found


@dataclass(frozen=True)
class BagLesson:
    """One option taught by one person in a bag."""

    bag: str  # absolute path
    participant: str
    option: str
    domain: str
    domain_parameters: str  # JSON object
    strategy: str  # for start states
    seed: int  # seed of the lesson
    digest: str  # of the uuids of the demonstrations


@dataclass(frozen=True)
class Study:
    """The size of a reproduction and its people."""

    participants: int = 6  # simulated people in each group
    seeds: int = 10  # runs of each method with random draws
    seed: int = 1  # seed of every random draw
    bags: tuple[BagLesson, ...] = ()  # lessons of real people; none: people are simulated
    mazes: tuple[str, ...] = ()  # the user's mazes as text, for ``transfer``; empty: draw mazes


def read_bag_lessons(path: Path) -> list[BagLesson]:
    """
    Return every option taught in a bag.

    :raises BagError: the bag cannot be read, or nothing was taught in it.
    """
    bag = open_bag(path)
    domain = read_domain(bag)
    settings, _ = settings_from_facts(bag.graph_facts)
    lessons = [
        BagLesson(
            str(path.resolve()),
            participant,
            option,
            domain.name,
            parameters_json(domain),
            settings.strategy,
            settings.seed,
            hashlib.sha256(''.join(demo.uuid for demo in demos).encode()).hexdigest()[:20],
        )
        for (participant, option), demos in taught_in(bag, domain).items()
    ]
    if not lessons:
        raise BagError(f'{path} holds no demonstration to learn from')
    return lessons


def taught_in(bag: Bag, domain: Domain) -> dict[tuple[str, str], list[Demonstration]]:
    """Return the demonstrations from which ``bag eval`` learns, by participant and option."""
    groups, _ = usable_demonstrations(read_demonstrations(bag), domain)
    return {key: shown(demos) for key, demos in groups.items()}


@dataclass(frozen=True)
class OwnedOptions:
    """Options and the cost of obtaining them; None: not a cost of this kind of owner."""

    options: tuple[Any, ...] = ()  # learned, or automatic in the form for the domain's planner
    minutes: float | None = None  # teaching time: measured, or assumed for simulated people
    seconds: float | None = None  # processor time of an extraction or another learner
    game_steps: int | None = None
    shown: tuple[Demonstration, ...] = ()

    @property
    def demonstrations(self) -> int | None:
        """Number of demonstrated trajectories; None: there are no demonstrations."""
        count = sum(demo.kind is Kind.TRAJECTORY for demo in self.shown)  # no "not here" answers
        return count if self.shown else None

    def __add__(self, other: 'OwnedOptions') -> 'OwnedOptions':
        """Merge the options taught by one person in two lessons."""
        minutes = (self.minutes or 0.0) + (other.minutes or 0.0)
        return OwnedOptions(self.options + other.options, minutes, shown=self.shown + other.shown)


def owners(study: Study, domain: str) -> dict[str, list[dict[str, Any]]]:
    """
    Return the owners of the options of an experiment: equal numbers of people, extractions and
    repetitions without options.

    :return: parameters for ``options_of`` as JSON data, by kind of owner. The people are those in
        bags, or varied simulated people; none if the people in bags taught another domain.
    """
    if study.bags:
        digests: dict[tuple[str, str, int], list[str]] = {}
        for lesson in study.bags:
            if lesson.domain == domain:
                key = lesson.bag, lesson.participant, lesson.seed
                digests.setdefault(key, []).append(lesson.digest)
        teachers: list[dict[str, Any]] = [
            {'bag': bag, 'participant': code, 'seed': seed, 'digests': found}
            for (bag, code, seed), found in digests.items()
        ]
    else:
        people = participants(VARIED, study.participants, study.seed)
        teachers = [{'person': asdict(person)} for person in people]
    count = len(teachers) or study.participants
    return {
        NOBODY: [{'number': number} for number in range(1, count + 1)],
        PERSON: [{'teacher': teacher} for teacher in teachers],
        MACHINE: [{'extraction': study.seed + number} for number in range(count)],
    }


def owner_seed(parameters: Mapping[str, Any], *key: str) -> int:
    """Return a seed that differs between owners of options."""
    source = [str(parameters.get(name)) for name in ('number', 'teacher', 'extraction')]
    return int(generator(parameters['seed'], *key, *source).integers(2**31))


def options_of(
    owner: Mapping[str, Any], domain: Domain, names: Sequence[str] = ()
) -> OwnedOptions:
    """
    Return the options of one owner; simulated people teach until the options are learned.

    :param owner: parameters of one owner, from ``owners``.
    :param names: options taught by a simulated person; empty: those of the paper.
    """
    if 'extraction' in owner:
        found = extraction(domain.name, parameters_json(domain), owner['extraction'])
        options = found.options if is_enumerable(domain) else to_learned_options(domain, found)
        return OwnedOptions(tuple(options), seconds=found.seconds, game_steps=found.game_steps)
    if 'teacher' not in owner:
        return OwnedOptions()
    if 'person' in owner['teacher']:
        person = Participant(**owner['teacher']['person'])
        taught = tuple(names or paper.TAUGHT[domain.name])
        return _from_lesson(person, domain.name, parameters_json(domain), taught)
    return _from_bag(owner['teacher'])


@lru_cache(maxsize=64)
def extraction(domain: str, parameters: str, seed: int) -> AutomaticOptions:
    """Return the automatic options of a domain."""
    return find_options(domain_from_json(domain, parameters), seed, clock=CLOCK)


@lru_cache(maxsize=64)
def _from_lesson(
    person: Participant, domain: str, parameters: str, names: tuple[str, ...]
) -> OwnedOptions:
    """Return the options of a simulated person."""
    rules = LessonRules(seed=person.seed)
    taught = teach(domain_from_json(domain, parameters), person.teaching(*names), rules)
    return OwnedOptions(taught.options, taught.seconds / 60, shown=tuple(taught.demonstrations))


def _from_bag(teacher: Mapping[str, Any]) -> OwnedOptions:
    bag = open_bag(Path(teacher['bag']))
    domain, code, seed = read_domain(bag), teacher['participant'], teacher['seed']
    groups = [demos for (person, _), demos in taught_in(bag, domain).items() if person == code]
    options = tuple(learn_option(demos, domain, seed) for demos in groups)
    shown = tuple(demo for demos in groups for demo in demos)
    return OwnedOptions(options, sum(demo.seconds for demo in shown) / 60, shown=shown)
