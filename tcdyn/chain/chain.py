"""The measurement chain, junction to log file, as a transfer function in seconds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from calibration.disk import Conditioning
from calibration.errors import InputError
from calibration.result import Result

if TYPE_CHECKING:
    import control

    from tcdyn.chain.factors import Rational

Hold = Literal["foh", "zoh"]
NO_CONDITIONING = Conditioning(poles=0)


@dataclass(frozen=True)
class Chain(Result):
    """G(s) = exp(-delay s) (1 + zero s) / prod_i (1 + taus_i s) * B(s), with G(0) = 1.

    ``taus_s``, ``zero_s`` and ``delay_s`` are in seconds; ``conditioning`` is the known filter B. Two more factors
    are there when asked for: ``pair`` = (Tw [s], zeta) divides by 1 + 2 zeta Tw s + (Tw s)^2 (complex poles), and
    ``cement_s`` divides by cosh(sqrt(cement s)): heat diffusing through a layer of cement of diffusion time
    ``cement_s`` = thickness^2/diffusivity onto an insulated junction, a half-order lag with first moment cement/2.

    >>> Chain((0.6, 0.1), conditioning=Conditioning(4.0, 2)).lag_s.__round__(4)
    0.7796
    """

    taus_s: tuple[float, ...]
    zero_s: float = 0.0
    delay_s: float = 0.0
    conditioning: Conditioning = field(default_factory=Conditioning)
    pair: tuple[float, float] | None = None
    cement_s: float = 0.0

    def __post_init__(self) -> None:
        if any(tau < 0 for tau in self.taus_s) or self.delay_s < 0:
            raise InputError(f"Chain: lags and delay must not be negative; got {self.taus_s}, {self.delay_s}")
        if self.cement_s < 0 or (self.pair is not None and min(self.pair) <= 0):
            raise InputError(f"Chain: cement and pair must be positive; got {self.cement_s}, {self.pair}")

    @property
    def lag_s(self) -> float:
        """First moment of the impulse response [s]: delay + sum of lags - zero + the filter's own lag."""
        own = self.delay_s + sum(self.taus_s) - self.zero_s + self.cement_s / 2
        if self.pair is not None:
            own += 2 * self.pair[1] * self.pair[0]
        return own + self.conditioning.lag_s

    def summary(self) -> str:
        """Lags, zero, dead time and filter, and the first moment of it all."""
        said = ["lags " + ", ".join(f"{tau:.4g}" for tau in self.taus_s) + " s"] if self.taus_s else []
        said += [f"zero {self.zero_s:.4g} s"] if self.zero_s else []
        said += [f"complex pair Tw {self.pair[0]:.4g} s, zeta {self.pair[1]:.4g}"] if self.pair else []
        said += [f"cement {self.cement_s:.4g} s"] if self.cement_s else []
        said += [f"dead time {self.delay_s:.4g} s"] if self.delay_s else []
        if self.conditioning.poles:
            c = self.conditioning
            said.append(f"conditioning {c.cutoff_Hz:g} Hz x {c.poles} ({c.shape})")
        return f"{'; '.join(said) or 'no dynamics'}; lag in all (first moment) {self.lag_s:.4g} s"

    def to_dict(self) -> dict[str, Any]:
        """The parameters, and ``lag_s``."""
        return {**super().to_dict(), "lag_s": self.lag_s}

    def polynomials(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Numerator and denominator in descending powers of s, the dead time left out."""
        num: NDArray[Any]
        den: NDArray[Any]
        num, den = conditioning_polynomials(self.conditioning)
        if self.zero_s:
            num = np.polymul(num, [self.zero_s, 1.0])
        for tau in self.taus_s:
            if tau > 0:
                den = np.polymul(den, [tau, 1.0])
        if self.pair is not None:
            den = np.polymul(den, [self.pair[0] ** 2, 2 * self.pair[1] * self.pair[0], 1.0])
        for share in cement_lags() if self.cement_s else ():
            den = np.polymul(den, [self.cement_s * share, 1.0])
        return np.atleast_1d(num), np.atleast_1d(den)

    def transfer_function(self, pade_order: int = 3) -> control.TransferFunction:
        """The chain as a ``control.TransferFunction``; a dead time enters by its Pade form of ``pade_order``."""
        import control

        num: NDArray[Any]
        den: NDArray[Any]
        num, den = self.polynomials()
        if self.delay_s:
            pade_num, pade_den = control.pade(self.delay_s, pade_order)
            num, den = np.polymul(num, pade_num), np.polymul(den, pade_den)
        return control.TransferFunction(num, den)

    def frequency_response(self, frequency_Hz: ArrayLike) -> NDArray[np.complex128]:
        """G(2 pi i f), dead time exact; same shape as ``frequency_Hz``."""
        s = 2j * np.pi * np.asarray(frequency_Hz, dtype=float)
        num, den = replace(self, cement_s=0.0).polynomials()
        cement = 1 / np.cosh(np.sqrt(self.cement_s * s))
        return np.asarray(np.polyval(num, s) / np.polyval(den, s) * cement * np.exp(-self.delay_s * s))

    def response(
        self,
        u: ArrayLike,
        dt_s: float,
        hold: Hold = "foh",
        initial: Literal["equilibrium", "zero"] = "equilibrium",
    ) -> NDArray[np.float64]:
        """What the chain writes for an input sampled every ``dt_s`` seconds.

        ``u`` has shape (N,) or (N, M), one column a channel; the answer has the same shape. Between samples the
        input is a straight line (``foh``) or held (``zoh``); lags and dead time, whole samples or not, are exact
        under that hold. The record starts in equilibrium with its first sample, or from zero.
        """
        from tcdyn.chain.factors import realise
        from tcdyn.chain.simulate import simulate_rows

        u = np.asarray(u, dtype=float)
        system = realise(self.rational(), sensitivities=False)
        table = u.reshape(len(u), -1)
        answers = [simulate_rows(system, x, dt_s, self.delay_s, hold, initial)[0] for x in table.T]
        return np.stack(answers, axis=1).reshape(u.shape)

    def rational(self) -> Rational:
        """The chain as factors, the form that the identification's exact simulation takes."""
        from tcdyn.chain.factors import Factor, Rational

        _, den = conditioning_polynomials(self.conditioning)
        factors = [Factor.lag(tau) for tau in self.taus_s if tau > 0]
        if self.pair is not None:
            factors.append(Factor.polynomial(np.array([1.0, 2 * self.pair[1] * self.pair[0], self.pair[0] ** 2])))
        if self.cement_s:
            factors += [Factor.lag(self.cement_s * share) for share in cement_lags()]
        if self.conditioning.shape == "cascade":
            cutoff = 2 * np.pi * self.conditioning.cutoff_Hz
            factors += [Factor.lag(1 / cutoff)] * self.conditioning.poles
        elif len(den) > 1:
            factors.append(Factor.polynomial(den[::-1]))
        num = np.array([1.0, self.zero_s] if self.zero_s else [1.0])
        return Rational(num, tuple(factors), self.delay_s)

    def discrete(self, dt_s: float, hold: Hold = "foh") -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Numerator and denominator in powers of z^-1, exact under ``hold``, dead time left out."""
        num, den = self.polynomials()
        if len(den) == 1:
            return np.array([1.0]), np.array([1.0])
        return discretised(num, den, dt_s, hold)

    def with_lag_shift(self, shift_s: float) -> Chain:
        """The same chain with its largest lag longer by ``shift_s`` (never below zero)."""
        taus = sorted(self.taus_s, reverse=True) or [0.0]
        return replace(self, taus_s=(max(taus[0] + shift_s, 0.0), *taus[1:]))


def cement_lags() -> tuple[float, ...]:
    """Lags of 1/cosh(sqrt(s)) as shares of its diffusion time: 1/((k - 1/2)^2 pi^2), the rest in three equal lags.

    cosh(sqrt(s)) = prod_k (1 + s/((k - 1/2)^2 pi^2)) exactly; the shares sum to 1/2, the first moment. Four poles
    and the rest keep the step response within 2e-3 of the exact one.
    """
    shares = [1 / ((k - 0.5) ** 2 * np.pi**2) for k in range(1, 5)]
    return (*shares, *[(0.5 - sum(shares)) / 3] * 3)


def conditioning_polynomials(b: Conditioning) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Numerator and denominator of B(s), descending powers of s, unit static gain."""
    if b.poles == 0:
        return np.array([1.0]), np.array([1.0])
    wc = 2 * np.pi * b.cutoff_Hz
    if b.shape == "cascade":
        den = np.array([1.0])
        for _ in range(b.poles):
            den = np.polymul(den, [1 / wc, 1.0])
        return np.array([1.0]), den
    _, den = signal.butter(b.poles, wc, analog=True)
    return np.array([1.0]), np.asarray(den / den[-1])


def discretised(
    num: ArrayLike, den: ArrayLike, dt_s: float, hold: Hold = "foh"
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Digital form (b, a) in powers of z^-1 of num/den in descending powers of s, exact under ``hold``."""
    system = signal.cont2discrete(signal.tf2ss(num, den), dt_s, method=hold)[:4]
    b, a = signal.ss2tf(*system)
    return np.asarray(b[0]), np.asarray(a)


def delayed(u: NDArray[np.float64], samples: float, hold: Hold, start: ArrayLike) -> NDArray[np.float64]:
    """``u`` shifted by a continuous number of ``samples``, preceded by ``start``.

    Exact for a straight-line (FOH) input. For a held input (ZOH) the average over each sample of the shifted input
    is returned, which conserves its integral.
    """
    if samples == 0:
        return u
    whole = int(np.floor(samples))
    part = samples - whole
    padded = np.concatenate([np.broadcast_to(start, (whole + 1, *u.shape[1:])), u])
    n = len(u)
    return np.asarray((1 - part) * padded[1 : n + 1] + part * padded[:n])
