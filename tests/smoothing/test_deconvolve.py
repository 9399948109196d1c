"""Regularised deconvolution: three criteria, zero phase, and pictures drawn from data."""

import matplotlib
import numpy as np
import pytest

from tcdyn.chain import NO_CONDITIONING, Chain
from tcdyn.plots.compensate import draw_compensated, draw_filter_report
from tcdyn.smoothing import deconvolve, proper_inverse, report_inverse, smooth

matplotlib.use("Agg")
DT = 0.05
CHAIN = Chain((1.0,), conditioning=NO_CONDITIONING)


def record(channels=3):
    """A slow wave of 10 degC: nothing a second-difference penalty cannot represent."""
    t = np.arange(8000) * DT / 20
    x = 80 + 10 * np.sin(2 * np.pi * 0.1 * t)
    y = CHAIN.response(x, DT / 20)[::20, None] + 0.2 * np.random.default_rng(0).standard_normal(
        (400, channels)
    )
    return x[::20], y


@pytest.mark.parametrize("criterion", ["gcv", "discrepancy", "l-curve"])
def test_each_criterion_recovers_a_wave_without_phase(criterion):
    """The lag alone makes 5.3 degC rms; noise 0.2 with about 30 free parameters leaves 0.1 to
    0.2."""
    x, y = record()
    ours, tradeoff = deconvolve(y, DT, CHAIN, criterion=criterion)
    error = ours.temperature - x[:, None]
    assert np.sqrt(np.mean(error[20:-20] ** 2)) < 0.5
    late = (
        np.sum(error[40:-40] * np.gradient(x, DT)[40:-40, None])
        / np.sum(np.gradient(x, DT)[40:-40] ** 2)
        / 3
    )
    assert abs(late) < 0.02  # s, of a lag of 1 s
    assert np.all(np.diff(tradeoff.misfit, axis=0) < 1e-6)
    assert np.all(np.diff(tradeoff.effective_parameters, axis=0) > -1e-6)
    if criterion != "l-curve":  # the L-curve's corner is known to smooth too much
        assert 0.9 < np.mean(np.abs(error) < 1.96 * ours.sd) <= 1.0


def test_cross_validation_finds_its_least_between_the_trials():
    """Twenty trials a factor of 3.5 apart find what a hundred find, within a fraction of their
    distance."""
    _, y = record()
    many = deconvolve(y, DT, CHAIN, criterion="gcv", trials=101)[1]
    score = np.log(many.misfit / (1 - many.effective_parameters / len(y)) ** 2)
    least = many.intensity[np.argmin(score, axis=0), np.arange(y.shape[1])]
    few = deconvolve(y, DT, CHAIN, criterion="gcv", trials=21)[1]
    spacing = np.log(few.intensity[1, 0] / few.intensity[0, 0])
    off = np.abs(np.log(few.chosen / least)) / spacing
    nearest = np.abs(np.log(few.intensity / least)).min(axis=0) / spacing
    assert off.mean() < 0.15
    assert nearest.mean() > 0.25  # no trial stood there


def test_pictures_are_drawn_from_results():
    from matplotlib.figure import Figure

    _, y = record(1)
    axes = Figure().subplots(2)
    assert (
        draw_compensated(smooth(y, DT, CHAIN), y, axes[0], window_s=(2.0, 10.0)).get_xlabel()
        == "time [s]"
    )
    assert draw_filter_report(
        report_inverse(proper_inverse(CHAIN, DT, 1.0), 0.2), axes[1]
    ).get_xlabel()
