"""Rows for tables 3.1 to 3.6."""

from __future__ import annotations

from itertools import pairwise

from tcdyn.conduction.rim import MESHES, correction_factor
from tcdyn.verify.mesh_study import IDEAL_TIMES_S, MeshErrors, ideal_study, real_study, time_step_error_percent
from tcdyn.verify.row import VerifyRow, numbers, row

TABLE_3_2 = {"I": (0.567, 0.130, 0.024, 0.015), "II": (0.142, 0.046, 0.025, 0.021), "III": (0.078, 0.032, 0.021, 0.017)}
TABLE_3_3 = {"I": (0.480, 0.112, 0.020, 0.012), "II": (0.121, 0.039, 0.021, 0.017), "III": (0.067, 0.027, 0.018, 0.014)}
TABLE_3_4 = {
    "I": (1.0667, 1.0667, 1.0667, 1.0667),
    "II": (1.0286, 1.0159, 1.0159, 1.0101),
    "III": (1.0051, 1.0039, 1.0031, 1.0025),
    "IV": (1.0013, 1.0010, 1.0008, 1.0007),
}
LOADS_N, HALF_WIDTHS_m = (850, 1460, 1850, 2320), (1.25e-3, 1.50e-3, 1.62e-3, 1.75e-3)
TABLE_3_5 = {"I": (5.015, 3.111), "II": (0.498, 0.341), "III": (0.709, 0.381)}  # at 125 s and 1000 s
TABLE_3_6 = {"I": (0.379, 0.230), "II": (0.141, 0.016), "III": (0.102, 0.024)}
SIZE = 4.0  # "the same size": within this factor
WHY_SIZE = (
    "quasi-steady fields of D4, point values of the parabola raised by table 3.4; agrees when it falls in time and "
    f"lies within a factor {SIZE:g}: the logged inner row of D4 is not in the thesis"
)
WHY_NOT = (
    "falls in time as published, but the size cannot be checked: the logged inner row of D4 and the worst node are not "
    "in the thesis, and its set III is worse than its coarser set II, so something else than the mesh is in its figure"
)
D4_STATES = ((85.0, 65.0), (145.0, 70.0))  # inner row and air [degC] at 125 s and 1000 s (figures 3.8, 6.16)


def mesh_rows() -> list[VerifyRow]:
    """All rows of the meshing test."""
    return [*_steps(), *_ideal(), *_factors(), *_real()]


def _steps() -> list[VerifyRow]:
    change = time_step_error_percent()
    good = [change[k] for k in MESHES]
    return [
        row(
            "time steps of meshes I to IV: change at 2 s when ten times smaller, %",
            "table 3.1",
            "none to be seen",
            numbers(good, 4),
            max(good) < 0.05,
            "agrees when below 0.05 %; flux of 250 W over the whole track, which the thesis does not state",
        ),
        row(
            "mesh I with 1 s steps: change at 2 s, %",
            "figure 3.10",
            "rough trace",
            f"{change['I at 1 s']:.2f}",
            change["I at 1 s"] > 20 * change["I"],
            "agrees when at least twenty times that of 0.04 s",
        ),
    ]


def _ideal() -> list[VerifyRow]:
    plain, late = ideal_study(), ideal_study(late_steps=1)
    rows = []
    for table, part, published in (("3.2", "maximum", TABLE_3_2), ("3.3", "mean", TABLE_3_3)):
        for k, theirs in published.items():
            ours, shifted = getattr(plain[k], part), getattr(late[k], part)
            falls = all(a > b for a, b in pairwise(ours))
            size = all(a <= p for a, p in zip(ours, theirs, strict=True))
            similar = 1 / 4 < shifted[0] / theirs[0] < 4
            rows.append(
                row(
                    f"mesh {k} against IV, {part} error at {numbers(IDEAL_TIMES_S, 0)} s, %",
                    f"table {table}",
                    numbers(theirs, 3),
                    f"{numbers(ours, 3)}; heat one step late: {numbers(shifted, 3)}",
                    falls and size and similar,
                    "ours falls with time and stays below; the published errors are proportional to the "
                    "time step less a floor of 0.015 %, as one step of delay and a loosely converged iteration "
                    "give, so ours with that delay must come within a factor 4 at 2 s",
                    good="same trend",
                )
            )
    finer = [plain[k].maximum[0] for k in ("I", "II", "III")]
    rows.append(
        row(
            "mesh errors fall as cells halve: I, II, III at 2 s, %",
            "tables 3.2 and 3.3",
            "0.567, 0.142, 0.078",
            numbers(finer, 4),
            finer[0] > 3 * finer[1] > 9 * finer[2],
            "second order: each at most a third of the one before",
        )
    )
    return rows


def _factors() -> list[VerifyRow]:
    rows = []
    for name, published in TABLE_3_4.items():
        for load, b, value in zip(LOADS_N, HALF_WIDTHS_m, published, strict=True):
            ours = correction_factor(b, MESHES[name].nz, 9.53e-3)
            rows.append(
                row(
                    f"heat correction, mesh {name}, {load} N",
                    "table 3.4",
                    f"{value:.4f}",
                    f"{ours:.4f}",
                    round(ours, 4) == value,
                    "N = 2 round(b/dz), N^2/(N^2 - 1), to the last digit",
                )
            )
    return rows


def _real() -> list[VerifyRow]:
    early, late = (real_study(*state) for state in D4_STATES)
    rows = []
    for table, part, published in (("3.5", "maximum", TABLE_3_5), ("3.6", "mean", TABLE_3_6)):
        for k, theirs in published.items():
            ours = tuple(_one(study[k], part) for study in (early, late))
            falls = ours[0] > ours[1]
            size = all(1 / SIZE < a / p < SIZE for a, p in zip(ours, theirs, strict=True))
            rows.append(
                VerifyRow(
                    f"mesh {k} against IV, test D4, {part} error at 125 and 1000 s, %",
                    f"table {table}",
                    numbers(theirs, 3),
                    numbers(ours, 3),
                    "differs" if not falls else "agrees" if size else "not checkable",
                    WHY_SIZE if size else WHY_NOT,
                )
            )
    coarse, finest = _one(early["I"], "maximum"), _one(early["III"], "maximum")
    rows.append(
        row(
            "mesh I stands out in the real test: maximum error of I over III",
            "table 3.5",
            f"{5.015 / 0.709:.1f}",
            f"{coarse / finest:.1f}",
            coarse > 4 * finest,
            "must be above 4: the parabola on four nodes carries 4.6 % too much heat even after its correction",
            good="same trend",
        )
    )
    return rows


def _one(errors: MeshErrors, part: str) -> float:
    return float(getattr(errors, part)[0])
