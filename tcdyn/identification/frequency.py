"""Transfer functions fitted to measured frequency responses by weighted least squares.

``tcdyn.identification.fit_response`` is the public function; ``tcdyn response`` calls it. Starting
values come from Levy's linear problem with the iteration of Sanathanan and
Koerner. ``tests/identify/test_identify_frequency.py`` checks recovery and coverage,
``tests/identify/test_identify_closed_forms.py`` the starting values and the uncertainty from a
coherence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.polynomial.polynomial import polyval
from scipy.special import chdtrc

from tcdyn.chain.rational import Complex
from tcdyn.core import Array
from tcdyn.core.arguments import with_named_arguments
from tcdyn.core.errors import InputError, utf8
from tcdyn.core.estimate import Estimate
from tcdyn.core.findings import Finding, info, warning, warnings_and_errors
from tcdyn.core.findings import error as error_finding
from tcdyn.core.result import Result, jsonable
from tcdyn.core.threads import one_blas_thread
from tcdyn.estimation import Optimum, Problem, lowest_cost, minimise
from tcdyn.identification.identified import Identified
from tcdyn.identification.models import Model, as_model
from tcdyn.identification.recommendation import DECISIVE_BIC, MIN_FIT_PERCENT
from tcdyn.identification.response_table import ResponseColumns
from tcdyn.identification.search import criteria, search_findings
from tcdyn.identification.starting_values import LAG_PATTERNS, from_poles, share_lag, stabilise
from tcdyn.identification.validation import ALARM_P, NUMERICAL_ERROR, whiteness
from tcdyn.io.read import Part, open_table, read_all_rows
from tcdyn.io.response_units import response_column_named
from tcdyn.series.source import check_numbers

# Grids and settings of the search, chosen by judgement.
N_DELAYS = 13  # dead times of the starting values
DELAY_STRIDE = 4  # every so many of them also with shared lags
N_LAGS = 9  # lags of the starting values of process models
LEVY_ROUNDS = 10  # of reweighting in the linear problem
N_SEARCHES = 4  # starting values from which the search starts
WEIGHT_ROUNDS = 4  # of weights that are relative to the model's magnitude
MIN_MODEL_SHARE = 0.1  # model over data, the least magnitude for such a weight
# Neighbouring frequencies over which residuals are compared: a misfit runs over several of them.
# False alarms and misses: python -m tests.identify.response_study
WHITENESS_LAGS = 4
# Floors of a noise of unknown size, over the largest response.
NOISE_FLOORS = (0.0, 1e-3, 1e-2, 0.1, 1.0)
# Frequency of the fastest and slowest lag over the ends of the data's band.
MAX_BAND_RATIO = 1e3


@dataclass(frozen=True, repr=False)
class Response(Result):
    """A measured frequency response, output over input.

    Parameters
    ----------
    frequency_Hz
        Frequencies (F,).
    response
        Complex response (F,).
    u
        Standard uncertainty of the real and of the imaginary part (F,).
    name
        Name, for messages.
    relative_u
        Standard uncertainty over the true magnitude (F,), in place of ``u``. With neither it is an
        equal unknown share of the magnitude, above an unknown floor.
    floor
        The floor of the noise.
    findings
        Findings of the reader.
    """

    frequency_Hz: Array
    response: Complex
    u: Array | None = None
    name: str = "frequency response"
    relative_u: Array | None = None
    floor: float = 0.0
    findings: tuple[Finding, ...] = ()

    def summary(self) -> str:
        """Name, number of frequencies and their range."""
        f = self.frequency_Hz
        return f"{self.name}: {len(f)} frequencies, {np.min(f):.3g} to {np.max(f):.3g} Hz"

    def to_dict(self) -> dict[str, Any]:
        """The table of :meth:`to_frame`."""
        return {"name": self.name, "response": jsonable(self.to_frame().reset_index())}

    def to_frame(self) -> pd.DataFrame:
        """Magnitude and phase over the frequency [Hz], and the uncertainty where it is given."""
        columns = {
            "magnitude": np.abs(self.response),
            "magnitude_dB": 20 * np.log10(np.abs(self.response)),
            "phase_deg": np.rad2deg(np.unwrap(np.angle(self.response))),
        }
        if self.u is not None:
            columns["u"] = self.u
        if self.relative_u is not None:
            columns["relative_u"] = self.relative_u
        return pd.DataFrame(columns, pd.Index(self.frequency_Hz, name="frequency_Hz"))

    @property
    def unknown_uncertainty(self) -> bool:
        """Whether no uncertainty is given."""
        return self.u is None and self.relative_u is None

    def __post_init__(self) -> None:
        """Check frequencies, responses and uncertainties.

        Raises
        ------
        InputError
            For values that are not finite, frequencies that repeat, or uncertainties not above
            zero.
        """
        f = self.frequency_Hz
        h = self.response
        u = self.u if self.relative_u is None else self.relative_u
        if len(f) == 0:
            raise InputError(
                "has no row with a frequency and a response",
                where=self.name,
                expected="one row for each frequency",
            )
        is_finite = len(f) == len(h) and np.isfinite(f).all() and np.isfinite(h).all()
        if not (is_finite and np.all(f > 0) and np.all(h != 0)):
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
        """Build a response from magnitude and phase, with an uncertainty or a coherence.

        Parameters
        ----------
        frequency_Hz, magnitude, phase_deg
            Frequencies [Hz], magnitudes and phases [deg] (F,).
        u
            Standard uncertainty (F,).
        coherence
            Coherence g2 (F,) of the estimate H1 = S_uy/S_uu.
        averages
            Number n of independent averages of the coherence.
        name
            Name, for messages.

        Returns
        -------
        Response
            The response; with a coherence its uncertainty is relative to the true magnitude.

        Raises
        ------
        InputError
            For a negative magnitude, or a coherence outside 0 to 1 or without the number of
            averages.

        Notes
        -----
        u = |H| sqrt((1 - g2)/(2 n g2)), H the true response. Source: Bendat and Piersol, Random
        Data, 4th ed. (2010), 9.2.
        """
        f = np.asarray(frequency_Hz, dtype=float)
        size = np.asarray(magnitude, dtype=float)
        phase = np.asarray(phase_deg, dtype=float)
        if np.any(size < 0):
            raise InputError(
                f"a magnitude of {size.min():g}",
                where=name,
                expected="0 or more",
                remedy="say the form: dB or complex",
            )
        relative_u = None
        if coherence is not None:
            g2 = np.asarray(coherence, dtype=float)
            has_averages = averages is not None and averages >= 1
            if averages is None or not has_averages or not np.all((g2 > 0) & (g2 < 1)):
                raise InputError(
                    "coherence", where=name, expected="between 0 and 1, with the number of averages"
                )
            u = None
            relative_u = np.sqrt((1 - g2) / (2 * averages * g2))
        if u is not None:
            u = np.asarray(u, dtype=float)
        return cls(f, size * np.exp(1j * np.deg2rad(phase)), u, name, relative_u)

    @classmethod
    @with_named_arguments
    def read(
        cls,
        path: str | Path,
        frequency: str,
        columns: tuple[str, str],
        *,
        form: str | None = None,
        frequency_unit: str | None = None,
        phase_unit: str | None = None,
        u: str | None = None,
        coherence: str | None = None,
        averages: float | None = None,
        sheet: str | None = None,
        variable: str | None = None,
    ) -> Response:
        """Read a response from a table; rows with a gap are left out.

        The units are those of the header, such as "w_rad_s", "f [mHz]", "Magnitude (dB)" and
        "phase_deg", or of a row of units below it.

        Parameters
        ----------
        path
            The file.
        frequency
            Column of the frequency.
        columns
            Columns of magnitude and phase, or of the real and the imaginary part. All columns are
            named with or without their units.
        form
            "magnitude"; "dB": the magnitude is in decibels; "complex": the columns are the real
            and the imaginary part. By default that of the header, else "magnitude".
        frequency_unit, phase_unit
            Units of frequency and phase, such as "mHz", "rad/s" and "rad"; by default those of the
            header, else Hz (rad/s for names such as omega) and degrees.
        u, coherence
            Columns of the uncertainty or of the coherence.
        averages
            Number of independent averages of the coherence.
        sheet, variable
            Sheet of a workbook, and variable of a MATLAB file, that hold the table; needed only if
            several have these columns.

        Returns
        -------
        Response
            The response, named after the file, with a finding about units that are assumed.

        Raises
        ------
        InputError
            For a missing column or text in place of a number, and for a unit that is not known,
            may be two things, or contradicts an argument.

        Examples
        --------
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder, "bode.csv")
        ...     _ = path.write_text("f_mHz,Gain (dB),phase_rad\\n10,-6.0206,-0.5\\n20,-20,-1\\n")
        ...     table = Response.read(path, "f_mHz", ("Gain (dB)", "phase_rad")).to_frame()
        >>> table["magnitude"].round(3).to_dict()
        {0.01: 0.5, 0.02: 0.1}
        """
        names = [c for c in (frequency, *columns, u, coherence) if c is not None]
        source = open_table(path, names, Part(sheet, variable))
        where = utf8(Path(path).name)
        found = {name: response_column_named(name, source.names, where) for name in names}
        names = list(found.values())
        for name in names:
            if source.names.count(name) > 1:
                raise InputError(
                    f"column {name!r} stands twice", where=where, remedy="rename one of them"
                )
        cells = read_all_rows(source, names)
        for name in names:
            check_numbers(name, cells.stamps.get(name, cells.data[name]), where)
        table = {name: cells.data[name] for name in names}
        complete = np.isfinite(list(table.values())).all(axis=0)
        table = {name: values[complete] for name, values in table.items()}
        stated = ResponseColumns(
            where,
            found[frequency],
            (found[columns[0]], found[columns[1]]),
            None if u is None else found[u],
            None if coherence is None else found[coherence],
            form,
            frequency_unit,
            phase_unit,
            source.units,
        )
        arrays, findings = stated.converted(table)
        response = cls.of(**arrays, averages=averages, name=where)
        return replace(response, findings=tuple(findings))

    def part_uncertainty(self, model: Complex | None = None) -> Array:
        """Return the standard uncertainty of the real and of the imaginary part.

        A relative uncertainty is a share of the magnitude of the ``model`` (F,), if given: a share
        of a magnitude that was measured too small would be too small.

        Parameters
        ----------
        model
            Response of the model (F,), which replaces the measured magnitude in a relative
            uncertainty.

        Returns
        -------
        array
            Standard uncertainty (F,), of each of the two parts.
        """
        if self.u is not None:
            return self.u
        size = np.abs(self.response)
        if model is not None:
            size = np.maximum(np.abs(model), MIN_MODEL_SHARE * size)
        return np.hypot(size, self.floor) if self.relative_u is None else size * self.relative_u


@with_named_arguments
@one_blas_thread
def fit_response(data: Response, model: Model | str = "P1D") -> Identified:
    """Weighted least-squares fit of a model to a frequency response, with uncertainties.

    Starting values are not needed.

    Parameters
    ----------
    data
        The frequency response.
    model
        Model of one input, or its name.

    Returns
    -------
    Identified
        The model with estimates, statistics and findings.

    Raises
    ------
    InputError
        For too few frequencies, or a model of several inputs or with a noise model.

    Notes
    -----
    Minimises sum |H - G(2 pi i f)|^2/u^2. It starts at Levy's linear problem, weighted as by
    Sanathanan and Koerner (1963), over dead times. A relative u is iterated with the magnitude of
    G. Errors at different frequencies are taken as independent. Where no uncertainty is given, its
    size follows from the residuals, and its floor by likelihood; whether the model is right is then
    judged by the residuals of neighbouring frequencies (:func:`residual_whiteness`, 1 %). Where the
    residuals are larger than the given uncertainty (chi-squared, 1 %), the intervals are widened by
    that ratio and there is a finding. A fit below ``MIN_FIT_PERCENT`` is a warning, and an error
    where one of these tests rejects the model as well.

    ``NOISE_FLOORS``, the numbers of starts and of rounds may be increased; that costs time only.
    ``tests/identify/test_identify_frequency.py`` fails where a structure is no longer found.

    Examples
    --------
    >>> f = np.geomspace(0.01, 1, 12)
    >>> h = 2 * np.exp(-2j * np.pi * f * 0.3) / (1 + 2j * np.pi * f * 1.5)
    >>> round(fit_response(Response(f, h), "P1D").theta["Tp1"], 6)
    1.5
    """
    structure = as_model(model)
    if structure.submodels or structure.arx:
        raise InputError(
            f"{structure.name} with a frequency response", expected="one input, and no noise model"
        )
    dof = 2 * len(data.frequency_Hz) - len(structure.free)
    if dof < 1:
        raise InputError(
            f"{len(data.frequency_Hz)} frequencies for {len(structure.free)} parameters",
            where=data.name,
        )
    start_points = _ranked_starts(data, structure)
    if not start_points:
        raise InputError(
            f"no stable {structure.name} was found", where=data.name, remedy="try another model"
        )
    floors = [data]
    if data.unknown_uncertainty:
        largest = float(np.abs(data.response).max())
        floors = [replace(data, floor=share * largest) for share in NOISE_FLOORS]
    candidates = []
    for with_floor in floors:
        optimum, u = fit_weighted(with_floor, structure, start_points)
        start_points = [optimum.theta, start_points[0]]
        candidates.append(make_identified(with_floor, structure, optimum, dof, u))
    return min(candidates, key=lambda candidate: round(candidate.statistics["bic"], 6))


@with_named_arguments
def best_response_fit(fits: Sequence[Identified]) -> Identified:
    """Return the fit to use: of those without a warning the one of least BIC.

    Parameters
    ----------
    fits
        Fits of several models to one response, as of :func:`fit_response`.

    Returns
    -------
    Identified
        One of them, the first of equal ones. Where each fit without a warning has a BIC more than
        ``DECISIVE_BIC`` above the least, the fit of least BIC with its warnings: no other
        describes the response.

    Examples
    --------
    >>> f = np.geomspace(0.01, 1, 12)
    >>> data = Response(f, 2 * np.exp(-2j * np.pi * f * 0.3) / (1 + 2j * np.pi * f * 1.5))
    >>> best_response_fit([fit_response(data, name) for name in ("P1", "P1D")]).model.name
    'P1D'
    """

    def bic(fit: Identified) -> float:
        """Return the BIC; differences of rounding are no difference."""
        return round(fit.statistics["bic"], 6)

    least = min(fits, key=bic)
    limit = bic(least) + DECISIVE_BIC
    candidates = [
        fit for fit in fits if bic(fit) <= limit and not warnings_and_errors(fit.findings)
    ]
    return min(candidates, key=bic, default=least)


def _ranked_starts(data: Response, model: Model) -> list[Array]:
    """Return the best starting values, least cost first.

    Parameters
    ----------
    data
        The response.
    model
        The model structure.

    Returns
    -------
    list of array
        At most ``N_SEARCHES`` vectors x; none where no start is stable.
    """
    problem = weighted_problem(data, model)
    candidates = []
    for x in starts(data, model):
        rows = problem.evaluate(x)
        if rows is not None:
            candidates.append((float(rows[0] @ rows[0]), x))
    candidates.sort(key=lambda candidate: candidate[0])
    return [x for _, x in candidates[:N_SEARCHES]]


def fit_weighted(data: Response, model: Model, start_points: list[Array]) -> tuple[Optimum, Array]:
    """Fit from several starts, with weights that follow the model's magnitude.

    A relative uncertainty is iterated with the magnitude of the model.

    Parameters
    ----------
    data
        The response.
    model
        The model structure.
    start_points
        Vectors x to start from.

    Returns
    -------
    optimum
        The best optimum.
    u
        Standard uncertainties (F,) by which the residuals were divided.
    """
    problem = weighted_problem(data, model)
    best = lowest_cost([minimise(problem, x, limit=100, tolerance=0.0) for x in start_points])
    u = data.part_uncertainty()
    for _ in range(WEIGHT_ROUNDS if data.u is None else 0):
        rational = model.rational(model.theta(best.theta))
        u = data.part_uncertainty(rational.frequency_response(data.frequency_Hz))
        problem = weighted_problem(data, model, u)
        best = minimise(problem, best.theta, limit=100, tolerance=0.0)
    return best, u


def weighted_problem(data: Response, model: Model, u: Array | None = None) -> Problem:
    """Return the least-squares problem of a frequency response.

    The real parts come first, then the imaginary parts.

    Parameters
    ----------
    data
        The response.
    model
        The model structure.
    u
        Standard uncertainties (F,); None for those of the data.

    Returns
    -------
    Problem
        Residuals (2F,) over their uncertainty: the real parts, then the imaginary ones.
    """
    u = data.part_uncertainty() if u is None else u
    f = data.frequency_Hz

    def evaluate(x: Array) -> tuple[Array, Array] | None:
        """Return residuals (2F,) and Jacobian (2F, P) at x; None for an unstable model."""
        theta = model.theta(x)
        rational = model.rational(theta)
        if not rational.is_stable:
            return None
        chain_rule = model.chain_rule(theta) * model.natural_scale(x)
        residual = (rational.frequency_response(f) - data.response) / u
        jacobian = (rational.frequency_sensitivity(f).T @ chain_rule) / u[:, None]
        return (
            np.concatenate([residual.real, residual.imag]),
            np.vstack([jacobian.real, jacobian.imag]),
        )

    lowest = 2 * np.pi * f.min()
    highest = 2 * np.pi * f.max()
    lags_s = (1 / (MAX_BAND_RATIO * highest), MAX_BAND_RATIO / lowest)
    lower, upper = model.bounds(lags_s, model.delay_max_s or longest_delay_s(data))
    return Problem(model.free, evaluate, lower=lower, upper=upper)


def longest_delay_s(data: Response) -> float:
    """Return the longest dead time [s] that the spacing of the frequencies can determine."""
    return float(0.5 / np.min(np.diff(np.sort(np.append(data.frequency_Hz, 0.0)))))


def starts(data: Response, model: Model) -> Iterator[Array]:
    """Yield starting values x: linear problems over dead times, and shared lags.

    Parameters
    ----------
    data
        The response.
    model
        The model structure.

    Returns
    -------
    iterator of array
        Vectors x (P,). The gain is fitted to the response.
    """
    f = data.frequency_Hz
    u = data.part_uncertainty()
    for theta in _start_parameters(data, model):
        theta = {**dict.fromkeys(model.names, 0.0), **theta, **model.fixed}
        if "Kp" in model.free:
            shape = model.rational({**theta, "Kp": 1.0}).frequency_response(f) / u
            inner_product = np.real(np.vdot(shape, data.response / u))
            theta["Kp"] = float(inner_product / max(np.real(np.vdot(shape, shape)), 1e-300))
        yield model.vector(theta)


def _start_parameters(data: Response, model: Model) -> list[dict[str, float]]:
    """Return starting parameters by name; the gain is fitted afterwards.

    Parameters
    ----------
    data
        The response.
    model
        The model structure.

    Returns
    -------
    list of dict
        Parameters in natural units.
    """
    f = data.frequency_Hz
    s = np.asarray(2j * np.pi * f, complex)
    inverse_known = polyval(s, np.array(model.known.den)) / polyval(s, np.array(model.known.num))
    unknown: Complex = data.response * inverse_known * s**model.integrators
    weight = np.abs(unknown / data.response) / data.part_uncertainty()
    if model.kind == "tf":
        n_zeros = sum(n.startswith("b") for n in model.names) - 1
    else:
        n_zeros = int("Tz" in model.names)
    delays = [model.fixed.get("Td", 0.0)]
    if model.has_delay:
        delays = _delay_grid(data)
    taus = np.geomspace(0.3 / np.abs(s).max(), 3 / np.abs(s).min(), N_LAGS).tolist()
    candidates = []
    for k, delay in enumerate(delays):
        if model.order and "Tc" not in model.names:
            response = unknown * np.exp(s * float(delay))
            num, den = levy(s, response, weight, n_zeros, model.order)
            if num[0]:
                candidates.append(from_poles(model, num, den, float(delay)))
        if model.kind == "process" and k % DELAY_STRIDE == 0:
            for tau, pattern in product(taus, range(len(LAG_PATTERNS))):
                candidates.append(share_lag(model, tau, delay, pattern))
    return candidates


def _delay_grid(data: Response) -> list[float]:
    """Return dead times [s] up to twice that of the phase at the highest frequency."""
    f = data.frequency_Hz
    phase = -np.unwrap(np.angle(data.response))[np.argmax(f)]
    delay = phase / (2 * np.pi * f.max())
    longest = np.clip(2 * delay, 0.1 / f.max(), longest_delay_s(data))
    return np.linspace(0, float(longest), N_DELAYS).tolist()


def levy(s: Complex, h: Complex, weight: Array, zeros: int, poles: int) -> tuple[Array, Array]:
    """Return numerator and denominator of B(s) - h A(s) = 0 in least squares.

    Parameters
    ----------
    s
        2 pi i f (F,).
    h
        Response (F,).
    weight
        Weight (F,); each round divides it by |A| of the round before.
    zeros, poles
        Degrees of numerator and denominator.

    Returns
    -------
    num, den
        Coefficients (zeros + 1,) and (poles + 1,), ascending in s. Unstable poles are mirrored.
    """
    scale = float(np.exp(np.mean(np.log(np.abs(s)))))  # the middle frequency
    z = s / scale
    den = np.ones(1)
    columns = [z**k for k in range(zeros + 1)]
    columns += [-h * z**k for k in range(1, poles + 1)]
    table = np.column_stack(columns)
    for _ in range(LEVY_ROUNDS):
        w = weight / np.abs(polyval(z, den))
        rows = table * w[:, None]
        target = h * w
        x = np.linalg.lstsq(
            np.vstack([rows.real, rows.imag]), np.append(target.real, target.imag), rcond=1e-12
        )[0]
        num = x[: zeros + 1]
        den = stabilise(np.append(1.0, x[zeros + 1 :]))
    return num / scale ** np.arange(zeros + 1), den / scale ** np.arange(poles + 1)


def make_identified(
    data: Response, model: Model, best: Optimum, dof: int, u_fit: Array
) -> Identified:
    """The identified model with its uncertainties, statistics and findings.

    Parameters
    ----------
    data, model, best
        The response, the model and the optimum.
    dof
        Degrees of freedom.
    u_fit
        Uncertainties (F,) of the weights.

    Returns
    -------
    Identified
        The model. Where no uncertainty is given, or the misfit is significant, the covariance is
        that of the residuals.
    """
    theta = model.theta(best.theta)
    n = 2 * len(data.frequency_Hz)
    chi2 = float(best.residual @ best.residual)
    findings = list(data.findings)
    p = np.nan
    variance = chi2 / dof
    model_response = model.rational(theta).frequency_response(data.frequency_Hz)
    error = np.abs(model_response - data.response)
    p_white = residual_whiteness(data, best, error)
    is_misfit = p_white < ALARM_P
    if data.unknown_uncertainty:
        share = np.sqrt(variance)
        findings.append(info("response.unstated", share=share, floor=data.floor * share))
        if is_misfit:
            findings.append(warning("response.systematic", subject=model.name, p=p_white))
    else:
        p = float(chdtrc(dof, chi2))
        is_misfit = p < ALARM_P
        if is_misfit:
            findings.append(
                warning("response.misfit", subject=model.name, ratio=np.sqrt(variance), p=p)
            )
        variance = max(variance, 1.0) if is_misfit else 1.0
    spread = np.linalg.norm(data.response - data.response.mean()) or 1.0
    percent = float(100 * (1 - np.linalg.norm(error) / spread))
    if percent < MIN_FIT_PERCENT:
        grade = error_finding if is_misfit else warning
        findings.append(grade("response.poor_fit", subject=model.name, fit_percent=percent))
    scale = model.natural_scale(best.theta)
    covariance = variance * best.covariance * np.outer(scale, scale)
    result = Identified.of(model, theta, covariance, dt_s=0.0)
    findings += search_findings(best, result.estimates, model.name, _warn_if_undetermined)
    count = len(model.free)
    deviance = chi2
    if data.unknown_uncertainty:
        count += 1
        deviance = n * np.log(max(chi2, 1e-300) / n)
    # the weights of the fit against those of the data: two parts, of the variance each
    weight_ratio = u_fit / replace(data, floor=0.0).part_uncertainty()
    deviance += 4 * float(np.sum(np.log(weight_ratio)))
    mean_square = np.mean(error**2)
    statistics = {
        "n": float(n),
        "parameters": float(len(model.free)),
        "rms": float(np.sqrt(mean_square)),
        "fit_percent": percent,
        "p_misfit": p,
        "p_white": p_white,
        **criteria(deviance, count, n),
    }
    return replace(
        result,
        noise_sd=float(np.sqrt(mean_square / 2)),
        statistics=statistics,
        findings=tuple(findings),
    )


def residual_whiteness(data: Response, best: Optimum, error: Array) -> float:
    """Return the chance of residuals so similar at neighbouring frequencies, by Ljung and Box.

    Parameters
    ----------
    data
        The response.
    best
        The optimum, with residuals (2F,) and their Jacobian: the real parts, then the imaginary.
    error
        Magnitudes (F,) of response less model.

    Returns
    -------
    float
        p; 1 where the residuals are rounding errors.

    Notes
    -----
    A model without the dynamics of the response leaves residuals that run smoothly over frequency,
    whatever their size, so this needs no stated uncertainty. Sound errors of neighbouring
    frequencies are independent. The test is that of the residuals of a record, with frequency in
    the place of time.
    """
    if np.max(error) <= NUMERICAL_ERROR * np.max(np.abs(data.response)):
        return 1.0
    count = len(data.frequency_Hz)
    order = np.argsort(data.frequency_Hz)
    rows = np.concatenate([order, count + order])
    parts = [slice(0, count), slice(count, 2 * count)]
    lags = min(WHITENESS_LAGS, max(count // 4, 1))
    return whiteness(best.residual[rows], best.jacobian[rows], parts, 1.0, lags).p


def _warn_if_undetermined(name: str, estimate: Estimate) -> Finding | None:
    """Return a warning about a parameter whose uncertainty is larger than its value, or None.

    A zero, a dead time and the coefficients of polynomials (a1, b0) may be zero: no warning.
    """
    may_be_zero = name in ("Tz", "Td") or name[0] in "ab"
    if may_be_zero or estimate.u <= abs(estimate.value):
        return None
    return warning("fit.undetermined", subject=name, value=estimate.value, u=estimate.u)
