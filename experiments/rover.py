"""
Options taught to a robot: a simulated rover in a house of two rooms.

This goes beyond the paper. The rover of ``examples/humanopts_rover`` can only be acted in: the
learner sees what it senses, but neither rules nor states. A simulated person places it, shows the
option with an action every ``SECONDS``, and steers with hysteresis: turns until the rover points
well, then drives until it does not. A share of the steps are slips. So equal situations have
different actions, and no option can repeat a demonstration step by step.

From the third demonstration on, the option is examined: the person watches runs, and takes over
where one is wrong. *Learned* is the number of demonstrations when an exam was first passed.
*Success* is the share of unseen places from which the option stops where the person would call
the run right, within ``SLOWER`` times the steps that the person needs without slips.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
import sys
from typing import Any

from humanopts_env.arrays import Floats
from humanopts_env.domains.base import Action, Feature, FeatureKind
from humanopts_env.domains.described import DescribedDomain
from humanopts_env.game import Transition
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration, FOREST, TREES
from humanopts_learner.intervals import Interval
from humanopts_learner.option import Option
from humanopts_learner.options.exam import exam_length
from humanopts_learner.options.judge import judge, MIN_HELD_OUT, Thresholds
from humanopts_learner.options.learn import learn_option
from humanopts_teach.lesson.attempt import demonstration_of
from humanopts_teach.lesson.records import with_uuid
import numpy as np
import pandas as pd

from experiments import report
from experiments.people import Study
from experiments.trials import Rows, Trial

ROVER = Path(__file__).parents[1] / 'examples' / 'humanopts_rover'
if str(ROVER) not in sys.path:
    sys.path.append(str(ROVER))
from humanopts_rover.simulation import HEIGHT, PLACES, Simulation, turn, WIDTH  # noqa: E402 - not installed

NAME = 'rover'
TITLE = 'Options taught to a robot'
LESSONS = 20
SECONDS = 0.2  # of an action
SLIPS = 0.03  # share of the person's steps that are errors
SLOWER = 2.0
PLACES_TRIED = 50  # unseen
LIMIT = 400  # steps of a run
MODELS = TREES, FOREST
KEYS = ['option', 'model']
COST = 10.0  # approximate processor seconds of a trial

TWISTS = {'forward': (0.3, 0.0), 'left': (0.0, 0.8), 'right': (0.0, -0.8), 'stop': (0.0, 0.0)}
FORWARD, LEFT, RIGHT, _ = range(len(TWISTS))
AHEAD, ON_THE_RIGHT, RIGHT_AHEAD = (-20.0, 20.0), (-105.0, -75.0), (-65.0, -35.0)  # degrees
BEFORE_DOCK = 0.8  # m, from where it drives straight into the dock


def _number(name: str, question: str, low: float, high: float, unit: str = 'm') -> Feature:
    return Feature(name, question, FeatureKind.CONTINUOUS, (), unit, low, high)


def _angle(name: str, question: str) -> Feature:
    return _number(name, question, -math.pi, math.pi, 'rad')


DOMAIN = DescribedDomain(
    NAME,
    {},
    [
        _angle('charger_bearing', 'where the way to the charger points'),
        _number('charger_distance', 'how far the charger is', 0.0, 10.0),
        _angle('east_bearing', 'where the way to the east room points'),
        _number('x', 'how far east the rover is', -1.0, 9.0),
        _angle('dock_bearing', 'where the way into the dock points'),
        _number('dock_distance', 'how far the dock is', 0.0, 10.0),
        _angle('dock_heading', 'how the rover is turned against the dock'),
        _number('ahead', 'how much room there is ahead', 0.0, 11.0),
        _number('right', 'how much room there is on the right', 0.0, 11.0),
        _number('right_ahead', 'how much room there is ahead on the right', 0.0, 11.0),
    ],
    [Action(name, key, name) for name, key in zip(TWISTS, 'wads')],
    0.99,
    0,
)


def _towards(pose: Sequence[float], to: Sequence[float]) -> tuple[float, float]:
    """Return the bearing of a point from a pose, and its distance."""
    east, north = to[0] - pose[0], to[1] - pose[1]
    return turn(math.atan2(north, east) - pose[2]), math.hypot(east, north)


def _next_corner(rover: Simulation, place: str) -> tuple[float, float]:
    """Return the next corner of the way to a place that is not reached yet."""
    here, *corners, goal = rover.path(place)
    return next((corner for corner in corners if math.dist(here, corner) > 0.15), goal)


def _room(ranges: Floats, sector: tuple[float, float]) -> float:
    """Return the shortest range in a sector, m."""
    angles = np.linspace(-180.0, 180.0, len(ranges), endpoint=False)
    return float(ranges[(angles >= sector[0]) & (angles <= sector[1])].min())


def sensed(rover: Simulation) -> tuple[float, ...]:
    """Return the features (F,) of where a rover is, as it senses them."""
    measured, ranges = rover.odometry(), rover.scan()
    pose = measured.x, measured.y, measured.yaw
    dock = PLACES['dock']
    return (
        _towards(pose, _next_corner(rover, 'charger'))[0],
        _towards(pose, PLACES['charger'])[1],
        _towards(pose, _next_corner(rover, 'east'))[0],
        measured.x,
        _towards(pose, _into_dock(pose))[0],
        _towards(pose, dock)[1],
        turn(measured.yaw - dock.yaw),
        *(_room(ranges, sector) for sector in (AHEAD, ON_THE_RIGHT, RIGHT_AHEAD)),
    )


def _into_dock(pose: Sequence[float]) -> Sequence[float]:
    """Return the next point of the way into the dock: it, or a place before it, to get in line."""
    dock = PLACES['dock']
    before, aside = pose[0] - dock.x, abs(pose[1] - dock.y)  # the dock looks west
    in_line = before > 0 and aside < 0.06 + 0.15 * max(before - 0.15, 0.0)
    return dock if in_line else (dock.x + BEFORE_DOCK, dock.y)


# What the person means.

_EXACT = Simulation(noise=False)


@dataclass(frozen=True)
class Skill:
    """An option as the person means it; the functions see the true pose of the rover."""

    features: tuple[str, ...]
    can_start: Callable[[Simulation], bool]
    steer: Callable[[Simulation], float]  # the bearing to keep, rad; near 0: drive
    done: Callable[[Simulation], bool]  # the person stops here
    right: Callable[[Simulation], bool]  # and calls this a right end of a run
    shown: int  # most demonstrations
    goal: float  # lowest success after these


def _exact(rover: Simulation) -> Floats:
    """Return the ranges without noise."""
    _EXACT.pose = rover.pose
    return _EXACT.scan()


def _wall_bearing(rover: Simulation) -> float:
    """Return where to turn to keep a wall on the right: less than half a metre away."""
    ranges = _exact(rover)
    diagonal = _room(ranges, RIGHT_AHEAD)
    if diagonal < 0.5:
        return 1.0
    return -1.0 if diagonal > 0.8 else 0.0


def _outer_wall_distance(rover: Simulation) -> float:
    """Return how far an outer wall is on the right; infinite: something else is there."""
    room, to = _room(_exact(rover), ON_THE_RIGHT), rover.pose.yaw - math.pi / 2
    x, y = rover.pose.x + room * math.cos(to), rover.pose.y + room * math.sin(to)
    gap = min(x, y, WIDTH - x, HEIGHT - y)
    return room if gap < 0.1 else math.inf


def _dock_bearing(rover: Simulation) -> float:
    """Return where to turn to get into the dock, and then to look as it does."""
    dock, pose = PLACES['dock'], rover.pose
    if math.dist(pose[:2], dock[:2]) < 0.15:
        return turn(dock.yaw - pose.yaw)
    return _towards(pose, _into_dock(pose))[0]


def _docked(rover: Simulation, distance: float, angle: float) -> bool:
    dock, pose = PLACES['dock'], rover.pose
    return math.dist(pose[:2], dock[:2]) < distance and abs(turn(pose.yaw - dock.yaw)) < angle


def _charger_distance(rover: Simulation) -> float:
    return math.dist(rover.pose[:2], PLACES['charger'][:2])


SKILLS = {
    'go to the charger': Skill(
        ('charger_bearing', 'charger_distance'),
        lambda rover: _charger_distance(rover) > 0.6,
        lambda rover: _towards(rover.pose, _next_corner(rover, 'charger'))[0],
        lambda rover: _charger_distance(rover) < 0.25,
        lambda rover: _charger_distance(rover) < 0.4,
        5,
        0.98,
    ),
    'go through the door': Skill(
        ('east_bearing', 'x'),
        lambda rover: rover.pose.x < 3.8,
        lambda rover: _towards(rover.pose, _next_corner(rover, 'east'))[0],
        lambda rover: rover.pose.x > 4.5,
        lambda rover: 4.3 < rover.pose.x < 4.9,
        5,
        0.98,
    ),
    'follow the wall': Skill(
        ('ahead', 'right', 'right_ahead'),
        lambda rover: _room(_exact(rover), AHEAD) > 1.2 and _outer_wall_distance(rover) < 0.6,
        _wall_bearing,
        lambda rover: _room(_exact(rover), AHEAD) < 0.5,
        lambda rover: _room(_exact(rover), AHEAD) < 0.6,
        10,
        0.95,
    ),
    'dock': Skill(
        ('dock_bearing', 'dock_distance', 'dock_heading'),
        lambda rover: (
            0.5 < math.dist(rover.pose[:2], PLACES['dock'][:2]) < 2.0
            and rover.pose.x > PLACES['dock'].x
        ),
        _dock_bearing,
        lambda rover: _docked(rover, 0.18, 0.12),
        lambda rover: _docked(rover, 0.22, 0.2),
        20,
        0.9,
    ),
}


class Person:
    """Drives the rover in one demonstration, with hysteresis and slips."""

    def __init__(self, skill: Skill, slips: float, rng: np.random.Generator) -> None:
        self._skill, self._slips, self._rng, self._turning = skill, slips, rng, False

    def action(self, rover: Simulation) -> int:
        """Return the next action."""
        bearing = self._skill.steer(rover)
        self._turning = abs(bearing) > (0.1 if self._turning else 0.3)
        best = (LEFT if bearing > 0 else RIGHT) if self._turning else FORWARD
        if self._rng.random() >= self._slips:
            return best
        return int(self._rng.choice([each for each in (FORWARD, LEFT, RIGHT) if each != best]))


# Lessons.


def trials(study: Study) -> list[Trial]:
    """Return one trial per lesson, option and model; none with bags."""
    lessons = 0 if study.bags else study.participants
    return [
        Trial(
            NAME,
            {'option': name, 'model': model, 'lesson': lesson, 'seed': study.seed},
            give_lesson,
            COST,
        )
        for lesson in range(1, lessons + 1)
        for name in SKILLS
        for model in MODELS
    ]


def give_lesson(parameters: Mapping[str, Any]) -> Rows:
    """
    Teach an option once, with as many demonstrations as its goal allows.

    :return: one row: success, learned (demonstrations; 0: no exam was passed), success when
        learned, exam answers until then, agreement and termination (values of the criteria).
    """
    name, model, lesson = (parameters[key] for key in ('option', 'model', 'lesson'))
    skill, seed = SKILLS[name], parameters['seed']
    rng = generator(seed, NAME, name, lesson)
    rover = Simulation(int(rng.integers(2**31)))
    demos, learned, answers, failed, early = list[Demonstration](), 0, 0, 0, math.nan
    while len(demos) < skill.shown:
        if learned or not failed or not skill.can_start(rover):
            _place(rover, skill)
        if (shown := _show(rover, name, model, len(demos) + 1, rng)) is None:
            failed = 0  # and begins somewhere else
            continue
        demos.append(shown)
        if learned or len(demos) < MIN_HELD_OUT:
            continue
        option, runs, right = learn_option(demos, DOMAIN, seed), 0, True
        while right and runs < exam_length(Thresholds().exam, failed):
            _place(rover, skill)
            right, runs = _runs_right(rover, option, skill, LIMIT), runs + 1
        answers, failed = answers + runs, failed + (not right)
        if right:
            learned, early = len(demos), success(option, skill, seed)
    option = learn_option(demos, DOMAIN, seed)
    found = {each.name: each for each in judge(demos, DOMAIN, Thresholds(), seed, option).criteria}
    row = {
        **{key: parameters[key] for key in ('option', 'model', 'lesson')},
        'demonstrations': len(demos),
        'success': success(option, skill, seed),
        'learned': learned,
        'exam answers': answers,
        'agreement': found['agreement'].value,
        'termination': found['termination'].value,
        'criteria met': float(all(each.met or each.obstacle for each in found.values())),
    }
    return [row if math.isnan(early) else {**row, 'success when learned': early}]


def _place(rover: Simulation, skill: Skill) -> None:
    """Put a rover where an option can start, with a full battery."""
    rover.battery = 1.0
    rover.place_randomly()
    while not skill.can_start(rover):
        rover.place_randomly()


def _act(rover: Simulation, action: int) -> None:
    rover.step(*TWISTS[DOMAIN.actions[action].name], SECONDS)


def _show(
    rover: Simulation, name: str, model: str, number: int, rng: np.random.Generator
) -> Demonstration | None:
    """Return a demonstration from where the rover is; None: it did not reach its end."""
    person, states = Person(SKILLS[name], SLIPS, rng), [_state(rover, 0, '')]
    while len(states) <= LIMIT:
        action = person.action(rover)
        _act(rover, action)
        states.append(_state(rover, len(states), DOMAIN.actions[action].name))
        if SKILLS[name].done(rover):
            facts = {'option_name': name, 'participant': 'simulated', 'session': 'simulated'}
            chosen = {'chosen_features': SKILLS[name].features, 'method': model}
            demo = demonstration_of(DOMAIN, states, number=number, **facts, **chosen)
            return with_uuid(demo)
    return None


def _state(rover: Simulation, step: int, action: str) -> Transition:
    features = sensed(rover)
    text = ' '.join(f'{value:.3f}' for value in features)
    return Transition(1, step, text, features, action, reward=-1.0 if step else 0.0)


def _runs_right(rover: Simulation, option: Option, skill: Skill, limit: int) -> bool:
    """Run an option from where the rover is; return whether the run ends as the person means."""
    row = np.array([sensed(rover)])
    for _ in range(limit):
        _act(rover, int(option.action(row)[0]))
        row = np.array([sensed(rover)])
        if option.ends(row)[0]:
            return skill.right(rover)
    return False


def success(option: Option, skill: Skill, seed: int) -> float:
    """Return the share of unseen places from which an option succeeds."""
    right, tried = 0, 0
    rover = Simulation(int(generator(seed, NAME, 'unseen').integers(2**31)))
    while tried < PLACES_TRIED:
        _place(rover, skill)
        start, steps, person = rover.pose, 0, Person(skill, 0.0, np.random.default_rng(0))
        while steps < LIMIT and not (steps and skill.done(rover)):
            _act(rover, person.action(rover))
            steps += 1
        if steps < LIMIT:  # where the person fails, there is no end to reach
            rover.place(*start)
            right += _runs_right(rover, option, skill, int(SLOWER * steps))
            tried += 1
    return right / tried


def present(rows: pd.DataFrame) -> report.Section:
    """Return the section of the report; one row per lesson."""
    lessons = rows.drop(columns='trial', errors='ignore')
    table = report.mean_intervals(lessons, KEYS, 'success', 0.0, 1.0).rename(
        columns={'count': 'lessons', 'mean': 'success'}
    )
    means = [name for name in lessons if name not in (*KEYS, 'lesson', 'success', 'learned')]
    by = lessons.groupby(KEYS, sort=False)
    table = table.join(by[means].mean(), on=KEYS)
    passed = lessons[lessons['learned'] > 0].groupby(KEYS, sort=False)['learned']
    table = table.join(passed.size().rename('exams passed'), on=KEYS)
    table = table.join(passed.median().rename('learned after'), on=KEYS)
    found = []
    for (name,), mine in report.grouped(lessons, ['option']):
        skill = SKILLS[name]
        values = {
            model: Interval.of(each['success'])
            for (model,), each in report.grouped(mine, ['model'])
        }
        said = f'{name}: success of at least {skill.goal:.0%} after {skill.shown} demonstrations.'
        verdict = max(value.mean for value in values.values()) >= skill.goal
        found.append(report.compare(said, verdict, 'mean success', values, '.3f'))
    tables = [
        report.Table('rover-options', 'Success by option and model', table),
        report.Table('rover-lessons', 'Each lesson', lessons, shown=False),
    ]
    facts = {'slips': SLIPS, 'places': PLACES_TRIED, 'seconds': SECONDS}
    return report.Section(NAME, TITLE, found, (), tables, facts)
