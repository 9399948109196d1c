"""Files of a call: single ones, all tables of a folder, and patterns such as ``logs/*.csv``.

Every command that takes several files calls :func:`files_of`. Tests: ``tests/io/test_files.py``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from glob import escape, glob, has_magic
from pathlib import Path

from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info
from tcdyn.io.metadata import METADATA_ENDING, check_not_compensated
from tcdyn.io.read import OTHER_ENDINGS, display_path, open_table
from tcdyn.io.write import file_identity

# Endings of the tables that are taken from a folder. A file with another ending is used if it is
# named, or by a pattern: any text may be a log.
TABLE_ENDINGS = (
    *(".csv", ".tsv", ".txt", ".dat", ".asc", ".prn", ".log"),
    *(".lvm", ".tdms", ".parquet", ".pq"),
)
# Entry of the metadata of a table that this program wrote: a compensated table, or one of results.
OUTPUT_KEY = "tcdyn"


def files_of(paths: Sequence[str | Path]) -> tuple[list[Path], list[Finding]]:
    """The files that are meant by files, folders and patterns.

    Parameters
    ----------
    paths
        Files, folders, and patterns with ``*``, ``?``, ``[...]`` and ``**``, which a shell on
        Windows does not expand.

    Returns
    -------
    files
        The files, each once, in the order of ``paths``. Those of a folder or a pattern are in
        natural order: day2 before day10.
    findings
        Which files of a folder or pattern are left out: what this program wrote.

    Raises
    ------
    InputError
        For no path, a file that does not exist, and a folder or pattern without tables.

    Notes
    -----
    Of a folder the tables are taken (``TABLE_ENDINGS``), not those of its folders. Hidden files are
    left out. A file that is named is always used.

    Examples
    --------
    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> for name in ("day10.csv", "day2.csv", "notes.pdf", ".day3.csv"):
    ...     _ = (folder / name).write_text("time_s,T1\\n0,20\\n1,20\\n", encoding="utf-8")
    >>> [path.name for path in files_of([folder])[0]]
    ['day2.csv', 'day10.csv']
    """
    if not paths:
        raise InputError("no files", expected="at least one file, folder or pattern")
    files: dict[object, Path] = {}
    left_out: dict[object, Path] = {}
    for path in paths:
        found, outputs = _expanded(path)
        for file in found:
            files.setdefault(file_identity(file), file)
        for file in outputs:
            left_out.setdefault(file_identity(file), file)
    names = [file.name for identity, file in left_out.items() if identity not in files]
    findings = []
    if names:
        findings.append(info("files.left_out", files=sorted(names, key=natural_key)))
    return list(files.values()), findings


def natural_key(text: str) -> tuple[tuple[int | str, ...], str]:
    """Key that sorts numbers in a text by their value, without regard to upper and lower case.

    >>> sorted(["day10", "Day2", "day1"], key=natural_key)
    ['day1', 'Day2', 'day10']
    """
    # text and numbers take turns, so that two keys never compare one with the other
    parts = re.split(r"(\d+)", text.casefold())
    numbers = (int(part) if k % 2 else part for k, part in enumerate(parts))
    return tuple(numbers), text


def _expanded(path: str | Path) -> tuple[list[Path], list[Path]]:
    """Files of one path, and files of a folder or pattern that this program wrote.

    Raises
    ------
    InputError
        As ``files_of`` does.
    """
    file = Path(path)
    where = display_path(file)
    is_folder = file.is_dir()
    if not is_folder and file.exists():
        return [file], []
    if not is_folder and not has_magic(str(path)):
        raise InputError("no such file", where=where)
    pattern = f"{escape(str(path))}/*" if is_folder else str(path)
    found = [Path(match) for match in glob(pattern, recursive=True)]
    found = sorted((each for each in found if each.is_file()), key=lambda f: natural_key(str(f)))
    outputs = [each for each in found if _is_output(each)]
    tables = [each for each in found if each not in outputs]
    if is_folder:
        tables = [each for each in tables if each.suffix.lower() in TABLE_ENDINGS]
    if not tables:
        raise InputError(
            "holds no tables" if is_folder else "no file has such a name",
            where=where,
            expected="tables: CSV, LVM, TDMS or Parquet" if is_folder else "a pattern of files",
            remedy=f"{len(outputs)} file(s) that tcdyn wrote are left out" if outputs else "",
        )
    return tables, outputs


def _is_output(file: Path) -> bool:
    """Whether this program wrote a file, by its ending, its metadata or its columns."""
    if file.name.endswith(METADATA_ENDING) or file.suffix.lower() in OTHER_ENDINGS:
        return True
    if file.suffix.lower() not in TABLE_ENDINGS:
        return False
    try:
        table = open_table(file)
    except InputError:  # the reader of the file says what is wrong
        return False
    if OUTPUT_KEY in table.metadata:
        return True
    try:
        check_not_compensated(table.names, table.metadata, table.where)
    except InputError:
        return True
    return False
