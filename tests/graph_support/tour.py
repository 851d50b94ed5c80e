"""Options of Taxi that are worth interrupting: one of them drives past the passenger."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from humanopts_env.domains.registry import reference_options
from humanopts_learner.options.learn import learn_option
from humanopts_learner.options.option import LearnedOption, options_from_references
from humanopts_learner.planning.exact import ExactPlan, option_table
from humanopts_learner.planning.interruption import as_executed
from humanopts_learner.planning.request import Execution

from graph_support.scripted import DELIVER, TAXI, walk

TOUR, USE = 'tour', 'pickup/dropoff'
LAST = ['north'] * 2 + ['east'] * 2 + ['south'] * 4 + ['west']  # by G to B
WAYS = {
    '4,0': ['north'] * 4 + ['east'] + ['south'] * 2 + ['east'] + LAST,
    '4,1': ['north'] * 2 + ['east'] + LAST,
    '4,2': ['north'] * 2 + LAST,
    '3,3': ['north'] * 3 + LAST[3:],
    '0,1': ['south'] * 2 + ['east'] + LAST,
}


def touring() -> list[LearnedOption]:
    """Return a tour of the landmarks, which ends at B, and what helps with passengers."""
    demos = [
        walk(f'taxi {cell} passenger G destination B', way, TOUR, ['taxi_row', 'taxi_col'])
        for cell, way in WAYS.items()
    ]
    known = reference_options(TAXI)
    ready = options_from_references(TAXI, [known[USE], known[DELIVER]])
    return [learn_option(demos, TAXI, 0), *(replace(o, participant='p1') for o in ready)]


@dataclass(frozen=True)
class Step:
    """One step of an episode, and what the policy did before it."""

    state: str  # that it led to
    action: str
    actor: str  # whose action it was
    reward: float
    began: bool  # a decision was made before it
    stopped: bool  # and what ran was stopped for it


def steps(plan: ExactPlan, execution: Execution, start: int, limit: int) -> Iterator[Step]:
    """Play an episode by the tables of the vectorised play, which the runner never sees."""
    acting, rules = as_executed(plan, execution), TAXI.transitions()
    does = option_table(plan.domain, plan.action_set, plan.options).action
    at, column, stopped = start, -1, False
    for _ in range(limit):
        began = column < 0
        column = int(acting.solution.best[at]) if began else column
        action = int(does[column, at])
        last = (at, action, 0)
        reward, over = float(rules.reward[last]), bool(rules.terminated[last])
        at = int(rules.successor[last])
        text = TAXI.encode(TAXI.state_at(at))
        names = TAXI.actions[action].name, plan.names[column]
        yield Step(text, *names, reward, began, stopped)
        if over:
            return
        ends = stopped = False
        if column < len(plan.options):
            ends = bool(plan.options[column].termination[at])
            stopped = not ends and bool(acting.options[column].termination[at])
        modules = execution in (Execution.MODULAR_MASS, Execution.MODULAR_STRONGEST)
        stopped = stopped and not modules
        if ends or stopped or modules or column >= len(plan.options):
            column = -1
