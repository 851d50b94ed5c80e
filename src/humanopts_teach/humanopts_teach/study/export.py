"""The files of ``study export``: tables, and the files needed to interpret them."""

import json
from pathlib import Path

from humanopts_learner.demonstrations import Demonstration, each_once, Kind
from humanopts_learner.spreadsheet import csv_of, EXCEL
from humanopts_teach.evaluation.table1 import ButtonTable, count_named, Named, table_text
from humanopts_teach.study.codebook import codebook_table
from humanopts_teach.study.events import last_attempts
from humanopts_teach.study.spss import write_sav
from humanopts_teach.study.tables import begun_options, described_columns, StudyData, tables

ANALYSIS = 'analysis.R'


def write_study(data: StudyData, out: Path, *, excel: bool = False) -> list[Path]:
    """
    Write the tables (CSV and SPSS), codebook, protocol, Table 1 and an analysis in R.

    :param excel: whether to write a byte order mark in CSV files.
    :return: the files, in the order written.
    :raises OSError: the folder cannot be written.
    """
    found = tables(data)
    texts = {f'{name}.csv': csv_of(table) for name, table in found.items()}
    versions = [each.model_dump(mode='json', exclude_none=True) for each in data.protocol.versions]
    texts |= {
        'codebook.csv': csv_of(codebook_table()),
        'protocol.json': f'{json.dumps(versions, indent=1)}\n',
        'table1.txt': f'{table_text(suggested(data))}\n',
        ANALYSIS: (Path(__file__).parent / ANALYSIS).read_text('utf-8'),
    }
    out.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        coding = EXCEL if excel and name.endswith('.csv') else 'utf-8'
        (out / name).write_bytes(text.encode(coding))
    paths = [out / name for name in texts]
    for name, table in found.items():
        path = out / f'{name}.sav'
        columns = described_columns(name, [dict.fromkeys(map(str, table))])
        write_sav(table, path, columns, f'{name} of the study')
        paths.append(path)
    return paths


def suggested(data: StudyData) -> list[ButtonTable]:
    """Return the paper's Table 1: the buttons that people suggested or taught."""
    named: dict[tuple[str, str, str], bool] = {}  # by domain, participant and text
    for record in data.records:
        plan = data.plan_of(record)
        for condition in plan.order_of(record.place) if plan is not None else ():
            who = condition.domain, record.code
            entries = data.lessons.get((record.code, condition.name), ())
            given = each_once(each for each in entries if isinstance(each, Demonstration))
            shown = {d.option_name for d in given if d.kind is Kind.TRAJECTORY and not d.withdrawn}
            texts = [e.text for e in last_attempts(record.events) if e.condition == condition.name]
            for text in ('', *filter(None, texts), *begun_options(entries)):
                named[(*who, text)] = named.get((*who, text), False) or text in shown
    named_options = [Named(*key, taught) for key, taught in named.items()]
    return count_named(named_options, data.wordings)
