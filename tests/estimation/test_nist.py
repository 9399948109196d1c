"""Least-squares core against certified values of NIST (Statistical Reference Datasets, nonlinear
regression)."""

import os
import re
from pathlib import Path

import numpy as np
import pytest

from tcdyn.estimation import Problem, minimise

DATA = (
    Path(os.environ.get("TCDYN_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
    / "strd"
)


def cubic_ratio(b, x):
    return (b[0] + x * (b[1] + x * (b[2] + x * b[3]))) / (1 + x * (b[4] + x * (b[5] + x * b[6])))


def two_gaussians(b, x):
    peaks = (b[k] * np.exp(-(((x - b[k + 1]) / b[k + 2]) ** 2)) for k in (2, 5))
    return b[0] * np.exp(-b[1] * x) + sum(peaks)


MODELS = {
    "Hahn1": cubic_ratio,
    "Thurber": cubic_ratio,
    "Gauss1": two_gaussians,
    "MGH09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
}


def read_dataset(name):
    """x, y, two start vectors, certified parameters and their standard deviations."""
    path = DATA / f"{name}.dat"
    if not path.exists():
        pytest.skip(f"{path} is absent (set TCDYN_DATA)")
    text = path.read_text()
    table = np.array(
        re.findall(r"^\s*b\d+\s*=\s*(\S+)\s+(\S+)\s+(\S+)\s+(\S+)\s*$", text, re.M), dtype=float
    )
    y, x = np.array(
        [
            line.split()
            for line in text.split("Data:")[-1].split("\n", 1)[1].split("\n")
            if line.strip()
        ]
    ).T
    return x.astype(float), y.astype(float), table[:, :2].T, table[:, 2], table[:, 3]


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize(("start", "digits"), [(1, 4), (2, 6)])
def test_nonlinear_fits_reach_the_certified_digits_of_nist(name, start, digits):
    x, y, starts, certified, deviations = read_dataset(name)
    model = MODELS[name]

    def evaluate(b):
        steps = b + 1e-30j * np.eye(len(b))  # derivatives by complex step are exact
        return model(b, x) - y, np.column_stack([np.imag(model(s, x)) / 1e-30 for s in steps])

    names = tuple(f"b{k + 1}" for k in range(len(certified)))
    with np.errstate(all="ignore"):
        optimum = minimise(
            Problem(names, evaluate), starts[start - 1], limit=800, tolerance=0.0, relative=1e-15
        )
    assert optimum.converged
    assert optimum.theta == pytest.approx(certified, rel=10.0**-digits)
    variance = optimum.cost / (len(x) - len(certified))
    assert np.sqrt(variance * np.diag(optimum.covariance)) == pytest.approx(
        deviations, rel=10.0 ** -min(digits, 5)
    )
