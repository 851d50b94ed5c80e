"""How long the graph takes for a step and for an option, beside bare rclpy."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

from humanopts_env.domains.taxi import Taxi
from humanopts_learner.options.files import save_option
from humanopts_learner.options.option import LearnedOption
from humanopts_learner.options.rollout import rollouts
from humanopts_teach.launching.processes import processes, Setup
import numpy as np

from benchmarks.measure import compare, OnMeasured, read_records, Row
from benchmarks.planning import TaxiCase
from benchmarks.processes import bench_spec, launched, wait

SIDE = 5  # of the Taxi grid
LENGTHS = (1, 8)  # steps of the runs that are timed
_SECONDS = 300.0  # at most, for all rounds
_NODES = ('game', 'option_server')
BARE_STEP = 'the same two messages, a bare node'
BARE = {
    'service': 'a bare service of the same type',
    'action': 'a bare action of the same type',
}
NAMES = {'service': 'run_option', 'action': 'execute_option, goal to result'}


@dataclass(frozen=True)
class GraphSizes:
    """How much is measured; one more round comes first, and is not counted."""

    rounds: int = 10
    steps: int = 150  # a round; Taxi cuts an episode off after 200
    calls: int = 20  # of each kind, a round


def graph_rows(folder: Path, progress: OnMeasured, sizes: GraphSizes = GraphSizes()) -> list[Row]:
    """
    Measure game and option_server from another process, in turns with a bare peer in a third.

    :param folder: for files that nobody needs afterwards.
    :raises LaunchError: a process died, or is not done in time.
    """
    progress(0.0, 'starting the nodes')
    setup = Setup('taxi', folder, {'rows': SIDE, 'cols': SIDE}, teach=False, record=False)
    option = TaxiCase(SIDE).learned[0]
    save_option(setup.options, option, ())
    results = folder / 'latencies.jsonl'
    plan = {
        'rounds': sizes.rounds,
        'steps': sizes.steps,
        'calls': sizes.calls,
        'option': option.name,
        'runs': [{'steps': k, 'state': start_of(option, k)} for k in LENGTHS],
    }
    client = bench_spec('bench_client', results=str(results), plan=json.dumps(plan))
    specs = [spec for spec in processes(setup) if spec.name in _NODES]
    rounds: list[dict[str, Any]] = []

    def done() -> bool:
        rounds[:] = read_records(results)
        if rounds:
            progress(rounds[-1]['share'], 'steps, services and actions over ROS')
        return len(rounds) > sizes.rounds

    with launched([*specs, bench_spec('bench_peer'), client], folder / 'log') as launcher:
        wait(launcher, done, _SECONDS, 'the latencies')
    return latencies([found['samples'] for found in rounds if found['counted']])


def latencies(rounds: Sequence[Mapping[str, Sequence[float]]]) -> list[Row]:
    """
    Set each kind of latency beside its bare form.

    :param rounds: samples, s, by what they are of: ``step``, ``service K`` and ``action K`` of K
        steps, and the same after ``bare``.
    """
    samples: dict[str, list[float]] = defaultdict(list)
    for found in rounds:
        for name, seconds in found.items():
            samples[name] += seconds
    bare_step = samples['bare step']
    rows = [compare('a command, to the next state', samples['step'], BARE_STEP, bare_step)]
    for via, name in NAMES.items():
        for k in LENGTHS:
            own, facts = samples[f'{via} {k}'], {'steps': k}
            what = f'{name}, {k} step' + 's' * (k > 1)
            rows.append(compare(what, own, BARE[via], samples[f'bare {via}'], facts=facts))
            if k > 1:
                each = (np.array(own) / k).tolist()
                rows.append(compare(f'{what}: a step', each, BARE_STEP, bare_step, facts=facts))
    return rows


def start_of(option: LearnedOption, steps: int) -> str:
    """Return the first start state of Taxi from which an option takes so many steps to its end."""
    domain = Taxi(SIDE, SIDE)
    states = [domain.state_at(int(index)) for index in domain.start_states()]
    runs = rollouts(option, domain, states)
    found = np.flatnonzero(runs.reached & (runs.steps == steps))
    return domain.encode(states[int(found[0])])
