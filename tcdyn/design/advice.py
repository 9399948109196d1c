"""What to do, from predictions of planned tests: how well each tells the lags, and the least that tells both well."""

from __future__ import annotations

from collections.abc import Sequence

from tcdyn.design.prediction import Prediction

COMMON = (0.05, 0.15)  # u of the common lag over the lag: below the first it is told well, below the second roughly
DIFFERENCES = (0.03, 0.10)  # the same of the differences between channels
GRADES = ("well", "roughly", "poorly")
MEANING = (
    f"Well: the standard uncertainty is below {100 * COMMON[0]:.0f} % of the lag for the common lag, "
    f"{100 * DIFFERENCES[0]:.0f} % for the differences; roughly: below {100 * COMMON[1]:.0f} % and "
    f"{100 * DIFFERENCES[1]:.0f} %; poorly: more."
)
EFFORT = {"unloading": 0, "loading": 0, "plunge": 1, "touch": 2, "together": 3}  # an EHL test has both steps anyway


def grade(u_s: float, lag_s: float, limits: tuple[float, float]) -> str:
    """How well a lag is told.

    >>> grade(0.03, 0.73, COMMON), grade(0.03, 0.73, DIFFERENCES), grade(0.2, 0.73, COMMON)
    ('well', 'roughly', 'poorly')
    """
    return GRADES[sum(u_s >= limit * lag_s for limit in limits)]


def common(p: Prediction, lag_s: float) -> str:
    """How well the test tells the lag that all channels share."""
    return grade(p.u_common_s, lag_s, COMMON)


def differences(p: Prediction, lag_s: float) -> str:
    """How well the test tells the channels' lags apart."""
    return grade(p.u_differential_s, lag_s, DIFFERENCES)


def sentence(p: Prediction, lag_s: float) -> str:
    """One sentence: how well the test tells the common lag, and how well the differences."""
    return (
        f"{p.name}: tells the common lag {common(p, lag_s)}, to {_size(p.u_common_s, lag_s)}, and the differences "
        f"between channels {differences(p, lag_s)}, to {_size(p.u_differential_s, lag_s)}."
    )


def headline(predictions: Sequence[Prediction], lag_s: float) -> str:
    """What to do: the least laborious test that tells both well; without one, the best there is and what it lacks."""
    enough = [p for p in predictions if common(p, lag_s) == differences(p, lag_s) == "well"]
    if not enough:
        best = min(predictions, key=lambda p: p.u_common_s + p.u_differential_s)
        return (
            f"No test of this plan tells the lags well. The best, {best.name}, leaves the common lag at "
            f"{_size(best.u_common_s, lag_s)} and the differences at {_size(best.u_differential_s, lag_s)}: plan more "
            "plunges, less noise or more power before the unloading."
        )
    do = min(enough, key=lambda p: (EFFORT.get(p.kind, 2), p.name.count(","), p.u_common_s))
    told = (
        f"the common lag to {_size(do.u_common_s, lag_s)} and the differences between channels to "
        f"{_size(do.u_differential_s, lag_s)}."
    )
    if do.kind != "together":
        return f"Do this: {do.name}. It tells {told}"
    plunges = [p.name for p in predictions if p.kind == "plunge"][-1:]
    return (
        f"Do this: {plunges[0] if plunges else 'the plunges'}, and log an unloading. Together they tell {told}"
        + _alone(predictions, lag_s)
    )


def _alone(predictions: Sequence[Prediction], lag_s: float) -> str:
    """Why both are needed: what the best of each kind leaves open by itself."""
    parts = []
    for kind, word in (("plunge", "plunges"), ("unloading", "an unloading")):
        own = [p for p in predictions if p.kind == kind]
        if own:
            p = min(own, key=lambda q: q.u_common_s)
            weak = common(p, lag_s) != "well"
            u, what = (p.u_common_s, "common lag") if weak else (p.u_differential_s, "differences")
            parts.append(f"{word} alone leave{'s' if kind == 'unloading' else ''} the {what} at {_size(u, lag_s)}")
    return f" Less is not enough: {', '.join(parts)}." if parts else ""


def _size(u_s: float, lag_s: float) -> str:
    """A standard uncertainty in seconds and in percent of the lag.

    >>> _size(0.0181, 0.73)
    '+- 0.018 s (2.5 % of the lag)'
    """
    return f"+- {u_s:.3f} s ({100 * u_s / lag_s:.2g} % of the lag)"
