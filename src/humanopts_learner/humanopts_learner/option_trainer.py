"""The data set of a domain on disk, and the options that are learned from it as it grows."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from humanopts_env.domains.base import ActableDomain
from humanopts_learner.append_only_log import AppendOnlyLog, link_remark
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    each_once,
    group_by_option,
)
from humanopts_learner.options.files import (
    option_from_json,
    option_to_json,
    remove_option,
    save_option,
)
from humanopts_learner.options.judge import judge, Thresholds
from humanopts_learner.options.learn import learn_option, NotLearnableError
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.summary import OptionSummary, unmeasured

DATA_SET = 'demonstrations.jsonl'


class DataSetError(RuntimeError):
    """The data set cannot be read or written; the text says why."""


@dataclass(frozen=True, slots=True)
class TaughtOption:
    """
    One option of one participant.

    One is kept for every option ever taught, so it holds no demonstrations and no trees.
    """

    summary: OptionSummary
    file: str  # the option as data, without its demonstrations; empty while no trajectory is left

    @property
    def option(self) -> LearnedOption | None:
        """The option, read from its data; None while no trajectory is left."""
        return option_from_json(self.file)[0] if self.file else None


class OptionTrainer:
    """
    All demonstrations of a domain, kept on disk, and the options learned from them.

    Only the demonstrations of the current participant are in memory; those of another are read
    from disk when that one continues.
    """

    def __init__(
        self, directory: Path, domain: ActableDomain, thresholds: Thresholds, seed: int
    ) -> None:
        """
        Open the folder and learn again from what it holds.

        :raises DataSetError: the folder cannot be used.
        """
        self._directory, self._domain = directory, domain
        self._thresholds, self._seed = thresholds, seed
        self._options: dict[tuple[str, str], TaughtOption] = {}
        try:
            directory.mkdir(parents=True, exist_ok=True)
            self._log = AppendOnlyLog(directory / DATA_SET)
        except OSError as error:
            raise DataSetError(f'cannot use the folder {directory}: {error.strerror}') from error
        self.problems = self._log.problems  # parts of the folder that could not be used, in words
        if remark := link_remark(directory):
            self.problems.append(remark)
        read = self._read()
        self._withdrawn = {demo.uuid: demo.withdrawn for demo in read}  # of all that are known
        self._at_work: str | None = None
        self._theirs: dict[str, Demonstration] = {}  # of the participant at work, by uuid
        people: dict[str, list[Demonstration]] = {}
        for demo in read:
            people.setdefault(demo.participant, []).append(demo)
        for who, name in dict.fromkeys((demo.participant, demo.option_name) for demo in read):
            self._learn(who, name, people[who])

    def take(self, demo: Demonstration) -> bool:
        """
        Keep a demonstration and learn from it, or from what is left when it is withdrawn.

        :return: False: it is known already, or was withdrawn; nothing changed.
        :raises DemonstrationError: it cannot be used; it is not kept.
        :raises DataSetError: it could not be written; it is not kept.
        """
        known = self._withdrawn.get(demo.uuid)
        if known is not None and known >= demo.withdrawn:
            return False
        check_demonstration(demo, self._domain)
        self._turn_to(demo.participant)
        try:
            self._log.append(demo.to_json())
        except OSError as error:
            raise DataSetError(f'cannot write {self._log.path}: {error.strerror}') from error
        self._theirs[demo.uuid], self._withdrawn[demo.uuid] = demo, demo.withdrawn
        self._learn(demo.participant, demo.option_name, self._theirs.values())
        return True

    def options(self) -> list[TaughtOption]:
        """Return every option, in order of first demonstration."""
        return list(self._options.values())

    def _read(self, participant: str | None = None) -> list[Demonstration]:
        """Return the demonstrations on disk, each once: all, or those of one participant."""

        def checked(line: str) -> Demonstration | None:
            demo = Demonstration.from_json(line)
            if participant not in (None, demo.participant):
                return None
            check_demonstration(demo, self._domain)
            return demo

        return each_once(filter(None, self._log.read(checked)))

    def _turn_to(self, participant: str) -> None:
        """
        Load the demonstrations of a participant in place of those of another.

        :raises DataSetError: they cannot be read.
        """
        if participant == self._at_work:
            return
        read = []
        if any(who == participant for who, _ in self._options):
            try:
                read = self._read(participant)
            except OSError as error:
                raise DataSetError(f'cannot read {self._log.path}: {error.strerror}') from error
        self._theirs, self._at_work = {demo.uuid: demo for demo in read}, participant

    def _learn(self, participant: str, option_name: str, theirs: Iterable[Demonstration]) -> None:
        """
        Learn an option, or remove it if no demonstration is left.

        :param theirs: all demonstrations of the participant.
        """
        key = participant, option_name
        demos = group_by_option(theirs).get(key, [])
        if not demos:
            self._unlearn(*key)
            self._options.pop(key, None)
            return
        summary, file = unmeasured(demos), ''
        try:
            option = learn_option(demos, self._domain, self._seed)
        except NotLearnableError:
            self._unlearn(*key)
        else:
            summary = judge(demos, self._domain, self._thresholds, self._seed, option)
            try:
                save_option(self._directory, option, demos)
            except OSError as error:
                self.problems.append(f'cannot write the file of {option_name!r}: {error}')
            file = option_to_json(option, [])
        self._options[key] = TaughtOption(summary, file)

    def _unlearn(self, participant: str, option_name: str) -> None:
        """Remove the file of an option that was learned from demonstrations now withdrawn."""
        try:
            remove_option(self._directory, participant, option_name)
        except OSError as error:
            self.problems.append(f'cannot remove the file of {option_name!r}: {error}')
