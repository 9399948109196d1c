"""A smoother for live displays: temperature at the present, or a fixed small lag behind it, with
its uncertainty.

Each channel has an interacting multiple model (IMM) filter with four hypotheses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from tcdyn.chain import Chain, Sensor, sensors
from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.core.findings import warning
from tcdyn.smoothing.inverse import FilterReport, InverseFilter, filter_report
from tcdyn.smoothing.live_model import (
    Block,
    LiveState,
    noise_filters,
    process_noise_covariance,
    sensor_with_noise,
)
from tcdyn.smoothing.record import MISSING, SPIKE
from tcdyn.smoothing.state_space import prior

# hypotheses about the process at a sample
QUIET, RESTLESS, JUMPED, BURST = range(4)
# Values without a source below were chosen by judgement.
# mean time between two jumps of the slope, two jumps of the temperature, two bursts [s]
SLOPE_JUMP_INTERVAL_S = 60.0
LEVEL_JUMP_INTERVAL_S = 3600.0
BURST_INTERVAL_S = 20.0
# mean duration of a burst [s], its longest duration [s], mean duration of the restless mode [lags]
BURST_DURATION_S = 0.12
LONGEST_BURST_S = 0.4
RESTLESS_LAGS = 8.0
# standard deviation of the offset in a burst, in standard deviations of the noise; its decay time
# [s]; and its random walk as a share of that standard deviation
BURST_SD_RATIO = 12.0
BURST_LEAK_S = 0.3
BURST_WALK = 0.2
# standard deviation of a jump of the slope: in noises per lag, and in random walks of the quiet
# slope over one lag
SLOPE_JUMP_NOISES = 200.0
SLOPE_JUMP_WALKS = 2.0
# standard deviation of a jump of the temperature, restless and jumped: share of the change that
# a jump of the slope makes in one lag
LEVEL_JUMP = (0.1, 1.0)
# random walk of slope and temperature over one lag after a jump: share of the jump
SETTLING = (0.2, 0.04)
# lags for which the hypotheses are followed separately: the filter hides a change for as long
SEPARATE_LAGS = 0.08
# standard deviations of the prediction in a burst beyond which a reading is rejected
REJECTION_SD = 6.0
# doublings of the jumps of slope and temperature once a burst is too long to be one, at most
MAX_DOUBLINGS = 5.0
# a delayed result may smooth away this share of its bends, measured over so many lags
BEND_LAGS = 0.25
BEND_SHARE = 0.5
# where a burst has at least this weight, the other hypotheses have at least this weight in the sd
BURST_LIKELY = 0.05
MIN_OTHER_WEIGHT = 0.04
# share of a step at the junction that the readings show after the time over which their range
# counts
VISIBLE_STEP_SHARE = 0.2
# size of the test impulse, in standard deviations of the noise
TEST_IMPULSE_NOISES = 1e-3
# samples processed at once, at most (a matter of speed only)
LONGEST_BLOCK = 8
# noise gain beyond which the result of a live smoother is of little use
MAX_NOISE_GAIN = 10.0


@dataclass(frozen=True)
class LiveSmoother:
    """Four Kalman filters a channel, averaged by their likelihood, with the last temperatures
    smoothed (fixed lag).

    Hypotheses: quiet (the slope is a random walk of the given intensity), restless (the slope has
    jumped and settles), jumped (the temperature has jumped), burst (a slip ring adds an offset
    before the conditioning filter, or a single sample is an outlier; afterwards only what the
    filter still holds of it remains).

    Parameters
    ----------
    sensors
        State space of each chain.
    dt_s
        Sampling interval [s].
    noise_sd
        Standard deviation (M,) [K] of the noise of a sample, white and coloured together.
    intensity
        Process-noise intensity of the quiet mode (M,) [K2/s3].
    lag_samples
        Fixed lag [samples].
    bend
        Samples between the results whose differences show bends.
    after_var
        Variance of the white noise (M,) [K2].
    steps, rows
        Transition matrices of one sample (M, 1, n, n), and observation rows (M, 1, n).
    scatter
        Process-noise covariance of one sample under each hypothesis (M, 4, n, n).
    start_var
        Variances added where a hypothesis starts: jumps of temperature and slope, offset (M, 4, n).
    filter_noise_cov
        Stationary covariance of the noise in the filter states (M, n, n).
    switch_prob
        Transition probabilities of the hypotheses over ``merge_every`` samples (4, 4).
    merge_every
        Samples between two merges of the hypotheses.
    blocks
        Blocks of one sample, of two, and so on.
    visible_share
        Share of a step at the junction that the readings show after ``window`` samples (M,).
    window
        Length [samples] of the range of readings that limits the result.

    Notes
    -----
    The hypotheses follow one another as a Markov chain. Every few samples their states are merged
    by weight (interacting multiple models, Blom and Bar-Shalom 1988). They are not merged at each
    sample: a small burst would be forgotten before the filter shows it. So the uncertainty is right
    also while the data cannot yet show what has happened. Noise from before the filter has states
    of its own. Missing samples are skipped, and so are outliers that no hypothesis explains
    (outlier rejection). The result at sample k is for time k dt - delay - lag_samples dt. It stays
    in the range of the last readings, extended by what the chain may not have shown yet; where this
    limit acts, the standard deviation covers the difference.
    """

    sensors: tuple[Sensor, ...]
    dt_s: float
    noise_sd: Array
    intensity: Array
    lag_samples: int
    bend: int
    after_var: Array
    steps: Array
    rows: Array
    scatter: Array
    start_var: Array
    filter_noise_cov: Array
    switch_prob: Array
    merge_every: int
    blocks: tuple[Block, ...]
    visible_share: Array
    window: int

    @classmethod
    def from_chains(
        cls,
        chains: Sequence[Chain],
        dt_s: float,
        noise_sd: ArrayLike,
        intensity: ArrayLike,
        lag_samples: int = 0,
        before_sd: ArrayLike = 0.0,
    ) -> LiveSmoother:
        """Live smoother for ``chains``.

        Parameters
        ----------
        chains
            The chain of each channel (M).
        dt_s
            Sampling interval [s].
        noise_sd
            Standard deviation of the white noise [K], (M,) or one number.
        intensity
            Process-noise intensity of the quiet mode [K2/s3], (M,) or one number.
        lag_samples
            Fixed lag [samples].
        before_sd
            Standard deviation, after the filter of each chain, of the noise that this filter has
            coloured [K].

        Raises
        ------
        InputError
            For a negative lag, or noise or intensity that is not positive.
        """
        white_sd, level, coloured_sd = (
            np.broadcast_to(np.asarray(v, dtype=float), (len(chains),)).copy()
            for v in (noise_sd, intensity, before_sd)
        )
        if (
            lag_samples < 0
            or np.any(white_sd <= 0)
            or np.any(level <= 0)
            or np.any(coloured_sd < 0)
        ):
            raise InputError(
                "live smoother: lag_samples must not be negative, "
                "noise and intensity must be positive"
            )
        sensor_models = tuple(sensors(chains))
        noise = np.hypot(white_sd, coloured_sd)
        lags = np.array([s.lag_s for s in sensor_models]) + dt_s
        slope_jump = np.maximum(
            SLOPE_JUMP_NOISES * noise / lags, SLOPE_JUMP_WALKS * np.sqrt(level * lags)
        )
        models = [
            sensor_with_noise(s, b, BURST_LEAK_S, dt_s)
            for s, b in zip(sensor_models, noise_filters(chains))
        ]
        steps, rows, filter_noise_cov = (np.stack(part) for part in zip(*models))
        filter_noise_cov *= coloured_sd[:, None, None] ** 2
        scatter = np.repeat(
            (filter_noise_cov - steps @ filter_noise_cov @ steps.transpose(0, 2, 1))[:, None],
            BURST + 1,
            axis=1,
        )
        scatter[:, :, 1, 1] += (level * dt_s)[:, None]
        offset_index = len(sensor_models[0].output)
        start_var = np.zeros(scatter.shape[:3])
        start_var[:, BURST, offset_index] = (BURST_SD_RATIO * noise) ** 2
        for mode, share, settling in zip((RESTLESS, JUMPED), LEVEL_JUMP, SETTLING):
            start_var[:, mode, 0] = (share * slope_jump * lags) ** 2
            start_var[:, mode, 1] = slope_jump**2
            scatter[:, mode, [0, 1], [0, 1]] += (
                settling**2 * start_var[:, mode, :2] * (dt_s / lags)[:, None]
            )
        scatter[:, BURST, offset_index, offset_index] += (
            BURST_WALK**2 * start_var[:, BURST, offset_index]
        )
        start_prob = np.minimum(
            dt_s
            / np.array([np.inf, SLOPE_JUMP_INTERVAL_S, LEVEL_JUMP_INTERVAL_S, BURST_INTERVAL_S]),
            0.2,
        )
        quiet_prob, end_prob = (
            min(dt_s / t, 0.7) for t in (RESTLESS_LAGS * lags.mean(), BURST_DURATION_S)
        )
        switch_prob = np.tile(start_prob, (BURST + 1, 1))
        switch_prob[[RESTLESS, JUMPED], QUIET] = quiet_prob
        switch_prob[BURST] = end_prob * np.append(1.0, start_prob[1:])
        np.fill_diagonal(switch_prob, 0.0)
        np.fill_diagonal(switch_prob, 1 - switch_prob.sum(axis=1))
        merge_every = max(round(SEPARATE_LAGS * lags.mean() / dt_s), 1)
        steps = steps[:, None]
        rows = rows[:, None]
        bend = min(round(BEND_LAGS * lags.mean() / dt_s), lag_samples // 2)
        delays = lag_samples - bend * np.arange(3)
        blocks = tuple(
            Block.of(q, delays, steps, rows, scatter)
            for q in range(1, min(merge_every, LONGEST_BLOCK) + 1)
        )
        unit = np.append(0.0, np.ones(int(2 * lags.max() / dt_s) + 8))
        step = np.stack([c.response(unit, dt_s, "zoh") for c in chains])
        window = int(np.max(np.argmax(step >= VISIBLE_STEP_SHARE, axis=1)))
        return cls(
            sensor_models,
            dt_s,
            noise,
            level,
            lag_samples,
            bend,
            white_sd**2,
            steps,
            rows,
            scatter,
            start_var,
            filter_noise_cov,
            np.linalg.matrix_power(switch_prob, merge_every),
            merge_every,
            blocks,
            step[:, window],
            window,
        )

    def initial_state(self, first: ArrayLike) -> LiveState:
        """State after only the first sample ``first`` (M,) [degC]; before it the chain followed a
        ramp.
        """
        first = np.asarray(first, dtype=float)
        if first.shape != (len(self.sensors),) or not np.all(np.isfinite(first)):
            raise InputError(
                f"live smoother: the first sample must have {len(self.sensors)} finite values; "
                f"got {first}",
                remedy="start at the first complete row",
            )
        m = len(first)
        n = self.rows.shape[-1]
        lag = self.lag_samples
        mean = np.zeros((m, BURST + 1, n + lag))
        cov = np.zeros((m, BURST + 1, n + lag, n))
        var = np.zeros((m, BURST + 1, lag))
        cov[:, :, :n] = self.filter_noise_cov[:, None]
        channels = zip(self.sensors, first, self.noise_sd, self.intensity)
        for i, (s, y, sd, q) in enumerate(channels):
            n_sensor = len(s.output)
            mean[i, :, :n_sensor], start_cov, _ = prior(s, y, 10 * sd, self.dt_s, np.array([q]))
            mean[i, :, n:] = y
            var[i] = start_cov[0, 0, 0]
            cov[i, :, :n_sensor, :n_sensor] = start_cov[0]
        weight = np.tile(np.eye(BURST + 1)[QUIET], (m, 1))
        recent = np.tile(first, (self.window + lag + 1, 1))
        return LiveState(
            mean, cov, var, weight, recent, np.zeros(m), np.tile(first, (2 * self.bend, 1))
        )

    def run(
        self, state: LiveState, chunk: ArrayLike
    ) -> tuple[LiveState, Array, Array, NDArray[np.uint8]]:
        """Process the readings ``chunk`` (N, M) [degC].

        Returns the next state, temperature [degC] and standard deviation [K] (N, M) at the fixed
        lag, and the flags of the samples.
        """
        y = np.asarray(chunk, dtype=float)
        n = self.rows.shape[-1]
        m = len(self.sensors)
        joint_state = np.concatenate(
            [state.cov, state.mean[..., None], np.zeros((*state.mean.shape, 1))], axis=-1
        )
        joint_state[..., n:, -1] = state.var
        weight = state.weight
        outlier_run = state.held
        outputs = [np.empty((6, m, BURST + 1, 0))]
        k = 0
        longest = LONGEST_BURST_S / self.dt_s
        while k < len(y):
            until_merge = self.merge_every - (state.done + k) % self.merge_every
            if until_merge == self.merge_every:
                joint_state, weight = self._mix(joint_state, weight)
            q = 1
            if outlier_run.max() + until_merge <= longest:
                q = min(until_merge, len(self.blocks), len(y) - k)
            joint_state, output = self._block(joint_state, weight, outlier_run, y[k : k + q])
            weight = output[0, ..., -1]
            outlying = (output[5, :, 0] + (output[0, :, BURST] > 0.5)).T
            for outlier, missing in zip(outlying, ~np.isfinite(y[k : k + q])):
                longer = np.where(outlier > 0, outlier_run + 1, 0.0)
                outlier_run = np.where(missing, outlier_run, longer)
            outputs.append(output)
            k += q
        output = np.moveaxis(np.concatenate(outputs, axis=-1), -1, 1)
        missing_mask = ~np.isfinite(y)
        spike = ~missing_mask & ((output[5, ..., 0] > 0) | (output[0, ..., BURST] > 0.5))
        good = np.maximum.accumulate(
            np.where(missing_mask | spike, 0, np.arange(1, len(y) + 1)[:, None]), axis=0
        )
        recent = np.concatenate(
            [state.recent, np.concatenate([state.recent[-1:], y])[good, range(m)]]
        )
        x, sd, past = self._average(output[0], output[1:4], output[4], state.past, recent)
        fields = (
            joint_state[..., n],
            joint_state[..., :n],
            joint_state[..., n:, -1],
            weight,
            recent[len(y) :],
            outlier_run,
            past,
        )
        flags = np.where(missing_mask, MISSING, np.where(spike, SPIKE, 0)).astype(np.uint8)
        return LiveState(*fields, state.done + len(y)), x, sd, flags

    def _block(
        self, joint_state: Array, weight: Array, outlier_run: Array, y: Array
    ) -> tuple[Array, Array]:
        """Process the samples ``y`` (q, M) of a block.

        Parameters
        ----------
        joint_state
            (M, 4, n + L, n + 2): covariance of states and last temperatures with the states, their
            mean and their variance.
        weight
            Probabilities (M, 4) of the hypotheses.
        outlier_run
            Number of consecutive outliers (M,).
        y
            Readings (q, M) [degC].

        Returns
        -------
        joint_state, output
            The joint state after the block; and for each sample and hypothesis (6, M, 4, q): its
            weight, the result and two results after it, the variance of the result, and whether no
            hypothesis explains the sample.

        Notes
        -----
        All unknowns (see ``Block``; then the last temperatures) have one joint covariance. The
        Cholesky factor of the readings' part gives the information that each reading adds to those
        before it.
        """
        q = len(y)
        n = self.rows.shape[-1]
        block = self.blocks[q - 1]
        state_cov = block.effects[0] @ (joint_state[..., :n, :] @ block.back) + self._noise(
            block, outlier_run
        )
        state_cov[..., -1 - q] = state_cov[..., block.row, block.column]
        joint = np.concatenate(
            [state_cov[..., :-q], joint_state[..., n:, :] @ block.back[..., :-q]], axis=-2
        )
        cross_cov = joint[..., :q]
        innovation_cov = state_cov[..., :q, :q] + self.after_var[:, None, None, None] * block.eye
        innovation = y.T[:, None] - state_cov[..., :q, n + q]
        used = np.isfinite(y).T[:, None]
        skipped = np.zeros_like(used)
        while True:
            if not used.all():
                use = used[..., None, :]
                both = used[..., None, :] & used[..., None]
                cross_cov = np.where(use, cross_cov, 0.0)
                innovation_cov = np.where(both, innovation_cov, block.eye)
                innovation = np.where(used, innovation, 0.0)
            root = np.linalg.cholesky(innovation_cov)
            inverse = np.linalg.inv(root).swapaxes(-1, -2)
            whitened = (innovation[..., None, :] @ inverse)[..., 0, :]
            outlier = np.abs(whitened).min(axis=1, keepdims=True) > REJECTION_SD
            if not outlier.any():
                break
            skipped |= outlier & (np.cumsum(outlier, axis=-1) == 1)
            used &= ~skipped
        gain = cross_cov @ inverse
        smoother_gain = gain[..., block.requested, :] * block.available
        output = np.empty((6, *whitened.shape))
        log_likelihood = np.add.accumulate(
            -0.5 * whitened**2 - np.log(np.einsum("...ii->...i", root)), axis=-1
        )
        posterior = np.maximum(
            weight[..., None] * np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True)),
            1e-12,
        )
        output[0] = posterior / posterior.sum(axis=1, keepdims=True)
        x = joint[..., block.requested, n + q] + (smoother_gain @ whitened[..., None])[..., 0]
        output[1:4] = np.moveaxis(x.reshape(*x.shape[:2], 3, q), 2, 0)
        smoother_gain = smoother_gain[..., :q, :]
        output[4] = joint[..., block.requested[:q], n + q + 1] - np.einsum(
            "...ij,...ij->...i", smoother_gain, smoother_gain
        )
        output[5] = skipped
        stored = slice(q, q + joint_state.shape[-2])
        gain = gain[..., stored, :]
        joint_state = joint[..., stored, q : n + q + 2]
        joint_state[..., :n] -= gain @ gain[..., :n, :].swapaxes(-1, -2)
        joint_state[..., n] += (gain @ whitened[..., None])[..., 0]
        joint_state[..., n + 1] -= np.einsum("...ij,...ij->...i", gain, gain)
        return joint_state, output

    def _mix(self, joint_state: Array, weight: Array) -> tuple[Array, Array]:
        """Joint state and weights before the next sample, where each hypothesis may change to
        another.
        """
        n = self.rows.shape[-1]
        offset_index = len(self.sensors[0].output)
        joint = weight[:, :, None] * self.switch_prob
        weight = joint.sum(axis=1)
        share = (joint / weight[:, None]).swapaxes(1, 2)  # (M, to, from)
        shift = joint_state[:, :1, :, n]
        difference = joint_state[..., n] - shift
        second_moment = joint_state.copy()
        second_moment[..., :n] += difference[..., None] * difference[..., None, :n]
        second_moment[..., n] = difference
        second_moment[..., n + 1] += difference**2
        joint_state = (share @ second_moment.reshape(*share.shape[:2], -1)).reshape(
            joint_state.shape
        )
        difference = joint_state[..., n].copy()
        joint_state[..., :n] -= difference[..., None] * difference[..., None, :n]
        joint_state[..., n] += shift
        joint_state[..., n + 1] -= difference**2
        joint_state[:, :BURST, offset_index] = 0.0  # the offset is there in a burst only
        joint_state[:, :BURST, :, offset_index] = 0.0
        newcomers = 1 - np.einsum("...ii->...i", share)
        diagonal = np.einsum("...ii->...i", joint_state[..., :n, :n])
        diagonal[:] += newcomers[..., None] * self.start_var
        return joint_state, weight

    def _noise(self, block: Block, outlier_run: Array) -> Array:
        """Process noise of a block; the longer a burst seems to last, the more it opens the
        restless slope.
        """
        excess = outlier_run - LONGEST_BURST_S / self.dt_s
        if excess.max() <= 0:
            return block.noise
        out = self.scatter.copy()
        out[:, RESTLESS, [0, 1], [0, 1]] *= (4.0 ** np.clip(excess, 0.0, MAX_DOUBLINGS))[:, None]
        return process_noise_covariance(block.effects, out, block.column)

    def _average(
        self, weight: Array, x: Array, var: Array, past: Array, recent: Array
    ) -> tuple[Array, Array, Array]:
        """Temperature [degC] and standard deviation [K] (N, M), averaged over the hypotheses (N, M,
        4).

        The result is limited to the range of ``recent`` (W + N, M). ``x`` (3, N, M, 4) has the
        results and two results after each; with two of the ``past`` results they show the bends,
        part of which may be smoothed away. The third result is the next ``past``.
        """
        mean, *later = (weight * x).sum(axis=-1)
        series = np.concatenate([past.reshape(-1, mean.shape[1]), mean])
        n = len(mean)
        samples = np.stack([series[:n], series[self.bend : self.bend + n], mean, *later])
        sd_weight = np.where(
            weight[..., BURST:] > BURST_LIKELY, np.maximum(weight, MIN_OTHER_WEIGHT), weight
        )
        var = (sd_weight * (np.maximum(var, 0.0) + (x[0] - mean[..., None]) ** 2)).sum(axis=-1)
        bends = (np.diff(samples, n=2, axis=0) ** 2).sum(axis=0)
        var += BEND_SHARE**2 * np.maximum(bends - var, 0.0)  # noise bends, too
        size = len(recent) - n
        origin = -((len(recent) - n) // 2)
        low = minimum_filter1d(recent, size, axis=0, origin=origin)[1 : 1 + n]
        high = maximum_filter1d(recent, size, axis=0, origin=origin)[1 : 1 + n]
        margin = np.maximum(high - low, REJECTION_SD * self.noise_sd) / self.visible_share
        limited = np.clip(mean, low - margin, high + margin)
        return limited, np.sqrt(var + (mean - limited) ** 2), series[n:]


def report_live_smoother(engine: LiveSmoother, chains: Sequence[Chain]) -> FilterReport:
    """The filter report on the channel of a live smoother with the noisiest result.

    At rest the smoother is a linear filter. Its impulse response is that to one sample that is too
    small to be taken for anything but noise.
    """
    dt = engine.dt_s
    longest_lag_s = max(s.lag_s for s in engine.sensors)
    needed = 8 * longest_lag_s / dt + 4 * engine.lag_samples + 200
    rows = int(min(needed, 4000 + 2 * engine.lag_samples))
    y = np.zeros((2 * rows, len(chains)))
    y[rows] = TEST_IMPULSE_NOISES * engine.noise_sd
    _, x, _, _ = engine.run(engine.initial_state(np.zeros(len(chains))), y)
    impulse_response = x[rows:] / (TEST_IMPULSE_NOISES * engine.noise_sd)
    worst = int(np.argmax(np.sum(impulse_response**2, axis=0) * engine.noise_sd**2))
    chain = chains[worst]
    shift_s = chain.delay_s + engine.lag_samples * dt
    f = InverseFilter(impulse_response[:, worst], np.array([1.0]), dt, np.nan, shift_s, chain)
    findings = [warning("live.noisy", gain=f.noise_gain)] if f.noise_gain > MAX_NOISE_GAIN else []
    return filter_report(f, float(engine.noise_sd[worst]), findings)
