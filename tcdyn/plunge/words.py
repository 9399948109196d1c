"""What a plunge fit says of itself: a sentence on the common lag, and warnings that name plunge and channel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration.estimate import Estimate, rounded, with_u
from calibration.finding import Finding, sentences
from tcdyn.plunge.map import Optimum
from tcdyn.plunge.run import Blocks, PlungeRun

RUN_WORDS = {
    "ln_h": "scale of h",
    "h_exponent": "extra exponent of h",
    "ln_burst": "size of the entry burst",
    "ln_burst_time": "duration of the entry burst",
    "ln_burst_shape": "shape of the entry burst",
    "entry": "entry time",
    "initial": "temperature before the entry",
    "bath": "bath temperature",
}
COLOURED = 4.0  # variance of slow residual waves over that of white noise: beyond it something is not modelled
UNBELIEVABLE = 5.0  # prior standard deviations of h beyond which the fluid is doubted rather than the correlation
OTHER_DISK = (
    "; the channels do not move together as they should: is a plunge of another disk among them, or a channel swapped?"
)
CHANNEL_WORDS = {
    "split": "split of the lag over two stages",
    "depth": "junction depth",
    "offset": "offset left over by the static line",
    "gain": "gain left over by the static line",
}


def lag_sentence(common: Estimate, fit_u_s: float, known_u_s: float, runs: int) -> str:
    """The common lag and what keeps it from being better known.

    ``fit_u_s``: its standard uncertainty within the fit's structure; ``known_u_s``: that, were burst and entry known.
    """
    who = "One plunge gives" if runs == 1 else f"{runs} plunges give"
    text = f"{who} a common lag of {with_u(common.value, common.u, 's')}"
    known = f"with the entry burst and the entry time known it would be +- {rounded(known_u_s, known_u_s)[1]} s"
    if fit_u_s <= max(0.05, 0.10 * common.value):
        return f"{text}; the entry burst is told apart from it ({known})."
    return (
        f"{text}; {known}, so these data cannot separate the lag from the burst: take the differences between channels "
        "from here and the common lag from an unloading."
    )


def fit_warnings(
    runs: Sequence[PlungeRun], blocks: Sequence[Blocks], best: Optimum, validity: Sequence[Sequence[Finding]]
) -> tuple[str, ...]:
    """One sentence for everything in the fit that a careful reader should know."""
    out: list[str] = []
    if not best.converged:
        out.append("the plunge fit stopped before it converged")
    problem = best.problem
    pull = np.where(np.isfinite(problem.sd), (best.theta - problem.mean) / problem.sd, 0.0)
    for name, p in zip(problem.layout.names(), pull):
        if name.startswith("ln_h_") and abs(p) > UNBELIEVABLE:
            r = int(name.rpartition("_")[2]) - 1
            ratio = float(np.exp(best.theta[problem.layout.run(r).start]))
            out.append(
                f"{runs[r].name}: h comes out {ratio:.2g} times what the correlation gives for {runs[r].fluid.name} "
                f"({abs(p):.1f} prior standard deviations off): is the fluid the right one?"
            )
        elif abs(p) > 3:
            what = parameter_words(name, [r.name for r in runs])
            out.append(f"{what} lies {abs(p):.1f} prior standard deviations from what was expected")
    for run, b, v, factor in zip(runs, blocks, validity, problem.inflation):
        out += [f"{run.name}: {w}" for w in sentences((*run.entry.findings, *v))]
        if b.spikes:
            out.append(f"{run.name}: {b.spikes} spikes were left out")
        if factor.common > COLOURED or factor.differential > COLOURED:
            doubt = OTHER_DISK if factor.differential > COLOURED else ""
            out.append(
                f"{run.name}: residuals are coloured (variance factors {factor.common:.1f} common, "
                f"{factor.differential:.1f} differential); the uncertainties were widened for it{doubt}"
            )
    for j, c in enumerate(problem.layout.channels):
        if best.theta[problem.layout.lag][j] < 0.01:
            out.append(f"channel {c}: the lag ran into zero; its interval is not to be trusted")
    return tuple(dict.fromkeys(out))


def parameter_words(name: str, runs: Sequence[str]) -> str:
    """A parameter of the fit's layout in words, with its plunge or channel.

    >>> parameter_words("ln_burst_time_2", ["P1.csv", "P2.csv"]), parameter_words("depth_e", [])
    ('P2.csv: the duration of the entry burst', 'channel e: the junction depth')
    """
    kind, _, last = name.rpartition("_")
    if kind in RUN_WORDS and last.isdigit():
        return f"{runs[int(last) - 1]}: the {RUN_WORDS[kind]}"
    if kind in CHANNEL_WORDS:
        return f"channel {last}: the {CHANNEL_WORDS[kind]}"
    return {"ln_conductivity": "the conductivity", "common_split": "the split of the lags over two stages"}.get(
        name, name
    )
