"""Tables as files of SPSS, with labels of columns and values."""

from collections.abc import Mapping
from pathlib import Path

from humanopts_teach.study.codebook import Column
import numpy as np
import pandas as pd

MAX_CODES = 120  # a nominal column with more values stays text
_MEASURES = {'id': 'nominal', 'text': 'nominal'}


def write_sav(table: pd.DataFrame, path: Path, columns: Mapping[str, Column], title: str) -> None:
    """
    Write a table.

    Nominal columns become numbers from 0 with their texts as labels, since many SPSS procedures
    do not accept text. 'no' is 0 and 'yes' is 1; other values are numbered in order of appearance.

    :param columns: descriptions, by name.
    :raises OSError: the file cannot be written.
    """
    import pyreadstat  # optional

    data, values = table.copy(), dict[str, dict[float, str]]()
    for name in table:
        column, found = columns[str(name)], table[name]
        if column.level != 'nominal':
            if not pd.api.types.is_numeric_dtype(found):
                numbers = column.level in ('scale', 'ordinal')
                data[name] = (
                    pd.to_numeric(found)
                    if numbers
                    else found.astype(object).where(found.notna(), '').map(str)
                )
            continue
        words = found.astype(object).where(found.notna(), '').map(str)
        known = [word for word in words.unique() if word]
        coded = ['no', 'yes'] if {*known} <= {'no', 'yes'} else known
        if len(coded) <= MAX_CODES:
            codes = {word: float(code) for code, word in enumerate(coded)}
            data[name] = words.map(lambda word, codes=codes: codes.get(word, np.nan))
            values[str(name)] = {code: word for word, code in codes.items()}
        else:
            data[name] = words
    pyreadstat.write_sav(
        data,
        str(path),
        file_label=title[:64],
        row_compress=True,
        column_labels={name: columns[name].label for name in map(str, table)},
        variable_value_labels=values,
        variable_measure={
            name: _MEASURES.get(level := columns[name].level, level) for name in map(str, table)
        },
    )
