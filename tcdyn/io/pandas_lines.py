"""A line of Python with pandas that changes a table, for the remedy of an error message."""

from __future__ import annotations

import re
from pathlib import Path

from tcdyn.io.read import PARQUET_ENDINGS, CsvTable
from tcdyn.io.table import Table

# What a shell may change inside double quotes, and what ends them.
_UNSAFE = re.compile(r"[\"$`\\!\n]")


def pandas_line(table: Table | None, expression: str, ending: str, as_text: bool) -> str:
    """Return the line that reads a table as ``d`` and writes the value of an expression.

    Parameters
    ----------
    table
        The table; None for one in memory.
    expression
        An expression of ``d``, the table of pandas.
    ending
        End of the name of the new file.
    as_text
        Whether cells are read and written as they are, not as numbers.

    Returns
    -------
    str
        The command for a shell; for data in memory, and for a file that pandas does not read as
        simply, the expression alone.
    """
    if table is None:
        return f"{expression}, where d is the DataFrame"
    path = table.dialect.path if isinstance(table, CsvTable) else Path(table.where)
    plain_ending = re.sub(r"[^\w.-]+", "_", ending)
    if isinstance(table, CsvTable):
        out = path.with_name(f"{path.stem}_{plain_ending}.csv")
        read, write = _csv_calls(table, out, as_text)
    elif path.suffix.lower() in PARQUET_ENDINGS:
        out = path.with_name(f"{path.stem}_{plain_ending}.parquet")
        read = f"pd.read_parquet({str(path)!r})"
        write = f".to_parquet({str(out)!r})"
    else:
        return f"{expression}, where d is the table as a DataFrame"
    code = f"import pandas as pd; d = {read}; ({expression}){write}"
    if _UNSAFE.search(code):
        return f"{expression}, where d is the table as a DataFrame"
    return f'python -c "{code}"'


def _csv_calls(table: CsvTable, out: Path, as_text: bool) -> tuple[str, str]:
    """The calls of pandas that read a text log, and that write its rows."""
    dialect = table.dialect
    options = []
    written = ["index=False"]
    if as_text:
        options.append("dtype=str, keep_default_na=False")
    if dialect.separator != ",":
        separator = "chr(9)" if dialect.separator == "\t" else repr(dialect.separator)
        options.append(f"sep={separator}")
        written.append(f"sep={separator}")
    if dialect.decimal != "." and not as_text:
        options.append(f"decimal={dialect.decimal!r}")
        written.append(f"decimal={dialect.decimal!r}")
    if dialect.encoding not in ("utf-8", "utf-8-sig"):
        options.append(f"encoding={dialect.encoding!r}")
    if dialect.skip != 1:
        options.append(f"skiprows={dialect.skip}, header=None, names={list(dialect.names)!r}")
    arguments = "".join(f", {option}" for option in options)
    read = f"pd.read_csv({str(dialect.path)!r}{arguments})"
    return read, f".to_csv({str(out)!r}, {', '.join(written)})"
