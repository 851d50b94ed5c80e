"""The data set of a domain on disk, and the options learned from it as it grows."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from humanopts_env.domains.base import ActableDomain
from humanopts_learner.append_only_log import AppendOnlyLog, link_remark
from humanopts_learner.demonstrations import (
    check_demonstration,
    Demonstration,
    each_once,
    group_by_option,
    Kind,
    shown,
)
from humanopts_learner.options.exam import with_verdicts
from humanopts_learner.options.files import (
    option_from_json,
    option_to_json,
    remove_option,
    save_option,
)
from humanopts_learner.options.judge import judge, taught_before, Thresholds
from humanopts_learner.options.learn import learn_option, NotLearnableError
from humanopts_learner.options.learned_option import LearnedOption
from humanopts_learner.summary import OptionSummary, unmeasured

DATA_SET = 'demonstrations.jsonl'


class DataSetError(RuntimeError):
    """The data set cannot be read or written; the message says why."""


@dataclass(frozen=True, slots=True)
class TaughtOption:
    """
    One option of one participant.

    All are kept in memory, so they contain neither demonstrations nor deserialized trees.
    """

    summary: OptionSummary
    file: str  # serialized option without demonstrations; empty: no trajectory left

    @property
    def option(self) -> LearnedOption | None:
        """The deserialized option; None: no trajectory left."""
        return option_from_json(self.file)[0] if self.file else None


class OptionTrainer:
    """
    All demonstrations of a domain, kept on disk, and the options learned from them.

    Only the demonstrations of the current participant are in memory; those of others are read
    from disk when needed.
    """

    def __init__(
        self, directory: Path, domain: ActableDomain, thresholds: Thresholds, seed: int
    ) -> None:
        """
        Open the folder and relearn all options from its contents.

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
        self.problems = self._log.problems  # unusable parts of the folder
        if remark := link_remark(directory):
            self.problems.append(remark)
        read = self._read()
        self._withdrawn = {demo.uuid: demo.withdrawn for demo in read}  # by uuid
        self._participant: str | None = None
        self._demonstrations: dict[str, Demonstration] = {}  # of the current participant, by uuid
        people: dict[str, list[Demonstration]] = {}
        for demo in read:
            people.setdefault(demo.participant, []).append(demo)
        for who, name in dict.fromkeys((demo.participant, demo.option_name) for demo in read):
            self._learn(who, name, people[who])

    def take(self, demo: Demonstration) -> bool:
        """
        Store a demonstration, a judged run or a withdrawal, and relearn or judge its option.

        :return: False: already known or withdrawn, so nothing changed.
        :raises DemonstrationError: the demonstration is invalid and was not stored.
        :raises DataSetError: writing failed.
        """
        known = self._withdrawn.get(demo.uuid)
        if known is not None and known >= demo.withdrawn:
            return False
        check_demonstration(demo, self._domain)
        self._switch_to(demo.participant)
        try:
            self._log.append(demo.to_json())
        except OSError as error:
            raise DataSetError(f'cannot write {self._log.path}: {error.strerror}') from error
        self._demonstrations[demo.uuid], self._withdrawn[demo.uuid] = demo, demo.withdrawn
        self._learn(demo.participant, demo.option_name, self._demonstrations.values(), demo)
        return True

    def options(self) -> list[TaughtOption]:
        """Return all options, in order of first demonstration."""
        return list(self._options.values())

    def _read(self, participant: str | None = None) -> list[Demonstration]:
        """Return all demonstrations on disk, or those of one participant, without duplicates."""

        def checked(line: str) -> Demonstration | None:
            demo = Demonstration.from_json(line)
            if participant not in (None, demo.participant):
                return None
            check_demonstration(demo, self._domain)
            return demo

        return each_once(filter(None, self._log.read(checked)))

    def _switch_to(self, participant: str) -> None:
        """
        Load the demonstrations of a participant, replacing those in memory.

        :raises DataSetError: the data set cannot be read.
        """
        if participant == self._participant:
            return
        read = []
        if any(who == participant for who, _ in self._options):
            try:
                read = self._read(participant)
            except OSError as error:
                raise DataSetError(f'cannot read {self._log.path}: {error.strerror}') from error
        self._demonstrations, self._participant = {demo.uuid: demo for demo in read}, participant

    def _learn(
        self,
        participant: str,
        option_name: str,
        demonstrations: Iterable[Demonstration],
        news: Demonstration | None = None,
    ) -> None:
        """
        Learn an option, or remove it if it has no demonstrations left.

        A judged run changes only the summary of the option.

        :param demonstrations: all demonstrations and judged runs of the participant.
        :param news: the only change since the last call; None: anything may have changed.
        """
        key = participant, option_name
        every = list(demonstrations)
        demos = group_by_option(every).get(key, [])
        known = self._options.get(key)
        if not shown(demos):
            self._unlearn(*key)
            self._options.pop(key, None)
        elif known and news and news.kind is Kind.JUDGED and (option := known.option):
            if news.exam and not news.withdrawn:
                summary = with_verdicts(known.summary, demos, self._thresholds.exam)
            else:
                summary = self._judge(demos, option, every)
            self._options[key] = replace(known, summary=summary)
            self._save(option, demos, summary)
        else:
            self._options[key] = self._learned(demos, every)

    def _learned(self, demos: list[Demonstration], every: list[Demonstration]) -> TaughtOption:
        """Learn an option, judge it and write its file."""
        summary = unmeasured(demos)
        try:
            option = learn_option(demos, self._domain, self._seed)
        except NotLearnableError:
            self._unlearn(summary.participant, summary.option_name)
            return TaughtOption(summary, '')
        summary = self._judge(demos, option, every)
        self._save(option, demos, summary)
        return TaughtOption(summary, option_to_json(option, []))

    def _judge(
        self, demos: list[Demonstration], option: LearnedOption, every: list[Demonstration]
    ) -> OptionSummary:
        """Judge an option; ``every`` contains all demonstrations of the participant."""
        before = taught_before(option.name, every, self._domain, self._seed)
        return judge(demos, self._domain, self._thresholds, self._seed, option, before)

    def _save(
        self, option: LearnedOption, demos: list[Demonstration], summary: OptionSummary
    ) -> None:
        """Write the file of an option."""
        try:
            save_option(self._directory, option, shown(demos), summary.status)
        except OSError as error:
            self.problems.append(f'cannot write the file of {option.name!r}: {error}')

    def _unlearn(self, participant: str, option_name: str) -> None:
        """Remove the file of an option, after its demonstrations were withdrawn."""
        try:
            remove_option(self._directory, participant, option_name)
        except OSError as error:
            self.problems.append(f'cannot remove the file of {option_name!r}: {error}')
