"""
The numbers of lessons and plans by seed: only a change that is meant changes them.

``data/numbers_by_seed.json`` has what each seed gave; to write it again after such a change, run
``python tests/test_numbers_by_seed.py``.
"""

from collections.abc import Iterable, Sequence
import hashlib
import json
from pathlib import Path
from typing import Any

from graph_support.scripted import show
from humanopts_env.domains.base import Domain, EnumerableDomain
from humanopts_env.domains.registry import make_domain, reference_options
from humanopts_env.seeding import generator
from humanopts_learner.demonstrations import Demonstration
from humanopts_learner.options.judge import judge, Thresholds
from humanopts_learner.options.learn import learn_option
from humanopts_learner.planning.plan import judge_plan, plan
from humanopts_teach.lesson.in_process import teach
from humanopts_teach.lesson.seeded_starts import LessonRules
from humanopts_teach.lesson.simulated_teacher import TeacherSettings
import pytest

NUMBERS = Path(__file__).parent / 'data' / 'numbers_by_seed.json'
SEEDS = 10
DEMONSTRATIONS = 11  # the criteria need ten
WORLDS: dict[str, tuple[str, dict[str, Any]]] = {
    'taxi': ('taxi', {}),
    'rooms': ('rooms', {}),
    'frozen lake': ('gymnasium:FrozenLake-v1', {'is_slippery': False}),
    'slippery lake': ('gymnasium:FrozenLake-v1', {'is_slippery': True}),
    'cliff': ('gymnasium:CliffWalking-v1', {}),
}


def numbers(world: str, seed: int) -> dict[str, Any]:
    """Teach an option by a teacher who makes errors, judge it, plan with it, play the plan."""
    domain = make_domain(*WORLDS[world])
    assert isinstance(domain, EnumerableDomain)
    known = list(reference_options(domain))
    demonstrations = (
        taught(domain, known[seed % len(known)], seed) if known else shown(domain, seed)
    )
    option, rows = learn_option(demonstrations, domain, seed), domain.feature_table()
    judgement = judge(demonstrations, domain, Thresholds(), seed, option)
    found = {
        'option': digest(option.action(rows), option.can_start(rows), option.ends(rows)),
        'criteria': [each.value for each in judgement.criteria],
        'mean return': [judgement.mean_return_demonstrations, judgement.mean_return_policy],
    }
    for action_set in ('human', 'human+primitive'):
        made = plan(domain, [option], action_set, seed=seed)
        played = judge_plan(made, seed, 50)
        found[action_set] = [
            float(made.solution.values.sum()),
            made.solution.sweeps,
            digest(made.solution.best),
            played.total.mean,
            played.decisions,
        ]
    return found


def taught(domain: Domain, option: str, seed: int) -> Sequence[Demonstration]:
    """Return what a simulated teacher shows of a reference option."""
    teacher = TeacherSettings((option,), error_rate=0.05, seed=seed)
    rules = LessonRules(seed=seed)
    enough = lambda shown, _: len(shown) >= DEMONSTRATIONS  # noqa: E731
    return teach(domain, teacher, rules, enough).demonstrations


def shown(domain: EnumerableDomain, seed: int) -> list[Demonstration]:
    """Return demonstrations of a whole task by its best actions, with an error now and then."""
    best, rng = plan(domain).solution.best, generator(seed, 'numbers by seed')
    demonstrations: list[Demonstration] = []
    while len(demonstrations) < DEMONSTRATIONS:

        def choose(taken: int, here: Any) -> str | None:
            if domain.is_over(here) or taken == 60:
                return None
            errs = rng.random() < 0.05
            action = rng.integers(len(domain.actions)) if errs else best[domain.index(here)]
            return domain.actions[int(action)].name

        demonstrations.append(
            show(
                domain,
                domain.sample_states(rng, 1)[0],
                choose,
                rng,
                participant='anna',
                session='morning',
                option_name='solve it',
                number=len(demonstrations) + 1,
                chosen_features=tuple(feature.name for feature in domain.features),
            )
        )
    return demonstrations


def digest(*arrays: Any) -> str:
    """Return a short digest of integers."""
    return hashlib.sha256(b''.join(a.astype('<i8').tobytes() for a in arrays)).hexdigest()[:12]


def check(world: str, seeds: Iterable[int]) -> None:
    known = json.loads(NUMBERS.read_text('utf-8'))[world]
    for seed in seeds:
        found = json.loads(json.dumps(numbers(world, seed)))
        for name, value in known[str(seed)].items():
            assert found[name] == pytest.approx(value, rel=1e-9), (world, seed, name)


@pytest.mark.parametrize('world', WORLDS)
def test_a_seed_gives_the_same_options_criteria_plans_and_returns(world: str) -> None:
    check(world, range(2))


@pytest.mark.slow
@pytest.mark.parametrize('world', WORLDS)
def test_more_seeds_give_the_same_options_criteria_plans_and_returns(world: str) -> None:
    check(world, range(2, SEEDS))


if __name__ == '__main__':
    every = {world: {seed: numbers(world, seed) for seed in range(SEEDS)} for world in WORLDS}
    NUMBERS.write_text(json.dumps(every, indent=1) + '\n', 'utf-8')
