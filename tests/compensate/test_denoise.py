"""Noise removal as in the thesis; the curve fits against NIST's certified values."""

import os
import re
from pathlib import Path

import numpy as np
import pytest

from calibration.errors import InputError
from tcdyn.compensate.denoise import gaussians, rational, remove_noise
from tcdyn.compensate.separable import Curve, fit_curve

DATA = Path(os.environ.get("TCDYN_DATA", Path(__file__).parents[2].parent / "shared" / "data")) / "strd"


def read(name):
    """x, y, the two starts and the certified parameters and residual sum of squares."""
    path = DATA / f"{name}.dat"
    if not path.exists():
        pytest.skip(f"{path} is absent (set TCDYN_DATA)")
    text = path.read_text()
    rows = re.findall(r"^\s*b\d+\s*=\s*(\S+)\s+(\S+)\s+(\S+)\s+(\S+)\s*$", text, re.M)
    starts_and_certified = np.array(rows, dtype=float)
    rss = float(re.search(r"Residual Sum of Squares:\s*(\S+)", text).group(1))
    body = text.split("Data:")[-1].split("\n", 1)[1]
    y, x = np.array([line.split() for line in body.strip().splitlines()], dtype=float).T
    return x, y, starts_and_certified[:, :2].T, starts_and_certified[:, 2], rss


def osborne_like():
    """MGH09: b1 (x2 + b2 x) / (x2 + b3 x + b4), amplitudes b1 and b1 b2."""

    def basis(x, shape):
        bottom = x**2 + shape[0] * x + shape[1]
        return np.stack([x**2 / bottom, x / bottom], axis=1)

    return Curve(basis, "MGH09")


def digits(found, certified):
    return float(np.min(-np.log10(np.maximum(np.abs(found / certified - 1), 1e-16))))


CASES = {
    "Hahn1": (rational(3, 3), slice(4, 7), lambda f: np.r_[f.amplitude, f.shape]),
    "Thurber": (rational(3, 3), slice(4, 7), lambda f: np.r_[f.amplitude, f.shape]),
    "Gauss1": (
        gaussians(2, decay=True),
        [1, 3, 4, 6, 7],
        lambda f: np.r_[
            f.amplitude[0], f.shape[0], f.amplitude[1], f.shape[1], abs(f.shape[2]), f.amplitude[2], f.shape[3],
            abs(f.shape[4]),
        ],
    ),
    "MGH09": (osborne_like(), [2, 3], lambda f: np.r_[f.amplitude[0], f.amplitude[1] / f.amplitude[0], f.shape]),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize(("start", "wanted"), [(1, 4), (2, 6)])
def test_nonlinear_fits_reach_nist_certified_digits(name, start, wanted):
    curve, shape, parameters = CASES[name]
    x, y, starts, certified, rss = read(name)
    fit = fit_curve(curve, x, y, starts[start - 1][shape])
    assert digits(parameters(fit), certified) >= wanted
    assert digits(fit.rss, rss) >= wanted


def test_each_segment_takes_a_curve_and_the_corner_at_the_event_stays_sharp():
    """Heating then sudden cooling: split at the event, the fit is within a few times noise / sqrt(N / parameters)."""
    t = np.arange(0, 400, 0.1)
    x = np.where(t < 200, 100 - 60 * np.exp(-t / 40), 40 + 59.6 * np.exp(-np.maximum(t - 200, 0) / 25))
    y = x + 0.3 * np.random.default_rng(0).standard_normal(len(t))
    split = remove_noise(t, y, events_s=(200.0,), methods=("rational", "spline"), folds=2)
    joined = remove_noise(t, y, methods=("rational",), folds=2)
    assert np.sqrt(np.mean((split.temperature - x) ** 2)) < 0.05  # 0.3 sqrt(11 / 2000) = 0.02
    assert np.sqrt(np.mean((joined.temperature - x) ** 2)) > 0.2
    assert all(0.27 < s < 0.45 for s in split.cv_rms)  # noise 0.3, and what leaving out the first block costs


def test_unknown_method_is_refused():
    with pytest.raises(InputError, match="no method"):
        remove_noise(np.arange(100.0), np.arange(100.0), methods=("magic",))


def test_the_spline_follows_a_quick_rise_at_the_start_of_a_long_stretch() -> None:
    """Loading: 60 K with 20 s, then 1000 s of steady running; what is left is the noise and little else."""
    t = np.arange(0, 1000, 1 / 20)
    true = 60 + 60 * (1 - np.exp(-t / 20))
    found = remove_noise(t, true + np.random.default_rng(2).normal(0, 0.15, len(t)), methods=("spline",))
    # blocks of 10 s are predicted; the first, 1 % of all, by a straight line that misses the bend by up to
    # 60 K (10 s / 20 s)^2 / 2 = 7.5 K, 3.4 K rms: with the noise 0.37 K in all
    assert found.cv_rms[0] < 0.5
    assert np.sqrt(np.mean((found.temperature - true)[t > 1] ** 2)) < 0.15 / 2  # the first second is averaged over
