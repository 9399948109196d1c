"""What is said of campaigns."""

from __future__ import annotations

from tcdyn.core.estimate import rounded, with_u
from tcdyn.core.messages.phrases import Message, count_with_noun

# tcdyn/campaign

LEAST_P = 1e-12  # a p-value below it is not printed: the normal distribution is not known to hold that far out


def _cause(cause: str, size: float, u: float) -> str:
    """What in one test alone would explain that it departs from all others.

    >>> _cause("friction", 0.05, 0.002), _cause("static e slow", -0.6, 0.1)
    ('its friction reads (5.00 +- 0.20) % low', 'slow_e reads (-0.60 +- 0.10) K otherwise')
    """
    kind, _, of = cause.partition(" ")
    if cause == "friction":
        value, spread = rounded(100 * abs(size), 100 * u)
        return f"its friction reads ({value} +- {spread}) % {'low' if size > 0 else 'high'}"
    value, spread = rounded(size, u)
    match kind:
        case "half-width":
            value, spread = rounded(100 * size, 100 * u)
            return f"the contact's half-width is ({value} +- {spread}) % off what the load says"
        case "ambient":
            return f"its ambient reads ({value} +- {spread}) K otherwise"
        case "parting":
            return f"its parting is ({value} +- {spread}) s off"
        case "lag":
            return f"the lag of the {of} disk is ({value} +- {spread}) s longer"
    channel, _, disk = of.partition(" ")
    return f"{disk}_{channel} reads ({value} +- {spread}) K otherwise"


def _p_value(p: float) -> str:
    """A p-value in words; one that is tiny or rounds to zero by its bound.

    >>> _p_value(0.0234), _p_value(0.0)
    ('p = 0.023', 'p below 1e-12')
    """
    return f"p = {p:.2g}" if p > LEAST_P else f"p below {LEAST_P:g}"


CAMPAIGN: dict[str, Message] = {
    "campaign.stranger": lambda subject, cause, size, u, z, chi2, left, freedom, explained, **_: (
        f"{subject} does not belong to its campaign: against all other tests chi-squared is {chi2:.0f} on {freedom} "
        f"degrees of freedom; it would "
        + ("belong" if explained else f"belong better (chi-squared {left:.0f})")
        + f" if {_cause(cause, size, u)} ({abs(z):.0f} standard deviations); the others were solved "
        "without it"
    ),
    "campaign.exponent": "{tests} tests together give the exponent of the speed law n = {n:.3f} +- {u:.3f}; rig.toml "
    "assumes {assumed:.3f}: speed_exponent in its [contact] may be set to it",
    "campaign.power_law": "one power of the speed is not enough for h: n changes by {per_doubled:.3f} +- {u:.3f} while "
    "the speed doubles (chance {p:.2g})",
    "campaign.junction": "all tests together place {subject} {deeper_mm:.2f} +- {u_mm:.2f} mm deeper than stated "
    "({z:.1f} standard deviations): look at its depth_mm in rig.toml",
    "campaign.curve_shape": lambda subject, chi2, freedom, p, scatter, offset, u, **_: (
        f"the shape of the curve in {subject} does not fit the tests: with its level free chi-squared is {chi2:.1f} "
        f"on {count_with_noun(freedom, 'degree')} of freedom ({_p_value(p)}); for their offset from it, "
        f"{with_u(offset, u)}, an independent scatter of {scatter:.2g} was added to every test: check the curve, and do not use one offset "
        "for all tests"
    ),
    "campaign.apart": "{subject} is not joined with the other tests: {why}",
    "campaign.altered": "{subject} in the results folder is not as it was written: its log was analysed again",
    "campaign.repeated": "{text} (in {first}; so or nearly so in {others})",
}
