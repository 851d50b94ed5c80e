"""``humanopts study report``: the report of a study, one HTML file."""

from pathlib import Path
import time

from humanopts_teach.commands import CommandError, refusing
from humanopts_teach.evaluation.summary import SummaryError, write_text
from humanopts_teach.evaluation.table1 import MergeError, read_merge
from humanopts_teach.study.record import StudyFolder
from humanopts_teach.study.report import study_report
from humanopts_teach.study.tables import read_study


def merged_wordings(path: Path | None) -> dict[str, str]:
    """
    Return the canonical names in a file of wordings, as from ``read_merge``; empty: no file.

    :raises CommandError: the file cannot be used.
    """
    with refusing(MergeError, what=f'{path}: '):
        return read_merge(path) if path is not None else {}


def write_report(folder: StudyFolder, out: Path, merge: Path | None = None) -> list[str]:
    """
    Write the report of a study.

    :param merge: file of wordings of buttons with the same meaning; None: none.
    :return: descriptions of omissions.
    :raises CommandError: no one has taken part yet, or the file cannot be written.
    """
    data, problems = read_study(folder, time.time(), merged_wordings(merge))
    if not data.records:
        raise CommandError(
            f'no one has taken part yet in {folder.path}; --study DIR names another'
        )
    with refusing(SummaryError):
        write_text(out, study_report(data))
    return problems
