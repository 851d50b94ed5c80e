"""
Options taught to a robot: a simulated rover in a house with two rooms.

This goes beyond the paper. The learner sees only the features of the world file of
``examples/humanopts_rover``, neither rules nor states. A simulated person places the rover,
demonstrates the option, and steers with hysteresis: they turn until the rover points in the right
direction, then drive until it does not, or until a wall stops it. A share of the steps are slips.
Equal situations thus have different actions, and no option can repeat a demonstration exactly.

From the third demonstration on, the option has an exam: the person watches runs, and gives the
next demonstration from where a run went wrong. Once an exam has been passed, they watch at most
``WATCHED`` runs before each further demonstration. *Learned* is the number of demonstrations at
the first passed exam. A run is right if it stops where the person would call it right, within
``SLOWER`` times the steps that the person needs without slips. *Success* is the share of right
runs from unseen places.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
import sys
from typing import Any

from humanopts_env.arrays import Floats
from humanopts_env.game import Transition
from humanopts_env.seeding import generator
from humanopts_env.worlds.sensors import Sensors
from humanopts_env.worlds.world import load_world
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
from humanopts_rover import messages  # noqa: E402 - not installed
from humanopts_rover.simulation import HEIGHT, PLACES, Simulation, turn, WIDTH  # noqa: E402

NAME = 'rover'
TITLE = 'Options taught to a robot'
LESSONS = 20
SLIPS = 0.03  # share of the person's steps that are errors
SLOWER = 2.0
PLACES_TRIED = 50  # unseen places for measuring success
WATCHED = 5  # maximum runs before a demonstration, once learned
LIMIT = 400  # maximum steps of a run
MODELS = TREES, FOREST
KEYS = ['option', 'model']
COST = 10.0  # approximate processor seconds of a trial

FORWARD, LEFT, RIGHT = 'forward', 'left', 'right'
AHEAD, ON_THE_RIGHT, RIGHT_AHEAD = (-20.0, 20.0), (-105.0, -75.0), (-65.0, -35.0)  # degrees
WORLD = load_world(f'ros:{ROVER}/worlds/rover.yaml')
DOMAIN = WORLD.domain


def _towards(rover: Simulation, to: Sequence[float]) -> float:
    """Return the bearing of a point from a rover, rad."""
    x, y, yaw = rover.pose
    return turn(math.atan2(to[1] - y, to[0] - x) - yaw)


def _room(ranges: Floats, sector: tuple[float, float]) -> float:
    """Return the shortest range in a sector (in degrees), m."""
    angles = np.linspace(-180.0, 180.0, len(ranges), endpoint=False)
    return float(ranges[(angles >= sector[0]) & (angles <= sector[1])].min())


def sensed(rover: Simulation) -> tuple[float, ...]:
    """Return the features (F,) that a rover senses at its pose."""
    sensors = Sensors(WORLD.file.topics)
    for name, message in messages.sensed(rover).items():
        sensors.note(name, message, 0.0)
    return WORLD.sense(sensors).features


# Options as the person means them.

_EXACT = Simulation(noise=False)


@dataclass(frozen=True)
class Skill:
    """An option as the person means it; the functions see the true pose of the rover."""

    features: tuple[str, ...]
    can_start: Callable[[Simulation], bool]
    steer: Callable[[Simulation], float]  # bearing to turn to, rad; near 0: drive
    done: Callable[[Simulation], bool]  # whether the person would stop here
    right: Callable[[Simulation], bool]  # whether the person would accept this end of a run
    shown: int  # maximum number of demonstrations
    goal: float  # minimum success after these


def _exact(rover: Simulation) -> Floats:
    """Return the ranges without noise."""
    _EXACT.pose = rover.pose
    return _EXACT.scan()


def _wall_bearing(rover: Simulation) -> float:
    """Return the bearing that keeps a wall on the right, 0.5 to 0.8 m away diagonally ahead."""
    ranges = _exact(rover)
    diagonal = _room(ranges, RIGHT_AHEAD)
    if diagonal < 0.5:
        return 1.0
    return -1.0 if diagonal > 0.8 else 0.0


def _outer_wall_distance(rover: Simulation) -> float:
    """Return the distance of an outer wall on the right; infinite if something else is there."""
    room, to = _room(_exact(rover), ON_THE_RIGHT), rover.pose.yaw - math.pi / 2
    x, y = rover.pose.x + room * math.cos(to), rover.pose.y + room * math.sin(to)
    gap = min(x, y, WIDTH - x, HEIGHT - y)
    return room if gap < 0.1 else math.inf


def _dock_bearing(rover: Simulation) -> float:
    """Return the bearing that leads into the dock or, once there, aligns the rover with it."""
    dock, pose = PLACES['dock'], rover.pose
    if math.dist(pose[:2], dock[:2]) < 0.15:
        return turn(dock.yaw - pose.yaw)
    return _towards(rover, rover.waypoint('dock'))


def _docked(rover: Simulation, distance: float, angle: float) -> bool:
    dock, pose = PLACES['dock'], rover.pose
    return math.dist(pose[:2], dock[:2]) < distance and abs(turn(pose.yaw - dock.yaw)) < angle


def _charger_distance(rover: Simulation) -> float:
    return math.dist(rover.pose[:2], PLACES['charger'][:2])


SKILLS = {
    'go to the charger': Skill(
        ('charger_bearing', 'charger_distance'),
        lambda rover: _charger_distance(rover) > 0.6,
        lambda rover: _towards(rover, rover.waypoint('charger')),
        lambda rover: _charger_distance(rover) < 0.25,
        lambda rover: _charger_distance(rover) < 0.4,
        5,
        0.98,
    ),
    'go through the door': Skill(
        ('east_bearing', 'x'),
        lambda rover: rover.pose.x < 3.8,
        lambda rover: _towards(rover, rover.waypoint('east')),
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
        ('dock_bearing', 'dock_distance', 'dock_turn'),
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
    """The person who drives the rover in one demonstration, with hysteresis and slips."""

    def __init__(self, skill: Skill, slips: float, rng: np.random.Generator) -> None:
        self._skill, self._slips, self._rng, self._turning = skill, slips, rng, False

    def action(self, rover: Simulation) -> str:
        """Return the next action."""
        bearing, turns = self._skill.steer(rover), self._turning or rover.bumped
        self._turning = abs(bearing) > (0.1 if turns else 0.3)
        best = (LEFT if bearing > 0 else RIGHT) if self._turning else FORWARD
        if self._rng.random() >= self._slips:
            return best
        return str(self._rng.choice([each for each in (FORWARD, LEFT, RIGHT) if each != best]))


# Lessons.


def trials(study: Study) -> list[Trial]:
    """Return one trial per lesson, option and model; none if the study uses bags."""
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
        learned, exam answers (until then), agreement and termination (values of the criteria).
    """
    name, model, lesson = (parameters[key] for key in ('option', 'model', 'lesson'))
    skill, seed = SKILLS[name], parameters['seed']
    rng = generator(seed, NAME, name, lesson)
    rover = Simulation(int(rng.integers(2**31)))
    demos, learned, answers, failed, early = list[Demonstration](), 0, 0, 0, math.nan
    right = True  # whether the last watched run was right
    while len(demos) < skill.shown:
        if right or skill.done(rover):
            _place(rover, skill)
        if (shown := _show(rover, name, model, len(demos) + 1, rng)) is None:
            right = True  # start somewhere else
            continue
        demos.append(shown)
        if len(demos) < MIN_HELD_OUT:
            continue
        option, runs, right = learn_option(demos, DOMAIN, seed), 0, True
        most = WATCHED if learned else exam_length(Thresholds().exam, failed)
        while right and runs < most:
            right, runs = _try(rover, option, skill), runs + 1
        if learned:
            continue
        answers, failed = answers + runs, failed + (not right)
        if right:
            learned, early = len(demos), success(option, skill, seed, lesson)
    option = learn_option(demos, DOMAIN, seed)
    found = {each.name: each for each in judge(demos, DOMAIN, Thresholds(), seed, option).criteria}
    row = {
        **{key: parameters[key] for key in ('option', 'model', 'lesson')},
        'demonstrations': len(demos),
        'success': success(option, skill, seed, lesson),
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


def _act(rover: Simulation, action: str) -> None:
    twist = WORLD.file.actions[action].twist
    assert twist is not None
    linear, angular = twist.vectors
    rover.step(linear[0], angular[2], WORLD.file.step)


def _show(
    rover: Simulation, name: str, model: str, number: int, rng: np.random.Generator
) -> Demonstration | None:
    """Return a demonstration from the rover's pose; None if it did not reach the end."""
    person, states = Person(SKILLS[name], SLIPS, rng), [_state(rover, 0, '')]
    while len(states) <= LIMIT:
        action = person.action(rover)
        _act(rover, action)
        states.append(_state(rover, len(states), action))
        if SKILLS[name].done(rover):
            facts = {'option_name': name, 'participant': 'simulated', 'session': 'simulated'}
            chosen = {'chosen_features': SKILLS[name].features, 'method': model}
            demo = demonstration_of(DOMAIN, states, number=number, **facts, **chosen)
            return with_uuid(demo)
    return None


def _state(rover: Simulation, step: int, action: str) -> Transition:
    features = sensed(rover)
    return Transition(
        1, step, WORLD.text(features), features, action, reward=-1.0 if step else 0.0
    )


def _try(rover: Simulation, option: Option, skill: Skill) -> bool:
    """Run an option from a new place; return whether the run is right within its step limit."""
    steps = LIMIT
    while steps == LIMIT:  # skip places from which even the person fails
        _place(rover, skill)
        start, steps, person = rover.pose, 0, Person(skill, 0.0, np.random.default_rng(0))
        while steps < LIMIT and not (steps and skill.done(rover)):
            _act(rover, person.action(rover))
            steps += 1
    rover.place(*start)
    row = np.array([sensed(rover)])
    for _ in range(int(SLOWER * steps)):
        _act(rover, DOMAIN.actions[int(option.action(row)[0])].name)
        row = np.array([sensed(rover)])
        if option.ends(row)[0]:
            return skill.right(rover)
    return False


def success(option: Option, skill: Skill, seed: int, lesson: int) -> float:
    """Return the share of right runs from unseen places, which differ between lessons."""
    rover = Simulation(int(generator(seed, NAME, 'unseen', lesson).integers(2**31)))
    return sum(_try(rover, option, skill) for _ in range(PLACES_TRIED)) / PLACES_TRIED


def present(rows: pd.DataFrame) -> report.Section:
    """Return the report section from one row per lesson."""
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
    facts = {'slips': SLIPS, 'places': PLACES_TRIED, 'seconds': WORLD.file.step}
    return report.Section(NAME, TITLE, found, (), tables, facts)
