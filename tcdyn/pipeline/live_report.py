"""What the live smoother will do to a trace, said before it is applied, in the terms of the proper inverse's report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tcdyn.chain import Chain
from tcdyn.compensate.before_use import BeforeUse, first_below, rise
from tcdyn.compensate.live import LiveSmoother

Array = NDArray[np.float64]
MOST_GAIN = 10.0  # noise out over noise in, beyond which the answer is of little use


def live_before_use(engine: LiveSmoother, chains: Sequence[Chain]) -> BeforeUse:
    """The report on the channel whose answer is noisiest.

    At rest the smoother is a linear filter; its impulse response h is had by giving it one sample of one standard
    deviation, too little to be taken for an event: noise gain sqrt(sum h^2), bandwidth of |H G|, step of h * chain.
    """
    dt, span = engine.dt_s, max(s.lag_s for s in engine.sensors)
    rows = int(min(8 * span / dt + 4 * engine.lag_samples + 200, 4000))
    y = np.zeros((2 * rows, len(chains)))
    y[rows] = engine.noise_sd
    _, x, _, _ = engine.run(engine.start(np.zeros(len(chains))), y)
    pulses = x[rows:] / engine.noise_sd
    gains = np.sqrt(np.sum(pulses**2, axis=0))
    worst = int(np.argmax(gains * engine.noise_sd))
    h, chain, gain, sd = pulses[:, worst], chains[worst], float(gains[worst]), float(engine.noise_sd[worst])
    u = np.r_[0.0, np.ones(rows - 1)]
    raw = np.asarray(chain.response(u, dt, hold="zoh"), dtype=np.float64)
    step = np.asarray(np.convolve(raw, h)[:rows], dtype=np.float64)
    t = np.asarray((np.arange(rows) - 1.0) * dt, dtype=np.float64)
    freq = np.geomspace(1e-3 / span, 0.499 / dt, 1500)
    own = np.abs(np.exp(-2j * np.pi * freq[:, None] * dt * np.arange(rows)) @ h)
    through = np.abs(chain.frequency_response(freq))
    shift = chain.delay_s + engine.lag_samples * dt
    ramp = float(np.sum(np.arange(rows) * h) * dt + chain.lag_s)
    said = []
    if gain > MOST_GAIN:
        said.append(
            f"the answer has {gain:.3g} times the trace's noise: a lower intensity or some lag behind makes it quieter"
        )
    if chain.delay_s > 0 or chain.zero_s < 0:
        said.append("dead time and right-half-plane zeros cannot be inverted: they remain as a shift")
    return BeforeUse(
        gain, gain * sd, first_below(freq, own * through), first_below(freq, through), rise(t, step), rise(t, raw),
        float(max(step.max() - 1.0, 0.0)), shift, ramp, t, step, raw, tuple(said),
    )  # fmt: skip
