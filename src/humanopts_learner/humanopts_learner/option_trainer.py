"""The data set of a domain on disk, and the options that are learned from it as it grows."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from humanopts_env.domains.base import Domain
from humanopts_learner.append_only_log import AppendOnlyLog, link_remark
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    each_once,
    group_by_option,
)
from humanopts_learner.options.criteria import judge, Judgement, Thresholds
from humanopts_learner.options.files import option_to_json, remove_option, save_option
from humanopts_learner.options.learn import learn_option, NotLearnableError
from humanopts_learner.options.option import LearnedOption

DATA_SET = 'demonstrations.jsonl'


class DataSetError(RuntimeError):
    """The data set cannot be read or written; the text says why."""


@dataclass(frozen=True)
class OptionProgress:
    """The demonstrations of one option of one participant, and what is learned from them."""

    demonstrations: list[Demonstration]
    option: LearnedOption | None  # None while there is no trajectory
    judgement: Judgement | None
    file: str  # the option as data, without its demonstrations; empty without an option


class OptionTrainer:
    """All demonstrations of a domain, kept on disk, and the options learned from them."""

    def __init__(
        self, directory: Path, domain: Domain[Any], thresholds: Thresholds, seed: int
    ) -> None:
        """
        Open the folder and learn again from what it holds.

        :raises DataSetError: the folder cannot be used.
        """
        self._directory, self._domain = directory, domain
        self._thresholds, self._seed = thresholds, seed
        self._progress: dict[tuple[str, str], OptionProgress] = {}
        try:
            directory.mkdir(parents=True, exist_ok=True)
            self._log = AppendOnlyLog(directory / DATA_SET)
        except OSError as error:
            raise DataSetError(f'cannot use the folder {directory}: {error.strerror}') from error
        self.problems = self._log.problems  # parts of the folder that could not be used, in words
        if remark := link_remark(directory):
            self.problems.append(remark)
        read = each_once(self._log.read(self._checked))
        self._demos = {demo.uuid: demo for demo in read}
        for key in dict.fromkeys((demo.participant, demo.option_name) for demo in read):
            self._learn(*key)

    def take(self, demo: Demonstration) -> bool:
        """
        Keep a demonstration and learn from it, or from what is left when it is withdrawn.

        :return: False when it is known already, or was withdrawn, and nothing changed.
        :raises DemonstrationError: it cannot be used; it is not kept.
        :raises DataSetError: it could not be written; it is not kept.
        """
        known = self._demos.get(demo.uuid)
        if known is not None and known.withdrawn >= demo.withdrawn:
            return False
        check_demonstration(demo, self._domain)
        try:
            self._log.append(demo.to_json())
        except OSError as error:
            raise DataSetError(f'cannot write {self._log.path}: {error.strerror}') from error
        self._demos[demo.uuid] = demo
        self._learn(demo.participant, demo.option_name)
        return True

    def progress(self) -> list[OptionProgress]:
        """Return the progress of every option, in order of first demonstration."""
        return list(self._progress.values())

    def _checked(self, line: str) -> Demonstration:
        demo = Demonstration.from_json(line)
        check_demonstration(demo, self._domain)
        return demo

    def _learn(self, participant: str, option_name: str) -> None:
        key = participant, option_name
        mine = (d for d in self._demos.values() if (d.participant, d.option_name) == key)
        demos = group_by_option(mine).get(key, [])
        try:
            option = learn_option(demos, self._domain, self._seed)
        except NotLearnableError:
            self._unlearn(participant, option_name, demos)
            return
        judgement = judge(demos, self._domain, self._thresholds, self._seed, option)
        try:
            save_option(self._directory, option, demos)
        except OSError as error:
            self.problems.append(f'cannot write the file of {option_name!r}: {error}')
        file = option_to_json(option, [])
        self._progress[key] = OptionProgress(demos, option, judgement, file)

    def _unlearn(self, participant: str, option_name: str, demos: list[Demonstration]) -> None:
        """Remove the option that was learned from demonstrations that are withdrawn now."""
        try:
            remove_option(self._directory, participant, option_name)
        except OSError as error:
            self.problems.append(f'cannot remove the file of {option_name!r}: {error}')
        if demos:
            self._progress[participant, option_name] = OptionProgress(demos, None, None, '')
        else:
            self._progress.pop((participant, option_name), None)
