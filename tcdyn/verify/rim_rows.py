"""Rows of the rim model: figures 3.5, 3.15 and 3.16, what section 3.6.3 could not test, and tables 3.1 to 3.6."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from tcdyn.conduction.modal import rim_gains
from tcdyn.conduction.nonuniform import film_in_steps, rim_gains_nonuniform
from tcdyn.conduction.referees import explicit_growth, explicit_limit_s, penetration_depth_m
from tcdyn.conduction.rim import MESHES, Mesh, correction_factor, node_rates
from tcdyn.contact import hertz_contact, surface_speed_m_s
from tcdyn.verify import LOADS_N, HALF_WIDTHS_mm, VerifyRow, numbers, row, studies, within

TABLE_3_2 = {"I": (0.567, 0.130, 0.024, 0.015), "II": (0.142, 0.046, 0.025, 0.021), "III": (0.078, 0.032, 0.021, 0.017)}
TABLE_3_3 = {"I": (0.480, 0.112, 0.020, 0.012), "II": (0.121, 0.039, 0.021, 0.017), "III": (0.067, 0.027, 0.018, 0.014)}
TABLE_3_4 = {
    "I": (1.0667, 1.0667, 1.0667, 1.0667),
    "II": (1.0286, 1.0159, 1.0159, 1.0101),
    "III": (1.0051, 1.0039, 1.0031, 1.0025),
    "IV": (1.0013, 1.0010, 1.0008, 1.0007),
}
TABLE_3_5 = {"I": (5.015, 3.111), "II": (0.498, 0.341), "III": (0.709, 0.381)}  # at 125 s and 1000 s
TABLE_3_6 = {"I": (0.379, 0.230), "II": (0.141, 0.016), "III": (0.102, 0.024)}
D4_STATES = ((85.0, 65.0), (145.0, 70.0))  # inner row and air [degC] at 125 s and 1000 s (figures 3.8, 6.16)
SIZE = 4.0  # "the same size": within this factor
WHY_SIZE = (
    "quasi-steady fields of D4, point values of the parabola raised by table 3.4; agrees when it falls in time and "
    f"lies within a factor {SIZE:g}: the logged inner row of D4 is not in the thesis"
)
WHY_NOT = (
    "falls in time as published, but the size cannot be checked: the logged inner row of D4 and the worst node are not "
    "in the thesis, and its set III is worse than its coarser set II, so something else than the mesh is in its figure"
)


def closed_form_rows() -> Iterator[VerifyRow]:
    """The rim model against closed forms, and the limit of the explicit scheme."""
    rim = studies.default_rim()
    contact = hertz_contact(2320.0)
    passage = 2 * contact.minor_m / surface_speed_m_s(774.0)
    flash, reach = penetration_depth_m([passage, 93.0], rim.diffusivity_m2_s) * 1e3
    yield row(
        "depth that a flash reaches, 774 rpm, 2320 N, mm",
        "(3.27), figure 3.5",
        "< 0.4",
        f"{flash:.3f}",
        flash < 0.4 * (1 + 2 * 0.018),
        f"after {passage * 1e3:.3f} ms in the contact; the steel is assumed (K to 3 %, rho c to 2 %: 1.8 % of this "
        "depth), so agrees up to two of those above 0.4; far above both junction e and the mesh in any case",
    )
    yield row(
        "depth that the surface jump of figure 3.15 reaches by its end, mm",
        "section 3.6.2",
        "230",
        f"{reach:.0f}",
        abs(reach - 230) < 7,
        "the figure's end is not printed; 93 s is where (3.27) gives 230 mm, so this ties the two together",
    )
    worst, steadily = (
        float(np.abs(check.error_percent).max()) for check in (studies.transient_check(), studies.steady_check())
    )
    yield row(
        "3 mm below a surface that jumps from 20 to 160 degC, 2 to 93 s: largest error, %",
        "(3.26), figure 3.15",
        "very good agreement",
        f"{worst:.3f}",
        worst < 0.5,
        "2 m disk with 1313 nodes in r (1.5 mm); agrees below 0.5 %",
    )
    yield row(
        "steady ring under uniform flux: largest error, %",
        "(3.36), (3.37), figure 3.16",
        "correctly implemented",
        f"{steadily:.5f}",
        steadily < 0.01,
        "(3.36) with T_in outside the division by K; agrees below 0.01 %",
    )
    for check, note in (
        (studies.series_convergence(), "fixed inside, flux and film outside, from one temperature"),
        (studies.product_convergence(), "the z-variation that section 3.6.3 found no solution for"),
    ):
        yield row(
            f"order of convergence, {check.title}",
            "(3.22), (3.23)",
            "2",
            f"{check.order:.3f}",
            check.order > 1.9,
            f"{note}; error on mesh IV {check.error_K[-1] * 1e3:.3f} mK; agrees above 1.9",
        )
    mesh = Mesh(17, 27)
    limit = explicit_limit_s(rim, mesh)
    below, above = (explicit_growth(rim, mesh, f * limit) for f in (0.98, 1.05))
    yield row(
        "explicit scheme: size of a checkerboard after 200 steps at 0.98 and 1.05 of the limit",
        "section 3.4.2",
        "stable, unstable",
        f"{below:.2g}, {above:.2g}",
        below < 1 < above,
        f"mesh II, limit {limit * 1e3:.2f} ms with both directions counted (the thesis quotes the 1-D form)",
    )


def field_rows() -> Iterator[VerifyRow]:
    """The engine's fields and map against steps of Crank-Nicolson, and the thesis's trials of uneven cooling."""
    pair = (700.0, 0.7)
    gap, found, misfit = studies.map_study(*pair)
    yield row(
        "modal engine against Crank-Nicolson on the same mesh, all nodes after 3 s of heating, K",
        "section 3.4.3",
        "one scheme",
        f"{gap:.5f}",
        gap < 2e-3,
        "mesh II, steps of 20 ms, 250 W into the disk; agrees below 2 mK",
    )
    yield row(
        "pair of the 12 x 10 map that explains those steps best: h, W/m2K, and share of the heat",
        "section 3.5",
        numbers(pair, 1),
        numbers(found, 1),
        within(found, pair, relative=1e-9),
        f"the pair that they were made with; {misfit * 1e3:.1f} mK rms are left there",
    )
    rim, rates = studies.default_rim(), node_rates(1 / 75)
    points = [(3e-3, 2e-3), (3e-3, rim.width_m / 2), (3e-3, rim.width_m - 2e-3)]
    film = film_in_steps(rim.width_m, [rim.width_m / 2], [200.0, 400.0], MESHES["III"].nz)
    uneven = rim_gains_nonuniform(rim, film, points, 1.62e-3, rates, mesh=MESHES["III"])
    left, centre, right = uneven.static.T @ [150.0, 100.0, 102.0, 100.0, 65.0]
    yield row(
        "3 mm deep under a film of 200, then 400 W/m2K across the track: 2 mm from a face, centre, other side, degC",
        "figure 6.26",
        "sides differ, both below the centre",
        numbers((left, centre, right), 2),
        right < left < centre,
        "power and inner row of the figure are not printed: 150 W, 100 and 102 degC",
        good="same trend",
    )
    sided = rim_gains(rim, 200.0, points, 1.62e-3, rates, split_ambient=True)
    near, _, far = sided.static.T @ [0.0, 65.0, 65.0, 65.0, 65.0, 70.0, 60.0] - 65.0
    yield row(
        "3 mm deep, disk at 65 degC, air at 70 beyond one washer and 60 beyond the other: 2 mm from either face, K",
        "figure 6.28",
        "warmer on the warmer side",
        numbers((near, far), 3),
        near > 0 > far and abs(near + far) < 1e-6 * near,
        "equal and opposite, since everything else is alike on both sides",
        good="same trend",
    )


def mesh_rows() -> Iterator[VerifyRow]:
    """The meshing test, tables 3.1 to 3.6."""
    change = studies.time_step_error_percent()
    good = [change[k] for k in MESHES]
    yield row(
        "time steps of meshes I to IV: change at 2 s when ten times smaller, %",
        "table 3.1",
        "none to be seen",
        numbers(good, 4),
        max(good) < 0.05,
        "agrees when below 0.05 %; flux of 250 W over the whole track, which the thesis does not state",
    )
    yield row(
        "mesh I with 1 s steps: change at 2 s, %",
        "figure 3.10",
        "rough trace",
        f"{change['I at 1 s']:.2f}",
        change["I at 1 s"] > 20 * change["I"],
        "agrees when at least twenty times that of 0.04 s",
    )
    yield from _ideal()
    for name, published in TABLE_3_4.items():
        for load, b, value in zip(LOADS_N, HALF_WIDTHS_mm, published, strict=True):
            ours = correction_factor(b * 1e-3, MESHES[name].nz, 9.53e-3)
            yield row(
                f"heat correction, mesh {name}, {load} N",
                "table 3.4",
                f"{value:.4f}",
                f"{ours:.4f}",
                round(ours, 4) == value,
                "N = 2 round(b/dz), N^2/(N^2 - 1), to the last digit",
            )
    yield from _real()


def _ideal() -> Iterator[VerifyRow]:
    """Tables 3.2 and 3.3."""
    plain, late = studies.ideal_study(), studies.ideal_study(late_steps=1)
    for table, part, published in (("3.2", "maximum", TABLE_3_2), ("3.3", "mean", TABLE_3_3)):
        for k, theirs in published.items():
            ours, shifted = getattr(plain[k], part), getattr(late[k], part)
            falls = all(a > b for a, b in pairwise(ours))
            stays = all(a <= p for a, p in zip(ours, theirs, strict=True))
            yield row(
                f"mesh {k} against IV, {part} error at {numbers(studies.IDEAL_TIMES_S, 0)} s, %",
                f"table {table}",
                numbers(theirs, 3),
                f"{numbers(ours, 3)}; heat one step late: {numbers(shifted, 3)}",
                falls and stays and 1 / SIZE < shifted[0] / theirs[0] < SIZE,
                "ours falls with time and stays below; the published errors are proportional to the "
                "time step less a floor of 0.015 %, as one step of delay and a loosely converged iteration "
                "give, so ours with that delay must come within a factor 4 at 2 s",
                good="same trend",
            )
    finer = [plain[k].maximum[0] for k in TABLE_3_2]
    yield row(
        "mesh errors fall as cells halve: I, II, III at 2 s, %",
        "tables 3.2 and 3.3",
        "0.567, 0.142, 0.078",
        numbers(finer, 4),
        finer[0] > 3 * finer[1] > 9 * finer[2],
        "second order: each at most a third of the one before",
    )


def _real() -> Iterator[VerifyRow]:
    """Tables 3.5 and 3.6."""
    early, late = (studies.real_study(*state) for state in D4_STATES)
    for table, part, published in (("3.5", "maximum", TABLE_3_5), ("3.6", "mean", TABLE_3_6)):
        for k, theirs in published.items():
            ours = [getattr(study[k], part)[0] for study in (early, late)]
            size = all(1 / SIZE < a / p < SIZE for a, p in zip(ours, theirs, strict=True))
            yield row(
                f"mesh {k} against IV, test D4, {part} error at 125 and 1000 s, %",
                f"table {table}",
                numbers(theirs, 3),
                numbers(ours, 3),
                ours[0] > ours[1],
                WHY_SIZE if size else WHY_NOT,
                good="agrees" if size else "not checkable",
            )
    coarse, fine = early["I"].maximum[0], early["III"].maximum[0]
    yield row(
        "mesh I stands out in the real test: maximum error of I over III",
        "table 3.5",
        f"{5.015 / 0.709:.1f}",
        f"{coarse / fine:.1f}",
        coarse > 4 * fine,
        "must be above 4: the parabola on four nodes carries 4.6 % too much heat even after its correction",
        good="same trend",
    )
