"""Stored results of earlier runs with their checksum; findings that several tests share.

Used by :mod:`tcdyn.workflows.campaign`. Guarded by ``tests/cli/test_campaign_command.py``,
``tests/cli/test_absurd_input.py`` and ``tests/report/test_campaign_page.py``.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tcdyn.campaign.sufficient_statistics import (
    ANALYSE_AGAIN,
    CHECKSUM_KEY,
    KEYS_SINCE_0_2,
    verify_checksum,
)
from tcdyn.core.errors import InputError
from tcdyn.core.findings import GRADES_OF_0_2, Finding, info
from tcdyn.io.stored import BETA, check_schema, read_json

RESULT_SUFFIX = ".beta.json"  # of the file of one test
LOG_PREFIX = "EHL_"  # in front of a log's name, left out where many are counted


def read_result(path: Path) -> dict[str, Any]:
    """The content of a beta.json whose checksum has been verified; ``status`` as it is now called.

    Raises
    ------
    InputError
        If it cannot be read, is of another schema, has no checksum or was changed.
    """
    content = read_json(path, BETA)
    check_schema(content, str(path), BETA)
    verify_checksum(content, str(path))
    status = content["status"]
    return {**content, "status": GRADES_OF_0_2.get(status, status)}


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


def read_given_result(path: Path, rig: str, rig_of_0_2: str) -> dict[str, Any]:
    """The content of a beta.json that was given in the place of its log.

    Parameters
    ----------
    path
        The file.
    rig, rig_of_0_2
        Fingerprint of rig and records of this campaign, and as version 0.2 computed it
        (:func:`tcdyn.campaign.sufficient_statistics.rig_fingerprint`).

    Returns
    -------
    data
        The content. A result of version 0.2 has one more finding, which says so.

    Raises
    ------
    InputError
        If it cannot be read, was changed, or is of another rig or other records.
    """
    data = read_result(path)
    kept = data.get("kept")
    if not kept or kept.get("rig_sha256") == rig:
        return data
    if kept.get("rig_sha256") == rig_of_0_2:
        finding = info("campaign.version_0_2", keys=", ".join(KEYS_SINCE_0_2)).to_dict()
        return {**data, "findings": [*data["findings"], finding]}
    raise InputError(
        "was analysed with another rig.toml or other records than were given",
        where=str(path),
        expected="tests of one rig",
        remedy=ANALYSE_AGAIN,
    )


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
