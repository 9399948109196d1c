"""A smoother for live displays: temperature a fixed small lag behind the present, or at it, with its band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from tcdyn.chain import Chain, Sensor, sensors
from tcdyn.core.errors import InputError
from tcdyn.core.findings import warning
from tcdyn.smoothing.inverse import BeforeUse, InverseFilter, filter_report
from tcdyn.smoothing.live_model import Block, LiveState, noise_paths, scattered, with_noise
from tcdyn.smoothing.record import MISSING, SPIKE
from tcdyn.smoothing.state_space import prior

Array = NDArray[np.float64]
QUIET, RESTLESS, JUMPED, BURST = range(4)  # what may be going on at a sample
# between two jumps of slope, of temperature, two bursts, on average
KINKS_S = 60.0
JUMPS_S = 3600.0
BURSTS_S = 20.0
# how long they last, on the average
BURST_FOR_S = 0.12
LONGEST_BURST_S = 0.4
RESTLESS_LAGS = 8.0
# sd of an offset in noises; it fades, and walks by its share
BURST_NOISES = 12.0
BURST_LEAK_S = 0.3
BURST_WALK = 0.2
# sd of a jump of slope: noises, or quiet wanders of the slope, in a lag
SLOPE_NOISES = 200.0
SLOPE_QUIETS = 2.0
LEVEL_JUMP = (
    0.1,
    1.0,
)  # sd of a jump of the temperature, restless and jumped: share of what that slope makes in a lag
SETTLING = 0.2, 0.04  # how far slope and temperature wander in a lag after a jump: share of it
PARTED_LAGS = (
    0.08  # for which hypotheses are followed apart: the filter hides for as long what has begun
)
IMPOSSIBLE = 6.0  # standard deviations of the prediction in a burst: no reading at all
MOST_OPENED = (
    5.0  # doublings of the jumps of slope and temperature, once a burst lasts too long to be one
)
# an answer behind may smooth away this share of its bends over so many lags
BEND_LAGS = 0.25
BEND_SHARE = 0.5
# where a burst is likely so, the others are doubted by no more: weights
BURST_LIKELY = 0.05
LEAST_DOUBT = 0.04
SHOWN = 0.2  # share of a step of the junction that stands in the readings after the time over which their range counts
TINY = 1e-3  # noises
LONGEST_BLOCK = 8  # samples taken at once: more cost more than they spare
MOST_GAIN = (
    10.0  # noise out over noise in, beyond which the answer of a live smoother is of little use
)


@dataclass(frozen=True)
class LiveSmoother:
    """Four Kalman filters a channel, averaged by what the readings say of them, and the last temperatures kept up.

    Quiet: the slope wanders with the intensity given. Restless: it has jumped, and settles. Jumped: the
    temperature itself has. Burst: a slip ring adds an
    offset before the conditioning filter, or a lone sample is out; once it is over, only what the filter still holds of
    it is left. They follow one another as a Markov chain; every few samples their states are merged by weight
    (interacting multiple models, Blom and Bar-Shalom 1988; merged at each, a small burst would be forgotten before the
    filter has shown it), so the band holds while nobody can know yet what has happened. Noise from before the filter
    has states of its own. A missing sample is skipped, and so is one that no hypothesis explains. The answer at sample
    k is for time k dt - delay - lag_samples dt. It stays in the range of the last readings, widened by what the chain
    may not have shown yet; where that binds, the sd covers what was cut off.
    """

    sensors: tuple[Sensor, ...]
    dt_s: float
    noise_sd: Array  # of a sample: behind the filter, and from before it as it comes out (M,)
    intensity: Array
    lag_samples: int
    bend: int  # samples between the answers that tell of bends
    after_var: Array  # (M,)
    steps: Array  # how the states move in one sample (M, 1, n, n)
    rows: Array  # how they are read (M, 1, n)
    scatter: Array  # what one sample adds to their covariance under each hypothesis (M, 4, n, n)
    begun: Array  # what is added where a hypothesis begins: jump of slope and temperature, offset (M, 4, n)
    before: Array  # stationary covariance of what the filter holds of the noise (M, n, n)
    switch: Array  # probability of going from one hypothesis to another in ``every`` samples (4, 4)
    every: int
    blocks: tuple[Block, ...]  # of one sample, of two, and so on
    shown: Array  # of a step of the junction, in ``window`` samples (M,)
    window: int

    @classmethod
    def of(
        cls,
        chains: Sequence[Chain],
        dt_s: float,
        noise_sd: ArrayLike,
        intensity: ArrayLike,
        lag_samples: int = 0,
        before_sd: ArrayLike = 0.0,
    ) -> LiveSmoother:
        """For ``chains``, noise [K] and quiet slope intensity [K2/s3]: (M,) or one number for all.

        ``noise_sd``: of what is white; ``before_sd``: of what each chain's filter has coloured, as it comes out of it.
        """
        after, level, before = (
            np.broadcast_to(np.asarray(v, dtype=float), (len(chains),)).copy()
            for v in (noise_sd, intensity, before_sd)
        )
        if lag_samples < 0 or np.any(after <= 0) or np.any(level <= 0) or np.any(before < 0):
            raise InputError(
                "live smoother: lag_samples must not be negative, noise and intensity must be positive"
            )
        each = tuple(sensors(chains))
        noise = np.hypot(after, before)
        lags = np.array([s.lag_s for s in each]) + dt_s
        jump = np.maximum(SLOPE_NOISES * noise / lags, SLOPE_QUIETS * np.sqrt(level * lags))
        models = [with_noise(s, b, BURST_LEAK_S, dt_s) for s, b in zip(each, noise_paths(chains))]
        steps, rows, held = (np.stack(part) for part in zip(*models))
        held *= before[:, None, None] ** 2
        scatter = np.repeat(
            (held - steps @ held @ steps.transpose(0, 2, 1))[:, None], BURST + 1, axis=1
        )
        scatter[:, :, 1, 1] += (level * dt_s)[:, None]
        first = len(each[0].output)
        begun = np.zeros(scatter.shape[:3])
        begun[:, BURST, first] = (BURST_NOISES * noise) ** 2
        for moved, share, settling in zip((RESTLESS, JUMPED), LEVEL_JUMP, SETTLING):
            begun[:, moved, 0] = (share * jump * lags) ** 2
            begun[:, moved, 1] = jump**2
            scatter[:, moved, [0, 1], [0, 1]] += (
                settling**2 * begun[:, moved, :2] * (dt_s / lags)[:, None]
            )
        scatter[:, BURST, first, first] += BURST_WALK**2 * begun[:, BURST, first]
        begins = np.minimum(dt_s / np.array([np.inf, KINKS_S, JUMPS_S, BURSTS_S]), 0.2)
        calm, over = (min(dt_s / t, 0.7) for t in (RESTLESS_LAGS * lags.mean(), BURST_FOR_S))
        switch = np.tile(begins, (BURST + 1, 1))
        switch[[RESTLESS, JUMPED], QUIET], switch[BURST] = calm, over * np.append(1.0, begins[1:])
        np.fill_diagonal(switch, 0.0)
        np.fill_diagonal(switch, 1 - switch.sum(axis=1))
        every = max(round(PARTED_LAGS * lags.mean() / dt_s), 1)
        steps = steps[:, None]
        rows = rows[:, None]
        bend = min(round(BEND_LAGS * lags.mean() / dt_s), lag_samples // 2)
        asked = lag_samples - bend * np.arange(3)
        blocks = tuple(
            Block.of(q, asked, steps, rows, scatter)
            for q in range(1, min(every, LONGEST_BLOCK) + 1)
        )
        unit = np.append(0.0, np.ones(int(2 * lags.max() / dt_s) + 8))
        step = np.stack([c.response(unit, dt_s, "zoh") for c in chains])
        window = int(np.max(np.argmax(step >= SHOWN, axis=1)))
        return cls(
            each,
            dt_s,
            noise,
            level,
            lag_samples,
            bend,
            after**2,
            steps,
            rows,
            scatter,
            begun,
            held,
            np.linalg.matrix_power(switch, every),
            every,
            blocks,
            step[:, window],
            window,
        )

    def start(self, first: ArrayLike) -> LiveState:
        """State that knows only the first sample ``first (M,)`` [degC], the chain's past taken as a ramp."""
        first = np.asarray(first, dtype=float)
        if first.shape != (len(self.sensors),) or not np.all(np.isfinite(first)):
            raise InputError(
                f"live smoother: the first sample must have {len(self.sensors)} finite temperatures; got {first}",
                remedy="start at the first complete row",
            )
        m = len(first)
        n = self.rows.shape[-1]
        lag = self.lag_samples
        mean, cov, var = (np.zeros((m, BURST + 1, *k)) for k in ((n + lag,), (n + lag, n), (lag,)))
        cov[:, :, :n] = self.before[:, None]
        for i, (s, y, sd, q) in enumerate(zip(self.sensors, first, self.noise_sd, self.intensity)):
            own = len(s.output)
            mean[i, :, :own], here, _ = prior(s, y, 10 * sd, self.dt_s, np.array([q]))
            mean[i, :, n:], var[i], cov[i, :, :own, :own] = y, here[0, 0, 0], here[0]
        weight = np.tile(np.eye(BURST + 1)[QUIET], (m, 1))
        recent = np.tile(first, (self.window + lag + 1, 1))
        return LiveState(
            mean, cov, var, weight, recent, np.zeros(m), np.tile(first, (2 * self.bend, 1))
        )

    def run(
        self, state: LiveState, chunk: ArrayLike
    ) -> tuple[LiveState, Array, Array, NDArray[np.uint8]]:
        """Temperature [degC] and sd [K] (N, M), lagged, and the flags of the samples of ``chunk (N, M)`` [degC]."""
        y = np.asarray(chunk, dtype=float)
        n = self.rows.shape[-1]
        m = len(self.sensors)
        known = np.concatenate(
            [state.cov, state.mean[..., None], np.zeros((*state.mean.shape, 1))], axis=-1
        )
        known[..., n:, -1] = state.var
        weight = state.weight
        held = state.held
        found = [np.empty((6, m, BURST + 1, 0))]
        k = 0
        longest = LONGEST_BURST_S / self.dt_s
        while k < len(y):
            left = self.every - (state.done + k) % self.every
            if left == self.every:
                known, weight = self._merged(known, weight)
            q = min(left, len(self.blocks), len(y) - k) if held.max() + left <= longest else 1
            known, told = self._block(known, weight, held, y[k : k + q])
            weight = told[0, ..., -1]
            for out, missing in zip(
                (told[5, :, 0] + (told[0, :, BURST] > 0.5)).T, ~np.isfinite(y[k : k + q])
            ):
                held = np.where(missing, held, np.where(out > 0, held + 1, 0.0))
            found.append(told)
            k += q
        told = np.moveaxis(np.concatenate(found, axis=-1), -1, 1)
        absent = ~np.isfinite(y)
        spike = ~absent & ((told[5, ..., 0] > 0) | (told[0, ..., BURST] > 0.5))
        good = np.maximum.accumulate(
            np.where(absent | spike, 0, np.arange(1, len(y) + 1)[:, None]), axis=0
        )
        recent = np.concatenate(
            [state.recent, np.concatenate([state.recent[-1:], y])[good, range(m)]]
        )
        x, sd, past = self._answers(told[0], told[1:4], told[4], state.past, recent)
        kept = (
            known[..., n],
            known[..., :n],
            known[..., n:, -1],
            weight,
            recent[len(y) :],
            held,
            past,
        )
        flags = np.where(absent, MISSING, np.where(spike, SPIKE, 0)).astype(np.uint8)
        return LiveState(*kept, state.done + len(y)), x, sd, flags

    def _block(self, known: Array, weight: Array, held: Array, y: Array) -> tuple[Array, Array]:
        """What is known after the samples ``y (q, M)`` of a block, and (6, M, 4, q) what is told at each of them.

        ``known`` (M, 4, n + L, n + 2): covariance of states and last temperatures with the states, their mean and their
        variance. Told under each hypothesis: its weight, the answer and two after it, the answer's variance, whether no
        hypothesis explains the sample. All that is not yet known (see ``Block``; then the last temperatures) has one
        joint covariance; the Cholesky factor of the readings' part tells what each adds to those before it.
        """
        q = len(y)
        n = self.rows.shape[-1]
        block = self.blocks[q - 1]
        near = block.effects[0] @ (known[..., :n, :] @ block.back) + self._noise(block, held)
        near[..., -1 - q] = near[..., block.row, block.column]
        joint = np.concatenate([near[..., :-q], known[..., n:, :] @ block.back[..., :-q]], axis=-2)
        pulls = joint[..., :q]
        spread = near[..., :q, :q] + self.after_var[:, None, None, None] * block.eye
        nu = y.T[:, None] - near[..., :q, n + q]
        seen = np.isfinite(y).T[:, None]
        skipped = np.zeros_like(seen)
        while True:
            if not seen.all():
                use = seen[..., None, :]
                both = seen[..., None, :] & seen[..., None]
                pulls = np.where(use, pulls, 0.0)
                spread = np.where(both, spread, block.eye)
                nu = np.where(seen, nu, 0.0)
            root = np.linalg.cholesky(spread)
            inverse = np.linalg.inv(root).swapaxes(-1, -2)
            white = (nu[..., None, :] @ inverse)[..., 0, :]
            out = np.abs(white).min(axis=1, keepdims=True) > IMPOSSIBLE
            if not out.any():
                break
            skipped |= out & (np.cumsum(out, axis=-1) == 1)
            seen &= ~skipped
        gain = pulls @ inverse
        moves = gain[..., block.asked, :] * block.sofar
        told = np.empty((6, *white.shape))
        logs = np.add.accumulate(-0.5 * white**2 - np.log(np.einsum("...ii->...i", root)), axis=-1)
        likely = np.maximum(
            weight[..., None] * np.exp(logs - logs.max(axis=1, keepdims=True)), 1e-12
        )
        told[0] = likely / likely.sum(axis=1, keepdims=True)
        x = joint[..., block.asked, n + q] + (moves @ white[..., None])[..., 0]
        told[1:4] = np.moveaxis(x.reshape(*x.shape[:2], 3, q), 2, 0)
        moves = moves[..., :q, :]
        told[4] = joint[..., block.asked[:q], n + q + 1] - np.einsum(
            "...ij,...ij->...i", moves, moves
        )
        told[5] = skipped
        kept = slice(q, q + known.shape[-2])
        gain = gain[..., kept, :]
        known = joint[..., kept, q : n + q + 2]
        known[..., :n] -= gain @ gain[..., :n, :].swapaxes(-1, -2)
        known[..., n] += (gain @ white[..., None])[..., 0]
        known[..., n + 1] -= np.einsum("...ij,...ij->...i", gain, gain)
        return known, told

    def _merged(self, known: Array, weight: Array) -> tuple[Array, Array]:
        """The same before the next sample, where each hypothesis may give way to another."""
        n = self.rows.shape[-1]
        first = len(self.sensors[0].output)
        joint = weight[:, :, None] * self.switch
        weight = joint.sum(axis=1)
        share = (joint / weight[:, None]).swapaxes(1, 2)  # (M, to, from)
        shift = known[:, :1, :, n]
        apart = known[..., n] - shift
        square = known.copy()
        square[..., :n] += apart[..., None] * apart[..., None, :n]
        square[..., n] = apart
        square[..., n + 1] += apart**2
        known = (share @ square.reshape(*share.shape[:2], -1)).reshape(known.shape)
        apart = known[..., n].copy()
        known[..., :n] -= apart[..., None] * apart[..., None, :n]
        known[..., n] += shift
        known[..., n + 1] -= apart**2
        known[:, :BURST, first] = 0.0  # the offset is there in a burst only
        known[:, :BURST, :, first] = 0.0
        np.einsum("...ii->...i", known[..., :n, :n])[:] += (1 - np.einsum("...ii->...i", share))[
            ..., None
        ] * self.begun
        return known, weight

    def _noise(self, block: Block, held: Array) -> Array:
        """What noise adds to the covariances of a block: the more to a restless slope the longer a burst seems."""
        beyond = held - LONGEST_BURST_S / self.dt_s
        if beyond.max() <= 0:
            return block.noise
        out = self.scatter.copy()
        out[:, RESTLESS, [0, 1], [0, 1]] *= (4.0 ** np.clip(beyond, 0.0, MOST_OPENED))[:, None]
        return scattered(block.effects, out, block.column)

    def _answers(
        self, weight: Array, x: Array, var: Array, past: Array, recent: Array
    ) -> tuple[Array, Array, Array]:
        """Temperature [degC] and sd [K] (N, M) of hypotheses (N, M, 4), in the range of ``recent`` (W + N, M).

        ``x`` (3, N, M, 4): the answers and two after each; with two of the ``past`` they tell of bends, some of which
        may be smoothed away. Last, the next ``past``.
        """
        mean, *later = (weight * x).sum(axis=-1)
        series = np.concatenate([past.reshape(-1, mean.shape[1]), mean])
        n = len(mean)
        five = np.stack([series[:n], series[self.bend : self.bend + n], mean, *later])
        doubt = np.where(
            weight[..., BURST:] > BURST_LIKELY, np.maximum(weight, LEAST_DOUBT), weight
        )
        var = (doubt * (np.maximum(var, 0.0) + (x[0] - mean[..., None]) ** 2)).sum(axis=-1)
        bends = (np.diff(five, n=2, axis=0) ** 2).sum(axis=0)
        var += BEND_SHARE**2 * np.maximum(bends - var, 0.0)  # noise bends, too
        size = len(recent) - n
        origin = -((len(recent) - n) // 2)
        ranges = (
            f(recent, size, axis=0, origin=origin) for f in (minimum_filter1d, maximum_filter1d)
        )
        low, high = (values[1 : 1 + n] for values in ranges)
        unseen = np.maximum(high - low, IMPOSSIBLE * self.noise_sd) / self.shown
        held = np.clip(mean, low - unseen, high + unseen)
        return held, np.sqrt(var + (mean - held) ** 2), series[n:]


def live_before_use(engine: LiveSmoother, chains: Sequence[Chain]) -> BeforeUse:
    """The report on the channel of a live smoother whose answer is noisiest.

    At rest the smoother is a linear filter; its impulse response is had by giving it one sample, too little to be taken
    for anything else than noise.
    """
    dt = engine.dt_s
    rows = int(
        min(
            8 * max(s.lag_s for s in engine.sensors) / dt + 4 * engine.lag_samples + 200,
            4000 + 2 * engine.lag_samples,
        )
    )
    y = np.zeros((2 * rows, len(chains)))
    y[rows] = TINY * engine.noise_sd
    _, x, _, _ = engine.run(engine.start(np.zeros(len(chains))), y)
    pulses = x[rows:] / (TINY * engine.noise_sd)
    worst = int(np.argmax(np.sum(pulses**2, axis=0) * engine.noise_sd**2))
    chain = chains[worst]
    one = np.array([1.0])
    f = InverseFilter(
        pulses[:, worst], one, dt, np.nan, chain.delay_s + engine.lag_samples * dt, chain
    )
    noisy = [warning("live.noisy", gain=f.noise_gain)] if f.noise_gain > MOST_GAIN else []
    return filter_report(f, float(engine.noise_sd[worst]), noisy)
