"""The option runs of a bag, in the format of ``planner``."""

from functools import partial
from pathlib import Path
from typing import Any

from humanopts_env.game import transition_from_message
from humanopts_learner.option_runs import (
    OPTION_RUNS,
    OptionRun,
    result_from_message,
    RunCollector,
    RunLog,
    uuid_of,
)
from humanopts_ros.recording import INTERFACES
from humanopts_teach.bags.contents import read_description, STATE_COPY
from humanopts_teach.bags.reader import Bag, GAME_STATE

_GOAL, _RESULT = f'{INTERFACES}msg/OptionGoal', f'{INTERFACES}msg/OptionResult'


def write_option_runs(bag: Bag, out: Path) -> tuple[Path, int]:
    """
    Add the option runs of a bag to a file of runs.

    :param out: folder of the file; created if missing.
    :return: the file, and the number of added runs.
    :raises BagError: the bag contains no domain, several, or an invalid one.
    :raises OSError: the file cannot be read or written.
    """
    domain = read_description(bag)
    log, collector = RunLog(out, domain), RunCollector(domain)
    before, known = len(log.runs), {run.run_id for run in log.runs}
    topics = [
        topic
        for kind in (_GOAL, _RESULT, GAME_STATE)
        for topic in bag.of_type(kind)
        if not topic.endswith(STATE_COPY)
    ]

    def complete(kind: str, message: Any) -> list[OptionRun]:
        if kind == _GOAL:
            collector.on_goal(uuid_of(message.run_id), message.participant)
            return []
        if kind == _RESULT:
            return collector.on_result(result_from_message(message))
        return collector.on_state(message.publisher_id, transition_from_message(message))

    for recorded in filter(bag.is_genuine, bag.messages(topics)):
        kind = bag.topics[recorded.topic].type
        for run in recorded.convert(partial(complete, kind)) or ():
            if run.run_id not in known:
                log.add(run)
    return out / OPTION_RUNS, len(log.runs) - before
