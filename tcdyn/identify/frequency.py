"""Transfer functions fitted to measured frequency responses, with intervals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from numpy.polynomial.polynomial import polyval
from scipy.special import chdtrc

from tcdyn.chain.rational import Complex
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import Finding, info, warning
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation import Optimum, Problem, determined, least, minimise
from tcdyn.identify.identified import Identified
from tcdyn.identify.models import Model, as_model
from tcdyn.identify.search import beyond, criteria
from tcdyn.identify.starting_values import from_poles, spread, stabilised
from tcdyn.identify.tables import numbers, table_of
from tcdyn.identify.validate import ALARM
from tcdyn.io.read import open_table

DELAYS = 13
TAUS = 9
ROUNDS = 10
TRIED = 4
# rounds of uncertainties that go with the model's magnitude, and its least part of the data's
WEIGHED = 4
LEAST = 0.1
FLOORS = (
    0.0,
    1e-3,
    1e-2,
    0.1,
    1.0,
)  # of noise that is not stated, in magnitudes of the greatest response
FAR = 1e3  # times the band of the data, beyond which no lag is looked for


@dataclass(frozen=True)
class Response:
    """``response`` (F,) complex, output over input, at ``frequency_Hz`` (F,), each of its parts with the standard
    uncertainty ``u`` (F,), or a ``share`` (F,) of the true magnitude; with neither an equal share of it above a floor,
    neither of them known."""

    frequency_Hz: Array
    response: Complex
    u: Array | None = None
    name: str = "frequency response"
    share: Array | None = None
    floor: float = 0.0

    @property
    def unstated(self) -> bool:
        """Whether nothing is known of the uncertainty."""
        return self.u is None and self.share is None

    def __post_init__(self) -> None:
        f = self.frequency_Hz
        h = self.response
        u = self.u if self.share is None else self.share
        if len(f) != len(h) or not (
            np.isfinite(f).all() and np.isfinite(h).all() and np.all(f > 0) and np.all(h != 0)
        ):
            raise InputError(
                "not all is a number",
                where=self.name,
                expected="frequencies above 0, responses not 0",
            )
        if len(np.unique(f)) < len(f):
            raise InputError(
                "a frequency stands there twice",
                where=self.name,
                remedy="average the repeats, or leave one out",
            )
        if u is not None and not (len(u) == len(f) and np.isfinite(u).all() and np.all(u > 0)):
            raise InputError(
                "not all u are above 0", where=self.name, expected="one for each frequency"
            )

    @classmethod
    def of(
        cls,
        frequency_Hz: Array,
        *,
        magnitude: Array,
        phase_deg: Array,
        u: Array | None = None,
        coherence: Array | None = None,
        averages: float | None = None,
        name: str = "frequency response",
    ) -> Response:
        """From magnitude and phase [deg]; the uncertainty stated, or of H1 = S_uy/S_uu from its ``coherence`` g2 (F,)
        over so many independent ``averages`` n: u = |H| sqrt((1 - g2)/(2 n g2)), H the true one.

        Source: Bendat and Piersol, Random Data, 4th ed. (2010), 9.2.
        """
        f, size, phase = (np.asarray(x, dtype=float) for x in (frequency_Hz, magnitude, phase_deg))
        if np.any(size < 0):
            raise InputError(
                f"a magnitude of {size.min():g}",
                where=name,
                expected="0 or more",
                remedy="say the form: dB or complex",
            )
        share = None
        if coherence is not None:
            g2 = np.asarray(coherence, dtype=float)
            if averages is None or not averages >= 1 or not np.all((g2 > 0) & (g2 < 1)):
                raise InputError(
                    "coherence", where=name, expected="between 0 and 1, with the number of averages"
                )
            u = None
            share = np.sqrt((1 - g2) / (2 * averages * g2))
        stated = None if u is None else np.asarray(u, dtype=float)
        return cls(f, size * np.exp(1j * np.deg2rad(phase)), stated, name, share)

    @classmethod
    def read(
        cls,
        path: str | Path,
        frequency: str,
        columns: tuple[str, str],
        *,
        form: str = "magnitude",
        u: str | None = None,
        coherence: str | None = None,
        averages: float | None = None,
    ) -> Response:
        """From a table: ``columns`` are magnitude and phase [deg], with ``form`` "dB" the first in decibels, "complex"
        real and imaginary part; ``u`` or ``coherence`` are columns too. Rows with a gap are left out."""
        asked = [c for c in (frequency, *columns, u, coherence) if c is not None]
        frame = table_of(open_table(path, asked), asked)
        where = Path(path).name
        for c in asked:
            if c not in frame:
                raise InputError(
                    f"no column {c!r}", where=where, expected=", ".join(map(str, frame.columns))
                )
        table = {c: numbers(frame, c, where) for c in asked}
        whole = np.isfinite(list(table.values())).all(axis=0)
        f, a, b = (table[c][whole] for c in (frequency, *columns))
        if form == "complex":
            a, b = np.abs(a + 1j * b), np.rad2deg(np.angle(a + 1j * b))
        of_u, of_g = (None if c is None else table[c][whole] for c in (u, coherence))
        size = 10 ** (a / 20) if form == "dB" else a
        return cls.of(
            f, magnitude=size, phase_deg=b, u=of_u, coherence=of_g, averages=averages, name=where
        )

    def spread(self, model: Complex | None = None) -> Array:
        """Uncertainty (F,) of each part, where it goes with the magnitude with that of the ``model`` (F,): of a
        magnitude that was measured too small it would be too small."""
        if self.u is not None:
            return self.u
        size = np.abs(self.response)
        size = size if model is None else np.maximum(np.abs(model), LEAST * size)
        return np.hypot(size, self.floor) if self.share is None else size * self.share


def fit_response(data: Response, model: Model | str = "P1D") -> Identified:
    """The weighted least-squares fit of ``model`` to a frequency response, start-free, with uncertainties.

    Minimises sum |H - G(2 pi i f)|^2/u^2, begun at the linear problem of Levy, weighted as by Sanathanan and Koerner
    (1963), over dead times; a u that goes with the magnitude is that of G, in rounds. Errors of different frequencies
    are taken as independent. Where no uncertainty is stated its size, and by likelihood its floor, is that of the
    residuals; where these are larger than was stated (chi-squared, 1 %), the intervals are widened by as much and a
    finding says so. Raises InputError for too few frequencies.

    >>> f = np.geomspace(0.01, 1, 12)
    >>> h = 2 * np.exp(-2j * np.pi * f * 0.3) / (1 + 2j * np.pi * f * 1.5)
    >>> round(fit_response(Response(f, h), "P1D").theta["Tp1"], 6)
    1.5
    """
    with one_blas_thread:
        return _fitted_response(data, as_model(model))


def _fitted_response(data: Response, structure: Model) -> Identified:
    """The fit, with the arguments of ``fit_response``."""
    if structure.parts or structure.arx:
        raise InputError(
            f"{structure.name} with a frequency response", expected="one input, and no noise model"
        )
    freedom = 2 * len(data.frequency_Hz) - len(structure.free)
    if freedom < 1:
        raise InputError(
            f"{len(data.frequency_Hz)} frequencies for {len(structure.free)} parameters",
            where=data.name,
        )
    greatest = float(np.abs(data.response).max())
    shaped = [replace(data, floor=f * greatest) for f in FLOORS] if data.unstated else [data]
    problem = posed(data, structure)
    ranked = [
        (float(a[0] @ a[0]), x)
        for x in starts(data, structure)
        if (a := problem.evaluate(x)) is not None
    ]
    if not ranked:
        raise InputError(
            f"no stable {structure.name} was found", where=data.name, remedy="try another model"
        )
    begun = [x for _, x in sorted(ranked, key=lambda item: item[0])[:TRIED]]
    tried = []
    for one in shaped:
        best, u = weighed(one, structure, begun)
        begun = [best.theta, begun[0]]
        tried.append(identified(one, structure, best, freedom, u))
    return min(tried, key=lambda found: round(found.statistics["bic"], 6))


def weighed(data: Response, model: Model, begun: list[Array]) -> tuple[Optimum, Array]:
    """The optimum from the best of what was ``begun``, and the uncertainties (F,) that it was weighted with."""
    best = least([minimise(posed(data, model), x, limit=100, tolerance=0.0) for x in begun])
    u = data.spread()
    for _ in range(WEIGHED if data.u is None else 0):
        u = data.spread(
            model.rational(model.theta(best.theta)).frequency_response(data.frequency_Hz)
        )
        best = minimise(posed(data, model, u), best.theta, limit=100, tolerance=0.0)
    return best, u


def posed(data: Response, model: Model, u: Array | None = None) -> Problem:
    """Residuals (2F,), real parts and then imaginary ones, over their uncertainty ``u`` (F,)."""
    u = data.spread() if u is None else u
    w = 2 * np.pi * np.array([data.frequency_Hz.min(), data.frequency_Hz.max()])

    def evaluate(x: Array) -> tuple[Array, Array] | None:
        theta = model.theta(x)
        rational = model.rational(theta)
        if not rational.stable:
            return None
        natural = np.exp(np.where(model.logarithms, x, 0.0))
        slopes = (
            rational.frequency_sensitivity(data.frequency_Hz).T @ model.chain_rule(theta) * natural
        )
        r = (rational.frequency_response(data.frequency_Hz) - data.response) / u
        j = slopes / u[:, None]
        return np.concatenate([r.real, r.imag]), np.vstack([j.real, j.imag])

    lower, upper = model.box((1 / (FAR * w[1]), FAR / w[0]), model.delay_max_s or longest_s(data))
    return Problem(model.free, evaluate, lower=lower, upper=upper)


def longest_s(data: Response) -> float:
    """The longest dead time that the spacing of the frequencies can tell from a shorter one [s]."""
    return float(0.5 / np.min(np.diff(np.sort(np.append(data.frequency_Hz, 0.0)))))


def starts(data: Response, model: Model) -> Iterator[Array]:
    """x to begin at: linear problems over dead times, and for process models one lag's total shared out."""
    s = np.asarray(2j * np.pi * data.frequency_Hz, complex)
    known = polyval(s, np.array(model.known.den)) / polyval(s, np.array(model.known.num))
    rest: Complex = data.response * known * s**model.integrators
    u = data.spread()
    weight = np.abs(rest / data.response) / u
    slope = -np.unwrap(np.angle(data.response))[np.argmax(data.frequency_Hz)] / (
        2 * np.pi * data.frequency_Hz.max()
    )
    late = float(np.clip(2 * slope, 0.1 / data.frequency_Hz.max(), longest_s(data)))
    zeros = (
        sum(n.startswith("b") for n in model.names) - 1
        if model.kind == "tf"
        else int("Tz" in model.names)
    )
    begun: list[dict[str, float]] = []
    for k, delay in enumerate(
        np.linspace(0, late, DELAYS) if model.has_delay else [model.fixed.get("Td", 0.0)]
    ):
        if model.order and "Tc" not in model.names:
            num, den = levy(s, rest * np.exp(s * float(delay)), weight, zeros, model.order)
            begun.append(from_poles(model, num, den, float(delay)) if num[0] else {})
        if model.kind == "process" and k % 4 == 0:
            taus = np.geomspace(0.3 / np.abs(s).max(), 3 / np.abs(s).min(), TAUS)
            begun += [
                spread(model, tau, delay, pattern)
                for tau, pattern in product(taus.tolist(), range(3))
            ]
    for theta in filter(None, begun):
        theta = {**dict.fromkeys(model.names, 0.0), **theta, **model.fixed}
        if "Kp" in model.free:
            shape = model.rational({**theta, "Kp": 1.0}).frequency_response(data.frequency_Hz) / u
            theta["Kp"] = float(
                np.real(np.vdot(shape, data.response / u))
                / max(np.real(np.vdot(shape, shape)), 1e-300)
            )
        yield model.vector(theta)


def levy(s: Complex, h: Complex, weight: Array, zeros: int, poles: int) -> tuple[Array, Array]:
    """Numerator and denominator, ascending, of B(s) - h A(s) = 0 in least squares, the weight over |A| of the round
    before; scaled by the middle frequency."""
    middle = float(np.exp(np.mean(np.log(np.abs(s)))))
    z = s / middle
    below = np.ones(1)
    for _ in range(ROUNDS):
        w = weight / np.abs(polyval(z, below))
        table = np.column_stack(
            [z**k for k in range(zeros + 1)] + [-h * z**k for k in range(1, poles + 1)]
        )
        rows = table * w[:, None]
        target = h * w
        x = np.linalg.lstsq(
            np.vstack([rows.real, rows.imag]), np.append(target.real, target.imag), rcond=1e-12
        )[0]
        above = x[: zeros + 1]
        below = stabilised(np.append(1.0, x[zeros + 1 :]))
    return above / middle ** np.arange(zeros + 1), below / middle ** np.arange(poles + 1)


def identified(
    data: Response, model: Model, best: Optimum, freedom: int, u_fit: Array
) -> Identified:
    """The answer with its uncertainties and what was noticed; ``u_fit`` (F,) is what was fitted with."""
    theta = model.theta(best.theta)
    n = 2 * len(data.frequency_Hz)
    chi2 = float(best.residual @ best.residual)
    found = list[Finding]()
    p = 1.0
    scale = chi2 / freedom
    if data.unstated:
        found.append(
            info("response.unstated", share=np.sqrt(scale), floor=data.floor * np.sqrt(scale))
        )
    else:
        p = float(chdtrc(freedom, chi2))
        if p < ALARM:
            found.append(warning("response.misfit", subject=model.name, ratio=np.sqrt(scale), p=p))
        scale = max(scale, 1.0) if p < ALARM else 1.0
    free = np.exp(np.where(model.logarithms, best.theta, 0.0))
    covariance = scale * best.covariance * np.outer(free, free)
    answer = Identified.of(model, theta, covariance, dt_s=0.0)
    for i, (name, e) in enumerate(answer.estimates.items()):
        if end := beyond(best, i):
            found.append(warning("fit.bound", subject=name, end=end, value=e.value))
        elif e.u > abs(e.value) and name not in ("Tz", "Td") and name[0] not in "ab":
            found.append(warning("fit.undetermined", subject=name, value=e.value, u=e.u))
    if not determined(best.information):
        found.append(warning("fit.indistinct", subject=model.name))
    error = np.abs(model.rational(theta).frequency_response(data.frequency_Hz) - data.response)
    spread_ = np.linalg.norm(data.response - data.response.mean()) or 1.0
    count = len(model.free) + data.unstated
    deviance = n * np.log(max(chi2, 1e-300) / n) if data.unstated else chi2
    measured = replace(data, floor=0.0).spread()
    deviance += 4 * float(np.sum(np.log(u_fit / measured)))  # two parts, of the variance each
    statistics = {
        "n": float(n),
        "parameters": float(len(model.free)),
        "rms": float(np.sqrt(np.mean(error**2))),
        "fit_percent": float(100 * (1 - np.linalg.norm(error) / spread_)),
        "p_misfit": p,
        **criteria(deviance, count, n),
    }
    sd = float(np.sqrt(np.mean(error**2) / 2))
    return replace(answer, noise_sd=sd, statistics=statistics, findings=tuple(found))
