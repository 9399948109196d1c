"""The measurement chain from the junction to the log file: transfer function and state space.

The calibration fits chains (``immersion``), ``tcdyn.smoothing`` compensates for them, and
``tcdyn.partition`` equalises channels with them. A chain is a product of lags.
Responses are exact for the stated hold of the input, except that cement is a product of seven
lags (``cement_lags``). Guarded by ``tests/chain/test_chain.py`` and, for the state space,
``tests/smoothing/test_states.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike, NDArray
from scipy import signal
from scipy.linalg import solve_continuous_lyapunov

from tcdyn.chain.rational import (
    Factor,
    Hold,
    InitialState,
    Rational,
    polynomial_product,
    realise,
    simulate_rows,
)
from tcdyn.core import Array
from tcdyn.core.arguments import described, with_named_arguments
from tcdyn.core.errors import InputError
from tcdyn.core.labels import with_labels
from tcdyn.core.result import Result
from tcdyn.rig.disk import Conditioning

if TYPE_CHECKING:
    import control

# Relative difference below which two numbers of a ``control`` system are taken as equal; roots of a
# double pole are known to about the square root of the rounding error of doubles.
ROOT_TOLERANCE = 1e-6
# How a lag may be divided of which only the sum is known: probability, share of a second lag, and
# share of a dead time. The ratios t90/t50 of six sensors of a maker (SAB, insulated junction, 1.5
# to 6 mm, in water and air) are those of a second lag of 0, 0, 0.06, 0.14, 0.33 and 0.35 of the
# lag; of the small ones, a dead time explains the ratio as well.
DIVISIONS = ((1 / 3, 0.0, 0.0), (1 / 6, 0.1, 0.0), (1 / 6, 0.0, 0.1), (1 / 3, 0.34, 0.0))
# Share that is a dead time, with the same mean square effect on the coefficient of s^2 in 1/G
STATED_SPLIT_SHARE = 0.15
# A conditioning filter without poles: G = 1.
NO_CONDITIONING = Conditioning(poles=0)


@dataclass(frozen=True)
class Chain(Result):
    """Transfer function of the measurement chain, with G(0) = 1.

    G(s) = exp(-delay s) (1 + zero s) / prod_i (1 + taus_i s) * B(s) * M(s), where
    M(s) = (1 - exp(-mean s)) / (mean s) is the mean over the time before a row.

    Parameters
    ----------
    taus_s
        Time constants [s]: a number, or several in any sequence.
    zero_s
        Time constant of the zero [s].
    delay_s
        Dead time [s].
    conditioning
        The conditioning filter B; none by default.
    pair
        (Tw [s], zeta) of a complex pair of poles, which divides by 1 + 2 zeta Tw s + (Tw s)^2.
    cement_s
        Diffusion time [s] of a layer of cement, thickness^2/diffusivity, which divides by
        cosh(sqrt(cement s)): heat diffusing through the layer onto an insulated junction, a
        half-order lag with first moment cement/2.
    mean_s
        Time [s] over which a logger averages before each of its rows, which then hold the mean over
        that time; zero: each row is a reading of an instant.
    is_stated
        Whether only the lag is known, as from a data sheet, and not how it is divided into a second
        lag or a dead time. Results then are averages over ``DIVISIONS``.

    Raises
    ------
    InputError
        Time constants that are no numbers, or are negative or infinite; a negative dead time,
        cement or time of a mean; a pair that is not positive.

    Notes
    -----
    ``lag_s`` is the first moment of the impulse response: delay + sum of lags - zero + the lag of
    the filter + half of the time of the mean.

    A further element must be added to ``factors_without_filter`` (or ``rational``),
    ``frequency_response`` and ``summary``, and to ``tcdyn.chain.structures.ChainStructure`` if it
    is to be fitted by name. ``tests/chain/test_chain.py`` compares the response with
    ``frequency_response`` for each structure.

    Examples
    --------
    >>> Chain(1.5).lag_s, Chain([0.5, 0.1]).taus_s
    (1.5, (0.5, 0.1))
    >>> Chain((0.6, 0.1), conditioning=Conditioning(4.0, 2)).lag_s.__round__(4)
    0.7796
    """

    taus_s: tuple[float, ...]
    zero_s: float = 0.0
    delay_s: float = 0.0
    conditioning: Conditioning = NO_CONDITIONING
    pair: tuple[float, float] | None = None
    cement_s: float = 0.0
    mean_s: float = 0.0
    is_stated: bool = False
    lag_s: float = field(init=False, compare=False)

    if TYPE_CHECKING:

        def __init__(
            self,
            taus_s: float | Sequence[float],
            zero_s: float = 0.0,
            delay_s: float = 0.0,
            conditioning: Conditioning = NO_CONDITIONING,
            pair: tuple[float, float] | None = None,
            cement_s: float = 0.0,
            mean_s: float = 0.0,
            is_stated: bool = False,
        ) -> None: ...

    def __post_init__(self) -> None:
        """Check the values, and compute ``lag_s``.

        Raises
        ------
        InputError
            Values that no chain can have.
        """
        try:
            taus = tuple(map(float, np.ravel(self.taus_s)))
        except (TypeError, ValueError):
            raise InputError(
                f"Chain: lags are {self.taus_s!r}",
                expected="one lag in seconds, Chain(1.5), or several, Chain([1.5, 0.2])",
            ) from None
        object.__setattr__(self, "taus_s", taus)
        if not all(0 <= tau < np.inf for tau in taus) or not 0 <= self.delay_s < np.inf:
            raise InputError(
                f"Chain: lags and delay must not be negative; got {self.taus_s}, {self.delay_s}"
            )
        if self.cement_s < 0 or (self.pair is not None and min(self.pair) <= 0):
            raise InputError(
                f"Chain: cement and pair must be positive; got {self.cement_s}, {self.pair}"
            )
        is_number = isinstance(self.mean_s, (int, float, np.number))
        if not is_number or not 0 <= self.mean_s < np.inf:
            raise InputError(
                f"Chain: mean_s is {self.mean_s!r}",
                expected="the time in seconds over which a row is the mean, or zero",
            )
        lag = (
            self.delay_s
            - self.zero_s
            + sum(f[1] for f in self.factors_without_filter())
            + self.conditioning.lag_s
            + 0.5 * self.mean_s
        )
        object.__setattr__(self, "lag_s", float(lag))

    def factors_without_filter(self) -> tuple[tuple[float, ...], ...]:
        """Denominator factors without those of the conditioning filter.

        Returns
        -------
        Ascending coefficients in s of each factor: lags from the largest on, pair, cement.

        Notes
        -----
        The sequence of the lags is also that of the stages in ``sensors``.
        """
        factors: list[tuple[float, ...]] = [
            (1.0, tau) for tau in sorted(self.taus_s, reverse=True) if tau > 0
        ]
        if self.pair is not None:
            factors.append((1.0, 2 * self.pair[1] * self.pair[0], self.pair[0] ** 2))
        if self.cement_s:
            factors += [(1.0, self.cement_s * share) for share in cement_lags()]
        return tuple(factors)

    def factors(self) -> tuple[tuple[float, ...], ...]:
        """All denominator factors, those of the filter last.

        Returns
        -------
        Ascending coefficients in s of each factor.
        """
        return (*self.factors_without_filter(), *self.conditioning.factors)

    @cached_property
    def rational(self) -> Rational:
        """The chain as a product of its factors, for simulation; cement by its lags.

        Raises
        ------
        InputError
            For a chain with the mean of a logger, which is no product of factors.
        """
        if self.mean_s:
            raise InputError(
                f"the chain has rows that are means over {self.mean_s:g} s: it has no transfer "
                "function of finite order",
                remedy="smooth the record, or leave the mean out",
            )
        num = polynomial_product(
            [[1.0, self.zero_s] if self.zero_s else [1.0], self.conditioning.numerator]
        )
        return Rational(num, tuple(Factor(f) for f in self.factors()), self.delay_s)

    @property
    def parameters(self) -> dict[str, Any]:
        """All parameters of the sensor, by name, as a disk record stores them.

        The filter and the mean are those of the logger.
        """
        of_logger = ("conditioning", "mean_s")
        return {
            f.name: getattr(self, f.name)
            for f in fields(self)
            if f.init and f.name not in of_logger
        }

    def summary(self) -> str:
        """Lags, zero, dead time and filter, and the first moment of the chain, as text."""
        texts = []
        if self.taus_s:
            texts.append("lags " + ", ".join(f"{tau:.4g}" for tau in self.taus_s) + " s")
        if self.zero_s:
            texts.append(f"zero {self.zero_s:.4g} s")
        if self.pair:
            texts.append(f"complex pair Tw {self.pair[0]:.4g} s, zeta {self.pair[1]:.4g}")
        if self.cement_s:
            texts.append(f"cement {self.cement_s:.4g} s")
        if self.delay_s:
            texts.append(f"dead time {self.delay_s:.4g} s")
        if self.conditioning.poles:
            c = self.conditioning
            texts.append(f"conditioning {c.cutoff_Hz:g} Hz x {c.poles} ({c.shape})")
        if self.mean_s:
            texts.append(f"means over {self.mean_s:.4g} s")
        return f"{'; '.join(texts) or 'no dynamics'}; lag in all (first moment) {self.lag_s:.4g} s"

    def transfer_function(self, pade_order: int = 3) -> control.TransferFunction:
        """The chain as a ``control.TransferFunction``.

        Parameters
        ----------
        pade_order
            Order of the Pade approximation by which a dead time enters; a higher one holds up to
            higher frequencies.
        """
        return self.rational.transfer_function(pade_order)

    def state_space(self, pade_order: int = 3) -> control.StateSpace:
        """The chain as a ``control.StateSpace``.

        Parameters
        ----------
        pade_order
            Order of the Pade approximation by which a dead time enters.

        Examples
        --------
        >>> Chain([0.5, 0.1], delay_s=0.2).state_space(pade_order=2).nstates
        4
        """
        import control

        return control.ss(self.transfer_function(pade_order))

    @classmethod
    def from_control(
        cls, system: control.TransferFunction | control.StateSpace, delay_s: float = 0.0
    ) -> Chain:
        """The chain that a ``control`` system is: lags, at most one complex pair, and one zero.

        Parameters
        ----------
        system
            Continuous system of one input and one output, with static gain 1; poles and zeros do
            not cancel (``system.minreal()``).
        delay_s
            Dead time [s], which such a system does not hold.

        Returns
        -------
        Chain
            The same transfer function as a chain, without a conditioning filter.

        Raises
        ------
        InputError
            For a system that is no chain.

        Examples
        --------
        >>> import control
        >>> chain = Chain.from_control(control.tf([0.02, 1.0], [0.05, 0.6, 1.0]))
        >>> [round(tau, 6) for tau in chain.taus_s], round(chain.zero_s, 6)
        ([0.5, 0.1], 0.02)
        """
        if system.isdtime(strict=True) or not system.issiso():
            raise InputError(
                "Chain.from_control: the system is discrete or has several signals",
                expected="a continuous system of one input and one output",
            )
        poles = system.poles()
        zeros = system.zeros()
        gain = float(np.real(system.dcgain()))
        is_complex = np.abs(poles.imag) > ROOT_TOLERANCE * np.abs(poles)
        pairs = poles[is_complex]
        is_real = np.all(np.abs(zeros.imag) <= ROOT_TOLERANCE * np.abs(zeros))
        if (
            np.any(poles.real >= 0)
            or len(pairs) > 2
            or len(zeros) > 1
            or not is_real
            or abs(gain - 1) > ROOT_TOLERANCE
        ):
            raise InputError(
                f"Chain.from_control: gain {gain:.6g}, poles {np.round(poles, 6).tolist()}, "
                f"zeros {np.round(zeros, 6).tolist()}",
                expected="static gain 1, stable poles, at most one complex pair, one real zero",
                remedy="divide the system by its gain, system/system.dcgain()",
            )
        pair = None
        if len(pairs):
            frequency = float(np.abs(pairs[0]))
            pair = (1 / frequency, float(-pairs[0].real) / frequency)
        lags = sorted((-1 / poles[~is_complex].real).tolist(), reverse=True)
        zero_s = float(-1 / zeros[0].real) if len(zeros) else 0.0
        return cls(lags, zero_s, delay_s, pair=pair)

    def frequency_response(self, frequency_Hz: ArrayLike) -> NDArray[np.complex128]:
        """G(2 pi i f), with dead time and cement exact.

        Parameters
        ----------
        frequency_Hz
            Frequencies [Hz], any shape.

        Returns
        -------
        Complex gains, in the shape of ``frequency_Hz``.
        """
        s = 2j * np.pi * np.asarray(frequency_Hz, dtype=float)
        value = (1.0 + self.zero_s * s) * polyval(s, self.conditioning.numerator)
        value = value * np.exp(-self.delay_s * s) / np.cosh(np.sqrt(self.cement_s * s))
        for f in replace(self, cement_s=0.0).factors():
            value = value / polyval(s, f)
        half = 0.5 * self.mean_s * s
        return np.asarray(value * np.exp(-half) * np.sinc(half.imag / np.pi))

    def response(
        self, u: ArrayLike, dt_s: float, hold: Hold = "foh", initial: InitialState = "equilibrium"
    ) -> NDArray[np.float64]:
        """Response of the chain to an input sampled every ``dt_s`` seconds.

        Parameters
        ----------
        u
            Input (N,) or (N, M), one column a channel; the response has the same shape, and the
            labels of a Series or DataFrame.
        dt_s
            Sampling interval [s].
        hold
            Input between samples: a straight line (``foh``) or constant (``zoh``). Lags and dead
            time, an integer number of samples or not, are exact under that hold.
        initial
            Start in equilibrium with the first sample, or from zero.

        Returns
        -------
        Response, in the shape and unit of ``u``.
        """
        values = np.asarray(u, dtype=float)
        table = values.reshape(len(values), -1)
        columns = [self._response_of(x, dt_s, hold, initial) for x in table.T]
        response = np.stack(columns, axis=1).reshape(values.shape)
        labelled: NDArray[np.float64] = with_labels(response, u)
        return labelled

    def _response_of(self, u: Array, dt_s: float, hold: Hold, initial: InitialState) -> Array:
        """The response (N,) to one input (N,): that of ``rational``, or its mean over ``mean_s``.

        The mean is a difference of the integral of the response.
        """
        if not self.mean_s:
            system = realise(self.rational, sensitivities=False)
            return simulate_rows(system, u, dt_s, self.delay_s, hold, initial)[0]
        integral = replace(replace(self, mean_s=0.0).rational, integrators=1)
        system = realise(integral, sensitivities=False)
        before_s = self.delay_s + self.mean_s
        until_now = simulate_rows(system, u, dt_s, self.delay_s, hold, initial)[0]
        until_start = simulate_rows(system, u, dt_s, before_s, hold, initial)[0]
        return np.asarray((until_now - until_start) / self.mean_s)

    def discrete(
        self, dt_s: float, hold: Hold = "foh"
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Digital form of the chain in powers of z^-1, exact under ``hold``; without dead time.

        Parameters
        ----------
        dt_s
            Sampling interval [s].
        hold
            Input between samples, as in ``response``.

        Returns
        -------
        b, a
            Numerator and denominator, see ``discretised``.
        """
        num, den = self.rational.polynomials()
        if len(den) == 1:
            return np.array([1.0]), np.array([1.0])
        return discretised(num, den, dt_s, hold)

    def with_lag_shift(self, shift_s: float) -> Chain:
        """The same chain with its largest lag longer by ``shift_s`` (never below zero)."""
        taus = sorted(self.taus_s, reverse=True) or [0.0]
        return replace(self, taus_s=(max(taus[0] + shift_s, 0.0), *taus[1:]))

    def divided(self) -> list[tuple[float, Chain]]:
        """What a chain of which only the lag is stated may be: probabilities, and chains.

        Examples
        --------
        >>> divided = Chain(1.0, is_stated=True).divided()
        >>> [(round(p, 2), c.taus_s, c.delay_s) for p, c in divided[:3]]
        [(0.33, (1.0,), 0.0), (0.17, (0.9, 0.1), 0.0), (0.17, (0.9,), 0.1)]
        """
        if not self.is_stated or len(self.taus_s) != 1:
            return [(1.0, self)]
        (tau,) = self.taus_s
        chains = []
        for probability, second, dead in DIVISIONS:
            taus_s = ((1 - second - dead) * tau, second * tau) if second else ((1 - dead) * tau,)
            delay_s = self.delay_s + dead * tau
            chain = replace(self, taus_s=taus_s, delay_s=delay_s, is_stated=False)
            chains.append((probability, chain))
        return chains

    def with_split_shift(self, shift_s: float) -> Chain:
        """The same total lag, with part of the largest lag moved to the next.

        Parameters
        ----------
        shift_s
            Amount that is moved [s], at most the largest lag. It goes to the dead time where there
            is no second lag.

        Examples
        --------
        >>> Chain((0.5, 0.25)).with_split_shift(0.125).taus_s
        (0.375, 0.375)
        """
        taus = sorted(self.taus_s, reverse=True) or [0.0]
        shift = min(shift_s, taus[0])
        if len(taus) == 1:
            return replace(self, taus_s=(taus[0] - shift,), delay_s=self.delay_s + shift)
        return replace(self, taus_s=(taus[0] - shift, taus[1] + shift, *taus[2:]))

    def split_s2(self, shift_s: float) -> float:
        """Change of the coefficient of s^2 in 1/G by ``with_split_shift`` [s2].

        The coefficient of s does not change.

        Parameters
        ----------
        shift_s
            Amount that is moved [s].

        Notes
        -----
        Only lags and dead time are counted; the zero, the pair, cement and the filter do not
        change. ``Sensor.split_row`` is the effect of a unit of this number.

        Examples
        --------
        >>> Chain((0.5, 0.25)).split_s2(0.125)
        0.015625
        """
        chains = (self, self.with_split_shift(shift_s))
        coefficients = []
        for c in chains:
            delay = (1.0, c.delay_s, 0.5 * c.delay_s**2)
            lags = [(1.0, tau) for tau in c.taus_s]
            coefficients.append(float(polynomial_product([*lags, delay])[2]))
        return coefficients[1] - coefficients[0]


@with_named_arguments
def chains_for(chains: float | Chain | Sequence[Chain], count: int) -> list[Chain]:
    """One chain for each channel.

    Parameters
    ----------
    chains
        One chain for all channels, one number [s] that states the lag of all, or one chain for each
        channel. A ``control`` system of static gain 1 is a chain too.
    count
        Number of channels.

    Returns
    -------
    Chains, one for each channel.

    Raises
    ------
    InputError
        For another number of chains, and for several numbers, which could be lags or channels.

    Examples
    --------
    >>> [c.taus_s for c in chains_for(1.5, 2)]
    [(1.5,), (1.5,)]
    """
    if hasattr(chains, "dcgain"):
        chains = Chain.from_control(chains)
    if isinstance(chains, Chain):
        return [chains] * count
    if np.ndim(chains) == 0:  # type: ignore[arg-type]
        return [Chain(chains, is_stated=True)] * count  # type: ignore[arg-type]
    listed = [
        Chain.from_control(c) if hasattr(c, "dcgain") else c
        for c in chains  # type: ignore[union-attr]
    ]
    if not all(isinstance(c, Chain) for c in listed):
        lags = ", ".join(map(described, listed))
        raise InputError(
            f"chains are [{lags}]",
            remedy=f"write Chain([{lags}]) for a sensor of several lags, one Chain per channel",
        )
    if len(listed) != count:
        raise InputError(
            f"{count} channels but {len(listed)} chains", expected="one chain, or one per channel"
        )
    return listed


@with_named_arguments
def cement_lags() -> tuple[float, ...]:
    """Lags of 1/cosh(sqrt(s)) as shares of its diffusion time.

    Returns
    -------
    1/((k - 1/2)^2 pi^2) for k = 1 to 4, and the remainder in three equal lags.

    Notes
    -----
    cosh(sqrt(s)) = prod_k (1 + s/((k - 1/2)^2 pi^2)) exactly; the shares sum to 1/2, the first
    moment. Four poles and the remainder keep the step response within 2e-3 of the exact one. More
    poles may be taken; the sum must stay 1/2. ``tests/chain/test_chain.py`` compares with the
    diffusion solution.
    """
    shares = [1 / ((k - 0.5) ** 2 * np.pi**2) for k in range(1, 5)]
    return (*shares, *[(0.5 - sum(shares)) / 3] * 3)


@with_named_arguments
def discretised(
    num: ArrayLike, den: ArrayLike, dt_s: float, hold: Hold = "foh"
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Digital form of a rational transfer function, exact under ``hold``.

    Parameters
    ----------
    num, den
        Numerator and denominator in descending powers of s.
    dt_s
        Sampling interval [s].
    hold
        Input between samples: a straight line (``foh``) or constant (``zoh``).

    Returns
    -------
    b, a
        Numerator and denominator in powers of z^-1.
    """
    system = signal.cont2discrete(signal.tf2ss(num, den), dt_s, method=hold)[:4]
    b, a = signal.ss2tf(*system)
    return np.asarray(b[0]), np.asarray(a)


@dataclass(frozen=True)
class Sensor:
    """State space of a chain: d state/dt = drift @ state, reading = output @ state.

    The state is (x, x', stages). x is the junction temperature [degC], x' its slope [K/s]. Every
    stage has unit static gain, so all stages are in degC. Where the rows are means, the last states
    are the integrals of the reading since the last row, from that row to the one before, and so on,
    over the time of the mean; the reading is their sum.

    Parameters
    ----------
    drift, output
        System matrix (n, n) and output row (n,).
    lag_row
        ``lag_row @ state`` is the change of the compensated temperature per second of lag [K/s].
    split_row
        ``split_row @ state`` is that per ``Chain.split_s2`` [K/s2].
    ramp
        State (n, 2) of a chain that has always followed a level of 1, and a slope of 1 through
        zero.
    scatter
        Stationary covariance (n, n) of the stages about the ramp, for slope noise of intensity 1
        K2/s3.
    level_scatter
        The same for noise that drives the temperature itself, of intensity 1 K2/s.
    delay_s, lag_s
        Dead time and total lag [s].
    mean_s
        Time [s] over which each row is a mean; zero: there is no mean.
    mean_rows
        Number of rows over which a mean goes: that of the last states.
    """

    drift: Array
    output: Array
    lag_row: Array
    split_row: Array
    ramp: Array
    scatter: Array
    level_scatter: Array
    delay_s: float
    lag_s: float
    mean_s: float = 0.0
    mean_rows: int = 0

    @property
    def at_row(self) -> Array:
        """Matrix (n, n) of the states at a row: each integral passes on, and a new one starts."""
        matrix = np.eye(len(self.drift))
        if self.mean_rows:
            of_mean = slice(len(matrix) - self.mean_rows, None)
            matrix[of_mean, of_mean] = np.eye(self.mean_rows, k=-1)
        return matrix


@with_named_arguments
def sensors(chains: Sequence[Chain], dt_s: float | None = None) -> list[Sensor]:
    """The state space of each chain, padded with idle states to one size.

    The equal size lets channels be stacked. Largest lag first, one stage a factor of the chain; the
    zero is in the output, the dead time is separate and exact.

    Parameters
    ----------
    chains
        Chains of the channels.
    dt_s
        Time from row to row [s], for means over several rows; None: a mean is over one row or less.

    Raises
    ------
    InputError
        A chain has a zero, but neither a lag nor a filter.

    Notes
    -----
    Idle states decay by themselves and reach no output. The order of the states is used in
    ``tcdyn.smoothing.state_space``; ``tests/smoothing/test_states.py`` guards both.
    """
    stages = max(sum(len(f) - 1 for f in chain.factors()) for chain in chains)
    rows = [max(round(chain.mean_s / dt_s), 1) if dt_s else 1 for chain in chains]
    mean_rows = [count if chain.mean_s else 0 for chain, count in zip(chains, rows)]
    size = 2 + stages + max(mean_rows)
    return [_sensor(chain, size, count) for chain, count in zip(chains, mean_rows)]


def _sensor(chain: Chain, size: int, mean_rows: int) -> Sensor:
    """The state space of one chain with ``size`` states.

    Parameters
    ----------
    chain
        The chain.
    size
        Number of states; those that the chain does not need are idle.
    mean_rows
        Number of rows over which a mean goes; zero: there is none.

    Raises
    ------
    InputError
        The chain has a zero, but neither a lag nor a filter.

    Notes
    -----
    A pair of poles is two states: w = 1/sqrt(f_2), with the coupling +w and -w. ``lag_row`` and
    ``split_row`` use the rates of change of x and of the first two lags.
    """
    drift = np.zeros((size, size))
    drift[0, 1] = 1.0
    source = 0
    index = 2
    for f in chain.factors():
        if len(f) == 2:
            block = np.array([[-1.0 / f[1]]])
        else:
            w = 1.0 / np.sqrt(f[2])
            block = np.array([[0.0, w], [-w, -f[1] * w * w]])
        k = len(block)
        drift[index : index + k, index : index + k] = block
        drift[index : index + k, source] = -block[:, 0]
        source = index
        index = index + k
    output = np.zeros(size)
    output[source] = 1.0
    if chain.zero_s:
        if source == 0:
            raise InputError(
                f"Chain: a zero of {chain.zero_s:g} s needs at least one lag "
                "or the conditioning filter"
            )
        output = output + chain.zero_s * drift[source]
    output = sum(
        a * output @ np.linalg.matrix_power(drift, k)
        for k, a in enumerate(chain.conditioning.numerator)
    )
    slope_row = np.eye(size)[1]
    lags_s = [tau for tau in sorted(chain.taus_s, reverse=True) if tau > 0]
    # rates of change of x and of the output of each lag
    rates = np.array([slope_row, *drift[2 : 2 + len(lags_s)]])
    lag_row = rates[min(len(lags_s), 1)]
    last = min(len(lags_s), 2)
    split_row = np.zeros(size)
    if last:
        split_row = (rates[last - 1] - rates[last]) / lags_s[last - 1]
    inner = size - mean_rows
    idle = range(index, inner)
    drift[idle, idle] = -1.0
    if mean_rows:
        drift[inner] = output / chain.mean_s
        output = np.zeros(size)
        output[inner:] = 1.0
    return Sensor(
        drift,
        output,
        lag_row,
        split_row,
        *_settled(drift, inner),
        chain.delay_s,
        chain.lag_s,
        chain.mean_s,
        mean_rows,
    )


def _settled(drift: Array, inner: int) -> tuple[Array, Array, Array]:
    """States of a chain that has always followed a level and a slope, and their scatter.

    Parameters
    ----------
    drift
        System matrix (n, n).
    inner
        Number of states without those of a mean.

    Returns
    -------
    ramp, scatter, level_scatter
        As in ``Sensor``.
    """
    size = len(drift)
    ramp = np.zeros((size, 2))
    scatter = np.zeros((size, size))
    level_scatter = np.zeros((size, size))
    ramp[0, 0] = 1.0
    ramp[1, 1] = 1.0
    if inner > 2:
        of_stages = slice(2, inner)
        stages = drift[of_stages, of_stages]
        level = -np.linalg.solve(stages, drift[of_stages, 0])
        v = np.linalg.solve(stages, level)
        ramp[of_stages, 0] = level
        ramp[of_stages, 1] = v
        scatter[of_stages, of_stages] = solve_continuous_lyapunov(stages, -np.outer(v, v))
        level_scatter[of_stages, of_stages] = solve_continuous_lyapunov(
            stages, -np.outer(level, level)
        )
    return ramp, scatter, level_scatter


def with_first_lag(sensor: Sensor, lag_s: float) -> Sensor:
    """The state space of a chain whose first, largest lag has another value.

    Parameters
    ----------
    sensor
        The state space, of a chain without a zero.
    lag_s
        The first lag [s].

    Notes
    -----
    The states remain temperatures in cascade, so that they stay valid while the lag changes.
    """
    drift = sensor.drift.copy()
    first_s = -1.0 / drift[2, 2]
    drift[2, 0] = 1.0 / lag_s
    drift[2, 2] = -1.0 / lag_s
    ramp, scatter, level_scatter = _settled(drift, len(drift) - sensor.mean_rows)
    return replace(
        sensor,
        drift=drift,
        ramp=ramp,
        scatter=scatter,
        level_scatter=level_scatter,
        lag_row=sensor.lag_row * first_s / lag_s,
        lag_s=sensor.lag_s + lag_s - first_s,
    )


def with_integral(sensor: Sensor) -> Sensor:
    """The state space with one state more: the integral of the junction temperature.

    It stands behind the stages, before the integrals of a mean, and reaches no output.
    """
    index = integral_index(sensor)

    def row(values: Array) -> Array:
        """A row with a zero for the new state."""
        return np.insert(values, index, 0.0, axis=-1)

    def square(values: Array) -> Array:
        """A square matrix with zeros for the new state."""
        return np.insert(row(values), index, 0.0, axis=0)

    drift = square(sensor.drift)
    drift[index, 0] = 1.0
    return replace(
        sensor,
        drift=drift,
        output=row(sensor.output),
        lag_row=row(sensor.lag_row),
        split_row=row(sensor.split_row),
        ramp=np.insert(sensor.ramp, index, 0.0, axis=0),
        scatter=square(sensor.scatter),
        level_scatter=square(sensor.level_scatter),
    )


def integral_index(sensor: Sensor) -> int:
    """Index of the state that ``with_integral`` adds to a state space."""
    return len(sensor.drift) - sensor.mean_rows
