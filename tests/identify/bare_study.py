"""Coverage, silent misses and conclusions of ``compare(data)`` without models, options or start.

``python -m tests.identify.bare_study COUNT SEED [CASE ...]`` prints a row for each case of
``tests/identify/bare_cases.py``. A silent miss is a conclusion of severity info while the truth is
outside the interval of gain or lag, or while the record had to be named. Coverage is that of the
calls that gave a model; one of another number of integrators than the truth does not cover it.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed

from tcdyn.core.errors import InputError
from tcdyn.core.estimate import Estimate
from tcdyn.identification import Comparison, compare
from tests.identify.bare_cases import CASES, Case

SEVERITIES = ("info", "warning", "error", "InputError")


@dataclass(frozen=True)
class Outcome:
    """One bare call.

    Parameters
    ----------
    severity
        One of ``SEVERITIES``.
    message
        Text of the conclusion or of the error.
    model
        Name of the recommended model.
    cpu_s
        Processor time [s].
    gain, lag_s, dead_s
        Estimates; None where there is none that can be compared with the truth.
    """

    severity: str
    message: str
    model: str
    cpu_s: float
    gain: Estimate | None = None
    lag_s: Estimate | None = None
    dead_s: Estimate | None = None


def estimates(comparison: Comparison, case: Case) -> tuple[Estimate | None, ...]:
    """Gain, lag and dead time, averaged over the models."""
    best = comparison.best.identified
    if best.model.integrators != case.integrators:
        return None, None, None
    if best.model.integrators:
        return best.estimates["Kp"], None, None
    averaged = next(iter(comparison.averaged.values()), {})
    return averaged.get("gain"), averaged.get("lag_s"), averaged.get("dead_time_s")


def outcome(name: str, seed: int) -> Outcome:
    """Make the record of a case and identify it."""
    case = CASES[name]
    data = case.record(seed)
    start_s = time.process_time()
    try:
        comparison = compare(data)
    except InputError as error:
        return Outcome("InputError", str(error), "none", time.process_time() - start_s)
    cpu_s = time.process_time() - start_s
    conclusion = comparison.conclusion
    return Outcome(
        conclusion.severity.value,
        conclusion.sentence,
        comparison.recommended,
        cpu_s,
        *estimates(comparison, case),
    )


def is_named(result: Outcome, case: Case) -> bool:
    """Whether the call does not recommend a model, and its message has one of the case's words."""
    message = result.message.lower()
    return result.severity != "info" and any(word in message for word in case.words)


def is_covered(estimate: Estimate | None, truth: float | None) -> bool:
    """Whether the interval contains the truth; true where there is no truth."""
    return truth is None or (estimate is not None and estimate.contains(truth))


def quantity(values: Sequence[Estimate | None], truth: float | None) -> tuple[float, float, float]:
    """Coverage, rms z and median |error|/truth of the calls that gave a model, NaN without
    truth."""
    if truth is None or not values:
        return np.nan, np.nan, np.nan
    covered = np.mean([is_covered(e, truth) for e in values])
    known = [e for e in values if e is not None]
    if not known:
        return float(covered), np.nan, np.nan
    errors = np.array([e.value - truth for e in known])
    z = errors / np.maximum([e.u for e in known], 1e-300)
    rms_z = np.sqrt(np.mean(z**2))
    relative = float(np.median(np.abs(errors)) / abs(truth)) if truth else np.nan
    return float(covered), float(rms_z), relative


def summarise(name: str, results: Sequence[Outcome]) -> dict[str, object]:
    """The row of a case."""
    case = CASES[name]
    models = [r for r in results if r.severity != "InputError"]
    severities = Counter(r.severity for r in results)
    row: dict[str, object] = {
        severity: severities[severity] / len(results) for severity in SEVERITIES
    }
    if case.words:
        row["named"] = np.mean([is_named(r, case) for r in results])
        row["silent"] = row["info"]
    else:
        right = [is_covered(r.gain, case.gain) and is_covered(r.lag_s, case.lag_s) for r in models]
        silent = [r.severity == "info" and not ok for r, ok in zip(models, right)]
        row["silent"] = sum(silent) / len(results)
        for label, truth in (
            ("gain", case.gain),
            ("lag_s", case.lag_s),
            ("dead_s", case.dead_s),
        ):
            values = [getattr(r, label) for r in models]
            row[label], row[f"z_{label}"], row[f"error_{label}"] = quantity(values, truth)
    row["cpu_s"] = np.median([r.cpu_s for r in results])
    row["models"] = Counter(r.model for r in results).most_common(3)
    return row


def study(name: str, seeds: range, n_jobs: int = 1) -> dict[str, object]:
    """Identify the record of each seed; the row of the case."""
    return summarise(name, Parallel(n_jobs=n_jobs)(delayed(outcome)(name, s) for s in seeds))


# Column, heading, format
COLUMNS = (
    ("gain", "cov K", "7.2f"),
    ("lag_s", "cov lag", "8.2f"),
    ("dead_s", "cov dead", "9.2f"),
    ("named", "named", "6.2f"),
    ("silent", "silent", "7.2f"),
    ("info", "info", "6.2f"),
    ("warning", "warn", "6.2f"),
    ("error", "error", "6.2f"),
    ("InputError", "InpErr", "7.2f"),
    ("z_gain", "z K", "9.3g"),
    ("z_lag_s", "z lag", "9.3g"),
    ("z_dead_s", "z dead", "9.3g"),
    ("error_gain", "err K", "9.2g"),
    ("error_lag_s", "err lag", "9.2g"),
    ("cpu_s", "CPU s", "7.1f"),
)


def main(count: int, seed: int, *names: str) -> None:
    """Print the table, a row as soon as it is known."""
    widths = [int(form.split(".")[0]) for _, _, form in COLUMNS]
    headings = [f"{heading:>{width}}" for (_, heading, _), width in zip(COLUMNS, widths)]
    print(f"{count} seeds from {seed}")
    print(f"{'case':25s}", *headings, " models", sep="", flush=True)
    for name in names or CASES:
        row = study(name, range(seed, seed + count))
        texts = []
        for (key, _, form), width in zip(COLUMNS, widths):
            value = row.get(key, np.nan)
            texts.append(f"{'':{width}}" if np.isnan(value) else f"{value:{form}}")
        models = ", ".join(f"{model} {number}" for model, number in row["models"])
        print(f"{name:25s}", *texts, f"  {models}", sep="", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:])
