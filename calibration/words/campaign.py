"""What is said of campaigns."""

from __future__ import annotations

from calibration.estimate import rounded
from calibration.words.base import Words

# tcdyn/campaign


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


CAMPAIGN: dict[str, Words] = {
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
    "campaign.apart": "{subject} is not joined with the other tests: {why}",
    "campaign.altered": "{subject} in the results folder is not as it was written: its log was analysed again",
    "campaign.repeated": "{text} (in {first}; so or nearly so in {others})",
}
