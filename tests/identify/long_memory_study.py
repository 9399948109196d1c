"""Fits of short records of long memory, to find one that stops with a numerical error.

``python -m tests.identify.long_memory_study 0 300`` fits 300 records from seed 0 and prints those
that raise an error other than ``InputError``; numerical warnings count as errors.
"""

from __future__ import annotations

import sys
import traceback
import warnings

import numpy as np
from scipy.signal import lfilter

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.identification import IOData, fit

INPUTS = ("white", "steps", "one step", "multisine", "walk")
PLANTS = ("lag", "slow", "resonances", "integrator", "double integrator", "none", "feedthrough")
NOISES = (
    "none",
    "white",
    "walk",
    "double walk",
    "near one",
    "resonance",
    "1/f",
    "rounded",
    "stuck",
)
MODELS = ("P1", "P1D", "P2DZ", "P2DU", "P2UZ", "P3D", "P1DI", "P2DH", "P3DZU", "TF(2,3)")
SETTINGS = (
    {},
    {"noise": "slow"},
    {"noise": "slow", "baseline": "trend"},
    {"noise": "arma"},
    {"noise": "ar", "loss": "huber"},
    {"baseline": "walk"},
)


def resonance(x: Array, rng: np.random.Generator) -> Array:
    """Acceleration behind a lightly damped resonance."""
    frequency = rng.uniform(0.05, 2.8)
    radius = np.exp(-(10 ** rng.uniform(-4, -0.5)) * frequency)
    poles = [1.0, -2 * radius * np.cos(frequency), radius**2]
    return np.asarray(lfilter([1.0, -2.0, 1.0], poles, x))


def input_signal(kind: str, n: int, rng: np.random.Generator) -> Array:
    """An input of n samples."""
    t = np.arange(n)
    if kind == "steps":
        return np.repeat(rng.choice([-1.0, 1.0], n), 10)[:n]
    if kind == "one step":
        return (t > n // 4).astype(float)
    if kind == "multisine":
        top = n // 4
        waves = [np.cos(2 * np.pi * k * t / n - np.pi * k * k / top) for k in range(1, top)]
        return np.sum(waves, axis=0)
    white = rng.normal(size=n)
    return np.cumsum(white) if kind == "walk" else white


def plant(kind: str, u: Array, rng: np.random.Generator) -> Array:
    """The output without noise."""
    n = len(u)
    if kind == "none":
        return np.zeros(n)
    if kind == "resonances":
        return resonance(u, rng) - resonance(u, rng)
    if kind == "integrator":
        return np.cumsum(u)
    if kind == "double integrator":
        return np.cumsum(np.cumsum(u))
    keep = np.exp(-1 / (50 * n)) if kind == "slow" else 0.8
    y = np.asarray(lfilter([0.0, 1 - keep], [1.0, -keep], u))
    return u - y if kind == "feedthrough" else y


def with_noise(kind: str, y: Array, rng: np.random.Generator) -> Array:
    """The output with noise."""
    n = len(y)
    scale = (np.std(y) or 1.0) * 10 ** rng.uniform(-4, 0.5)
    white = rng.normal(size=n)
    if kind == "none":
        return y
    if kind == "rounded":
        return np.round(y / scale) * scale
    if kind == "stuck":
        return np.where(np.arange(n) > n // 3, y[n // 3], y)
    if kind == "1/f":
        spectrum = np.fft.rfft(white)
        spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))
        return y + scale * np.fft.irfft(spectrum, n)
    if kind == "resonance":
        return y + scale * resonance(white, rng)
    poles = {
        "white": [1.0],
        "walk": [1.0, -1.0],
        "double walk": [1.0, -2.0, 1.0],
        "near one": np.poly([0.99999, 0.999]),
    }[kind]
    return y + scale * lfilter([1.0], poles, white)


def main(first: int, count: int) -> None:
    """Fit the records and print the errors."""
    n_errors = 0
    for seed in range(first, first + count):
        rng = np.random.default_rng(seed)
        kinds = [str(rng.choice(names)) for names in (INPUTS, PLANTS, NOISES)]
        n = int(rng.choice([40, 60, 100]))
        u = input_signal(kinds[0], n, rng)
        y = with_noise(kinds[2], plant(kinds[1], u, rng), rng)
        y *= 10.0 ** rng.choice([0, 0, 0, -9, 9])
        model = str(rng.choice(MODELS))
        settings = dict(SETTINGS[int(rng.integers(len(SETTINGS)))])
        if rng.random() < 0.5:
            settings["input_noise"] = float(np.std(u) * 10 ** rng.uniform(-3, -0.3))
        try:
            data = IOData.from_arrays(u, y, 1.0, hold=str(rng.choice(["zoh", "foh"])))
            fit(data, model, check=False, **settings).summary()
        except InputError:
            continue
        except Exception:
            n_errors += 1
            print(seed, kinds, n, model, settings)
            traceback.print_exc(limit=-2)
    print(f"{n_errors} of {count} records")


if __name__ == "__main__":
    warnings.simplefilter("error")
    main(int(sys.argv[1]), int(sys.argv[2]))
