"""Stored results of earlier runs with their checksum; findings that several tests share.

Used by :mod:`tcdyn.workflows.campaign`. Guarded by ``tests/cli/test_campaign_command.py``,
``tests/cli/test_absurd_input.py`` and ``tests/report/test_campaign_page.py``.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tcdyn.campaign.sufficient_statistics import ANALYSE_AGAIN, CHECKSUM_KEY, verify_checksum
from tcdyn.core.errors import DAMAGED, InputError
from tcdyn.core.findings import Finding
from tcdyn.io.read import check_no_device

RESULT_SUFFIX = ".beta.json"  # of the file of one test
LOG_PREFIX = "EHL_"  # in front of a log's name, left out where many are counted


def read_result(path: Path) -> dict[str, Any]:
    """The content of a beta.json whose checksum has been verified.

    Raises
    ------
    OSError, ValueError, RecursionError
        If it cannot be read.
    InputError
        If it has no checksum or was changed.
    """
    return verify_checksum(json.loads(path.read_text(encoding="utf-8")), path.name)


def is_altered(path: Path) -> bool:
    """Whether a stored result exists, has a checksum, and was changed after it had been written."""
    try:
        text = path.read_text(encoding="utf-8")
        if f'"{CHECKSUM_KEY}"' not in text:
            return False
        verify_checksum(json.loads(text), path.name)
    except OSError:
        return False
    except (ValueError, RecursionError):
        return True
    return False


def read_given_result(path: Path, rig: str) -> dict[str, Any]:
    """The content of a beta.json that was given in the place of its log.

    Parameters
    ----------
    path
        The file.
    rig
        Fingerprint of rig and records of this campaign.

    Raises
    ------
    InputError
        If it cannot be read, was changed, or is of another rig or other records.
    """
    check_no_device(path)
    try:
        data = read_result(path)
    except InputError:
        raise
    except (OSError, *DAMAGED) as problem:
        raise InputError(
            f"cannot be read ({type(problem).__name__})", where=path.name, remedy=ANALYSE_AGAIN
        ) from None
    if data.get("kept") and data["kept"].get("rig_sha256") != rig:
        raise InputError(
            "was analysed with another rig.toml or other records than were given",
            where=path.name,
            expected="tests of one rig",
            remedy=ANALYSE_AGAIN,
        )
    return data


def merge_findings(findings: Sequence[tuple[str, Finding]]) -> list[Finding]:
    """Merge the findings (test, finding) that differ only in their numbers.

    Of findings with one code, severity and subject, the first stays and names the other tests.

    >>> from tcdyn.core.findings import info
    >>> some = [(t, info("from_file", subject="fast_a", text="x")) for t in ("EHL_A1", "EHL_A2")]
    >>> [f.sentence for f in merge_findings(some)]
    ['x (in A1; so or nearly so in A2)']
    """
    groups: dict[tuple[str, str, str], list[tuple[str, Finding]]] = {}
    for test, finding in findings:
        groups.setdefault((finding.code, finding.severity, finding.subject), []).append(
            (test, finding)
        )
    out = []
    for group in groups.values():
        tests = list(dict.fromkeys(test for test, _ in group))
        first = group[0][1]
        if len(tests) < 2:
            out += [finding.at(test) for test, finding in group]
            continue
        numbers = {
            "text": first.sentence,
            "first": tests[0].removeprefix(LOG_PREFIX),
            "code": first.code,
        }
        other_tests = ", ".join(t.removeprefix(LOG_PREFIX) for t in tests[1:])
        out.append(
            Finding(
                "campaign.repeated",
                first.severity,
                "",
                first.subject,
                {**numbers, "others": other_tests},
            )
        )
    return out
