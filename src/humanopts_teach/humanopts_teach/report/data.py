"""What a report is made of; every number in it comes from here."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from humanopts_teach.evaluation.bag_evaluation import BagEvaluation
from humanopts_teach.evaluation.summary import Summary


@dataclass(frozen=True)
class Frame:
    """One step of an episode."""

    state: str  # in the domain's notation
    action: str = ''  # that led here; empty in the first frame
    reward: float = 0.0
    option: str = ''  # that was running; empty: none
    ends_run: bool = False  # the option's run ended here


@dataclass(frozen=True)
class TopicRow:
    """One recorded topic."""

    name: str
    type: str
    messages: int
    publishers: int | None = None  # that number their messages; None: they carry no numbers
    lost: int | None = None  # by gaps in the numbers; None: cannot be told


@dataclass(frozen=True)
class ReportData:
    """One report. Parts that are empty are left out of it."""

    title: str
    evaluation: BagEvaluation
    summary: Summary | None = None  # what was seen live
    frames: Sequence[Frame] = ()  # one episode
    topics: Sequence[TopicRow] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)  # name -> text, such as versions
