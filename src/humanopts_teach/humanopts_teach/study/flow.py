"""The flow of participants through a study, as in CONSORT (Schulz, Altman and Moher 2010)."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from humanopts_teach.study.tables import StudyData
import pandas as pd


@dataclass(frozen=True)
class ConditionFlow:
    """The participants of one condition."""

    name: str
    assigned: int  # participants with this condition in their order
    taught: int  # began to teach in this condition
    finished: int  # finished teaching in this condition
    left: int  # dropped out or under way, last seen in this condition


@dataclass(frozen=True)
class Flow:
    """Numbers of people; every visitor has exactly one final state."""

    declined: int
    full: int  # arrived when all places were taken
    withdrawn: int  # their data were deleted
    excluded: int  # failed too many attention checks
    dropped_out: int
    under_way: int
    finished: int
    conditions: tuple[ConditionFlow, ...]

    @property
    def began(self) -> int:
        """People who agreed to take part."""
        left = self.withdrawn + self.excluded + self.dropped_out + self.under_way
        return left + self.finished

    @property
    def assessed(self) -> int:
        """People who opened the first page."""
        return self.declined + self.full + self.began


def flow_of(data: StudyData, found: Mapping[str, pd.DataFrame]) -> Flow:
    """
    Count the participants, and those whose data were deleted or never stored.

    :param found: the tables of the study.
    """
    states = Counter(data.state_of(record) for record in data.records)
    rows, people = found['conditions'], found['participants']
    left = people[people['state'].isin(['under way', 'dropped out'])]['left']
    parts = found['parts'].drop_duplicates('part').set_index('part')['condition']
    gone = Counter(left.map(parts))
    conditions = []
    for name, own in rows.groupby('condition', sort=False):
        count = {key: int((own[key] == 'yes').sum()) for key in ('reached', 'finished')}
        conditions.append(
            ConditionFlow(str(name), len(own), count['reached'], count['finished'], gone[name])
        )
    return Flow(
        declined=data.log.people('declined'),
        full=data.log.people('full'),
        withdrawn=data.log.people('withdrawn'),
        excluded=states['excluded'],
        dropped_out=states['dropped out'],
        under_way=states['under way'],
        finished=states['finished'],
        conditions=tuple(conditions),
    )
