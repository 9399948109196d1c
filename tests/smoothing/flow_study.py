"""Coverage where the lag follows a flow, for sheaths whose law the smoother does not share.

`python -m tests.smoothing.flow_study [RECORDS] [SEED]` prints one line for each course of the flow,
and each way in which it was logged: coverage of the 95 % band (mean, its standard deviation between
the records, and the worst record), rms error, median standard uncertainty, rms error and coverage
with a constant lag, and the number of warnings that the law is contradicted. Then, for laws that
are wrong, rms error, coverage and number of warnings.

The sensor is a solid cylinder in cross flow, by finite volumes, read at its centre. The film
coefficient follows the law of Hilpert with an exponent of the record, and natural convection at
least; the lag at the reference flow, the exponent and the inner share are stated with errors drawn
from their uncertainties.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from scipy.linalg import eigvals, solve_banded

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.chain.law import FlowLaw
from tcdyn.core import Array
from tcdyn.smoothing import smooth

DT_S = 0.5
ROWS = 600
FINE = 10
NOISE_K = 0.05
SHELLS = 12
FLOW_AT = 2.0
FLOW_U_REL = 0.1
LEAST = 0.1
U_LAG_REL = 0.02
U_EXPONENT = 0.03
U_SHARE = 0.03
Course = Callable[[Array, np.random.Generator], Array]


def steps(t: Array, rng: np.random.Generator) -> Array:
    """Between 2 and 8, at random times."""
    changes = np.cumsum(rng.exponential(30.0, 40))
    return np.where(np.searchsorted(changes, t) % 2 == 0, 2.0, 8.0)


def turbulence(t: Array, rng: np.random.Generator) -> Array:
    """Lognormal, correlation time 5 s."""
    keep = np.exp(-(t[1] - t[0]) / 5.0)
    white = np.sqrt(1 - keep**2) * rng.standard_normal(len(t))
    z = np.empty(len(t))
    z[0] = rng.standard_normal()
    for k in range(1, len(t)):
        z[k] = keep * z[k - 1] + white[k]
    return 4.0 * np.exp(0.5 * z)


def down_to_zero(t: Array, rng: np.random.Generator) -> Array:
    """Between 6 and 0 within 50 s."""
    return 6.0 * np.cos(np.pi * t / 100 + rng.uniform(0, np.pi)) ** 2


def as_it_is(flow: Array, rng: np.random.Generator) -> Array:
    """The flow in the log is the true one."""
    return flow


def with_noise(flow: Array, rng: np.random.Generator) -> Array:
    """Each row has an own error of 10 %."""
    return np.asarray(flow * np.exp(0.1 * rng.standard_normal(len(flow))))


def held(flow: Array, rng: np.random.Generator) -> Array:
    """The flow is read every 5 s and held."""
    every = round(5.0 / DT_S)
    return np.asarray(np.repeat(flow[::every], every)[: len(flow)])


def off_by_a_share(flow: Array, rng: np.random.Generator) -> Array:
    """The flow has one error in all rows, of the stated ``FLOW_U_REL``."""
    return np.asarray(flow * np.exp(FLOW_U_REL * rng.standard_normal()))


def film_of(flow: Array, exponent: float) -> Array:
    """Film coefficient over that at ``FLOW_AT``; natural convection takes over sharply."""
    return np.maximum(flow, LEAST) ** exponent / FLOW_AT**exponent


def conductances(inner_s: float) -> tuple[Array, Array]:
    """Conductances between shells and to the surface (SHELLS,), and capacities (SHELLS,) [s].

    In units of a cylinder whose capacity is 1 and whose centre has the inner lag R^2 / 4a.
    """
    edges = np.linspace(0.0, 1.0, SHELLS + 1)
    capacity = np.diff(edges**2)
    # conductivity per length: 2 pi k = 1 / (2 inner lag) with a capacity of 1
    middles = 0.5 * (edges[1:] + edges[:-1])
    between = edges[1:-1] / np.diff(middles) / (2 * inner_s)
    return np.append(between, 1.0 / (1.0 - middles[-1]) / (2 * inner_s)), capacity


def reading_of(x: Array, film: Array, film_s: float, inner_s: float, step_s: float) -> Array:
    """Temperature of the centre, by implicit steps."""
    conductance, capacity = conductances(inner_s)
    temperature = np.full(SHELLS, x[0])
    out = np.empty(len(x))
    inside = np.append(conductance[:-1], 0.0)
    for k in range(len(x)):
        # film and the outer half of the last shell in series
        outer = 1.0 / (film_s / film[k] + 1.0 / conductance[-1])
        bands = np.zeros((3, SHELLS))
        bands[0, 1:] = -conductance[:-1]
        bands[2, :-1] = -conductance[:-1]
        bands[1] = capacity / step_s + inside + np.append(0.0, conductance[:-1])
        bands[1, -1] += outer
        right = capacity / step_s * temperature
        right[-1] += outer * x[k]
        temperature = solve_banded((1, 1), bands, right)
        out[k] = temperature[0]
    return out


def lags_of(film_s: float, inner_s: float) -> tuple[float, float]:
    """Largest time constant, and the rest of the first moment [s], at ``FLOW_AT``."""
    conductance, capacity = conductances(inner_s)
    matrix = np.zeros((SHELLS, SHELLS))
    for k, c in enumerate(conductance[:-1]):
        matrix[k, k] -= c
        matrix[k, k + 1] += c
        matrix[k + 1, k + 1] -= c
        matrix[k + 1, k] += c
    matrix[-1, -1] -= 1.0 / (film_s + 1.0 / conductance[-1])
    system = matrix / capacity[:, None]
    largest_s = float(-1.0 / np.real(eigvals(system)).max())
    settled = -np.linalg.solve(system, np.ones(SHELLS))
    return largest_s, float(settled[0]) - largest_s


LOGGED: dict[str, tuple[Course, Course]] = {
    "steps by four": (steps, as_it_is),
    "turbulence": (turbulence, as_it_is),
    "down to zero": (down_to_zero, as_it_is),
    "turbulence, noise of 10 %": (turbulence, with_noise),
    "turbulence, held 5 s": (turbulence, held),
    "steps, off by 10 %": (steps, off_by_a_share),
}
# How a law may be wrong: exponent that is added, and whether the column is that of another flow
WRONG: dict[str, tuple[float, bool]] = {
    "exponent 0.3 too small": (-0.3, False),
    "exponent 0.3 too large": (0.3, False),
    "column of another flow": (0.0, True),
}


def judge(name: str, index: int, seed: int, wrong: str = "") -> tuple[float, ...]:
    """Coverage, mean square error, median u, the first two with a constant lag, and warnings."""
    course, logged = LOGGED[name]
    added, is_other = WRONG.get(wrong, (0.0, False))
    rng = np.random.default_rng([seed, index])
    t = DT_S / FINE * np.arange(ROWS * FINE)
    flow = course(t, rng)
    exponent = rng.uniform(0.4, 0.65)
    film_s = rng.uniform(3.0, 12.0)
    inner_s = film_s * rng.uniform(0.05, 0.3)
    x = 60 + 10 * np.sin(2 * np.pi * t / rng.uniform(30, 60) + rng.uniform(0, 6))
    x += 4 * np.sin(2 * np.pi * t / rng.uniform(12, 25) + rng.uniform(0, 6))
    y = reading_of(x, film_of(flow, exponent), film_s, inner_s, DT_S / FINE)
    rows = y[::FINE] + NOISE_K * rng.standard_normal(ROWS)
    largest_s, rest_s = lags_of(film_s, inner_s)
    share = 1 - film_s / (largest_s + rest_s)
    scale = 1 + U_LAG_REL * rng.standard_normal()
    given_share = float(np.clip(share + U_SHARE * rng.standard_normal(), rest_s / film_s, 0.9))
    law = FlowLaw(
        FLOW_AT,
        float(np.clip(exponent + added + U_EXPONENT * rng.standard_normal(), 0.0, 1.0)),
        U_EXPONENT,
        given_share,
        U_SHARE,
        least=LEAST,
    )
    chain = Chain((scale * largest_s, scale * rest_s), conditioning=NO_CONDITIONING)
    lag_var = [[(U_LAG_REL * chain.lag_s) ** 2]]
    column = logged(course(t, rng)[::FINE] if is_other else flow[::FINE], rng)
    flow_u = FLOW_U_REL * column if logged is off_by_a_share else 0.0
    result = smooth(rows, DT_S, chain, lag_covariance=lag_var, laws=law, flow=column, flow_u=flow_u)
    constant = smooth(rows, DT_S, chain, lag_covariance=lag_var)
    truth = x[::FINE]
    error = result.temperature[:, 0] - truth
    of_constant = constant.temperature[:, 0] - truth
    return (
        float(np.mean(np.abs(error) < 1.96 * result.sd[:, 0])),
        float(np.mean(error**2)),
        float(np.median(result.sd)),
        float(np.mean(of_constant**2)),
        float(np.mean(np.abs(of_constant) < 1.96 * constant.sd[:, 0])),
        float(any(f.code == "trace.law" for f in result.findings)),
    )


def report(records: int, seed: int) -> None:
    """Print the tables."""
    print(
        "flow                        cover %   +-  worst   rms K  median u   "
        "constant: rms K  cover %  law contradicted"
    )
    for name in LOGGED:
        cover, square, u, of_constant, held_by_constant, contradicted = _judged(name, records, seed)
        print(
            f"{name:27s} {100 * cover.mean():7.1f} {100 * cover.std():4.1f} "
            f"{100 * cover.min():6.1f} {np.sqrt(square.mean()):7.3f} {np.median(u):9.3f} "
            f"{np.sqrt(of_constant.mean()):17.3f} {100 * held_by_constant.mean():8.1f} "
            f"{contradicted.sum():10.0f}",
            flush=True,
        )
    for wrong in WRONG:
        for name in list(LOGGED)[:3]:
            cover, square, *_, contradicted = _judged(name, records, seed, wrong)
            print(
                f"{wrong}, {name}: rms {np.sqrt(square.mean()):.2f} K, covered "
                f"{100 * cover.mean():.0f} %, contradicted {contradicted.sum():.0f} of {records}; "
                f"covered where not {100 * np.mean(cover[contradicted == 0]):.0f} %",
                flush=True,
            )


def _judged(name: str, records: int, seed: int, wrong: str = "") -> Array:
    """What ``judge`` gives for each record, one row a number."""
    with ProcessPoolExecutor(2) as pool:
        count = range(records)
        found = list(pool.map(judge, [name] * records, count, [seed] * records, [wrong] * records))
    return np.array(found).T


if __name__ == "__main__":
    numbers = [int(a) for a in sys.argv[1:]]
    report(*[*numbers, *(40, 95001)[len(numbers) :]])
