"""Rows for figures 3.5, 3.15 and 3.16, and for the cases that section 3.6.3 could not test."""

from __future__ import annotations

import numpy as np

from tcdyn.conduction.closed_forms import penetration_depth_m
from tcdyn.conduction.reference import explicit_growth, explicit_limit_s
from tcdyn.conduction.rim import Mesh
from tcdyn.contact import hertz_contact, surface_speed_m_s
from tcdyn.verify.checks import default_rim, product_convergence, series_convergence, steady_check, transient_check
from tcdyn.verify.row import VerifyRow, row


def rim_rows() -> list[VerifyRow]:
    """All rows of the rim model against closed forms."""
    return [*_penetration(), *_figures(), *_orders(), _explicit()]


def _penetration() -> list[VerifyRow]:
    alpha = default_rim().diffusivity_m2_s
    contact = hertz_contact(2320.0)
    passage = 2 * contact.minor_m / surface_speed_m_s(774.0)
    flash = float(penetration_depth_m(passage, alpha)) * 1e3
    reach = float(penetration_depth_m(93.0, alpha)) * 1e3
    return [
        row(
            "depth that a flash reaches, 774 rpm, 2320 N, mm",
            "(3.27), figure 3.5",
            "< 0.4",
            f"{flash:.3f}",
            flash < 0.4 * (1 + 2 * 0.018),
            f"after {passage * 1e3:.3f} ms in the contact; the steel is assumed (K to 3 %, rho c to 2 %: 1.8 % of this "
            "depth), so agrees up to two of those above 0.4; far above both junction e and the mesh in any case",
        ),
        row(
            "depth that the surface jump of figure 3.15 reaches by its end, mm",
            "section 3.6.2",
            "230",
            f"{reach:.0f}",
            abs(reach - 230) < 7,
            "the figure's end is not printed; 93 s is where (3.27) gives 230 mm, so this ties the two together",
        ),
    ]


def _figures() -> list[VerifyRow]:
    transient, steady = transient_check(), steady_check()
    worst = float(np.abs(transient.error_percent).max())
    steadily = float(np.abs(steady.error_percent).max())
    return [
        row(
            "3 mm below a surface that jumps from 20 to 160 degC, 2 to 93 s: largest error, %",
            "(3.26), figure 3.15",
            "very good agreement",
            f"{worst:.3f}",
            worst < 0.5,
            "2 m disk with 1313 nodes in r (1.5 mm); agrees below 0.5 %",
        ),
        row(
            "steady ring under uniform flux: largest error, %",
            "(3.36), (3.37), figure 3.16",
            "correctly implemented",
            f"{steadily:.5f}",
            steadily < 0.01,
            "(3.36) with T_in outside the division by K; agrees below 0.01 %",
        ),
    ]


def _orders() -> list[VerifyRow]:
    out = []
    for check, note in (
        (series_convergence(), "fixed inside, flux and film outside, from one temperature"),
        (product_convergence(), "the z-variation that section 3.6.3 found no solution for"),
    ):
        out.append(
            row(
                f"order of convergence, {check.title}",
                "(3.22), (3.23)",
                "2",
                f"{check.order:.3f}",
                check.order > 1.9,
                f"{note}; error on mesh IV {check.error_K[-1] * 1e3:.3f} mK; agrees above 1.9",
            )
        )
    return out


def _explicit() -> VerifyRow:
    rim, mesh = default_rim(), Mesh(17, 27)
    limit = explicit_limit_s(rim, mesh)
    below, above = (explicit_growth(rim, mesh, f * limit) for f in (0.98, 1.05))
    return row(
        "explicit scheme: size of a checkerboard after 200 steps at 0.98 and 1.05 of the limit",
        "section 3.4.2",
        "stable, unstable",
        f"{below:.2g}, {above:.2g}",
        below < 1 < above,
        f"mesh II, limit {limit * 1e3:.2f} ms with both directions counted (the thesis quotes the 1-D form)",
    )
