"""The options of a participant for planning and learning, from a whole lesson in one process."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_learner.demonstrations import Kind
from humanopts_learner.options.criteria import judge, usual_thresholds
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import LearnedOption
from humanopts_teach.bags.contents import read_domain
from humanopts_teach.bags.reader import open_bag
from humanopts_teach.lesson.start_states import LessonRules

from experiments import paper
from experiments.lessons import teach
from experiments.people import Participant, participants, VARIED
from experiments.study import Study, taught_in

STRATEGY, BUDGET = 'failures', 150  # those of a launch


@dataclass(frozen=True)
class Teacher:
    """Who taught what is learned with: a simulated participant, or a person in a bag."""

    code: str
    parameters: Mapping[str, Any]  # for ``options_of``, JSON data


@dataclass(frozen=True)
class TaughtOptions:
    """The options of one person, and what they cost."""

    options: tuple[LearnedOption, ...]
    demonstrations: int  # trajectories
    minutes: float  # of teaching: by the clock for people, at an assumed pace for simulated ones


def teachers(study: Study, domain: str) -> list[Teacher]:
    """Return those who teach in a domain: the people in bags, else simulated ones who differ."""
    if not study.bags:
        return [
            Teacher(person.code, {'person': person.to_dict()})
            for person in participants(VARIED, study.participants, study.seed)
        ]
    digests: dict[tuple[str, str, int], list[str]] = {}
    for lesson in study.bags:
        if lesson.domain == domain:
            key = lesson.bag, lesson.participant, lesson.seed
            digests.setdefault(key, []).append(lesson.digest)
    return [
        Teacher(code, {'bag': bag, 'participant': code, 'seed': seed, 'digests': found})
        for (bag, code, seed), found in digests.items()
    ]


def options_of(
    parameters: Mapping[str, Any], domain: Domain[Any], names: Sequence[str] = ()
) -> TaughtOptions:
    """
    Return all that one person taught, with the criteria that end a lesson.

    :param parameters: of a ``Teacher``.
    :param names: what a simulated one teaches; empty: what the paper's participants did.
    """
    if 'person' in parameters:
        person = Participant.from_dict(parameters['person'])
        return _from_lesson(person, domain, names or paper.TAUGHT[domain.name])
    return _from_bag(parameters)


def _from_lesson(person: Participant, domain: Domain[Any], names: Sequence[str]) -> TaughtOptions:
    rules, limits = LessonRules(STRATEGY, BUDGET, person.seed), usual_thresholds(domain)
    taught = teach(
        domain,
        person.teaching(*names),
        rules,
        lambda shown, option: judge(shown, domain, limits, person.seed, option).criteria_met,
        until_no_failures=True,
    )
    shown = sum(demo.kind is Kind.TRAJECTORY for demo in taught.demonstrations)
    return TaughtOptions(taught.options, shown, taught.seconds / 60)


def _from_bag(parameters: Mapping[str, Any]) -> TaughtOptions:
    bag = open_bag(Path(parameters['bag']))
    domain = read_domain(bag)
    groups = [
        demos
        for (person, _), demos in taught_in(bag, domain).items()
        if person == parameters['participant']
        and any(demo.kind is Kind.TRAJECTORY for demo in demos)
    ]
    options = tuple(learn_option(demos, domain, parameters['seed']) for demos in groups)
    every = [demo for demos in groups for demo in demos]
    shown = sum(demo.kind is Kind.TRAJECTORY for demo in every)
    return TaughtOptions(options, shown, sum(demo.seconds for demo in every) / 60)
