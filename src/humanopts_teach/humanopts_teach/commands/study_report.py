"""``humanopts study report``: the report of a study, one HTML file."""

from pathlib import Path
import time

from humanopts_teach.commands import CommandError, refusing
from humanopts_teach.evaluation.summary import SummaryError, write_text
from humanopts_teach.study.record import StudyFolder
from humanopts_teach.study.report import study_report
from humanopts_teach.study.tables import read_study


def write_report(folder: StudyFolder, out: Path) -> list[str]:
    """
    Write the report of a study.

    :return: descriptions of what was left out.
    :raises CommandError: no one has taken part yet, or the file cannot be written.
    """
    data, problems = read_study(folder, time.time())
    if not data.records:
        raise CommandError(
            f'no one has taken part yet in {folder.path}; --study DIR names another'
        )
    with refusing(SummaryError):
        write_text(out, study_report(data))
    return problems
