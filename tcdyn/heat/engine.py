"""One test with the modal rim model: temperatures at junctions, (beta, h) maps, and fields.

For ``tcdyn verify`` and for users of the rim model. The fits of ``tcdyn.partition`` need neither
fields nor maps and use ``modal`` and the basis of lags directly.

Guarded by ``tests/heat/test_rim_engine.py`` and ``tests/heat/test_rim_fields.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tcdyn.core import Array
from tcdyn.core.errors import InputError
from tcdyn.heat.modal import Spectrum, inputs_of, rim_gains, spectrum, steady_amplitudes
from tcdyn.heat.rim import (
    MESH_IV,
    Flux,
    InputJump,
    Mesh,
    Point,
    Profile,
    Rim,
    basis_rates,
    lag_basis,
    lag_weights,
)


@dataclass(frozen=True)
class RimInputs:
    """Inputs of a rim, (N,) each.

    Between samples the power is constant and the temperatures are linear.

    Parameters
    ----------
    dt_s
        Sample interval [s].
    power_W
        Heat into this disk at a share of one.
    d_degC, b_degC, f_degC
        Inner row of junctions.
    ambient_degC
        Air.
    jumps
        Jumps of the power inside a sample interval.
    """

    dt_s: float
    power_W: Array
    d_degC: Array
    b_degC: Array
    f_degC: Array
    ambient_degC: Array
    jumps: tuple[InputJump, ...] = ()

    def __post_init__(self) -> None:
        """Check that all inputs have one shape, (N,).

        Raises
        ------
        InputError
            An input has another shape than ``b_degC``, or is not one-dimensional.
        """
        shape = np.shape(self.b_degC)
        if len(shape) != 1:
            raise InputError(f"RimInputs: b_degC has shape {shape}", expected="one dimension, (N,)")
        for name in ("power_W", "d_degC", "f_degC", "ambient_degC"):
            shape_of_input = np.shape(getattr(self, name))
            if shape_of_input != shape:
                raise InputError(
                    f"RimInputs: {name} has shape {shape_of_input}", expected=f"{shape}"
                )

    @property
    def inputs(self) -> Array:
        """All inputs, (N, 5), in the order of ``RimGains.inputs``.

        Notes
        -----
        The order is that of ``tcdyn.heat.modal.inputs_of(3)``: power, then d, b and f, then the
        air. ``temperature_map`` and ``fields_at`` take column 0 for the power; keep the two
        functions consistent.
        """
        columns = (self.power_W, self.d_degC, self.b_degC, self.f_degC, self.ambient_degC)
        return np.stack(columns, axis=1).astype(float)

    def lag_responses(self, k: int, rates: Array) -> Array:
        """Responses of the lags to one input, in equilibrium with its first sample.

        Parameters
        ----------
        k
            Column of ``inputs``; 0 is the power.
        rates
            Rates of the basis of lags, (K,) [1/s].

        Returns
        -------
        Responses, (N, K), in the unit of the input.

        Notes
        -----
        The power is held between samples (zero-order hold, with its jumps), the temperatures are
        linear (first-order hold).
        """
        u = self.inputs[:, k]
        if k == 0:
            return lag_basis(u, self.dt_s, rates, "zoh", self.jumps)
        return lag_basis(u, self.dt_s, rates)


def temperature_map(
    rim: Rim,
    drive: RimInputs,
    share: ArrayLike,
    h_W_m2K: ArrayLike,
    points: Sequence[Point],
    half_width_m: float,
    *,
    profile: Profile = "modal",
    flux: Flux = "hertz",
    mesh: Mesh = MESH_IV,
) -> Array:
    """Temperatures (H, B, P, N) [degC] for every h and every share: the map of section 3.5.

    A share is beta or 1 - beta, whichever is that of this disk.

    Starts in steady state with the first sample. The result is linear in the share, so each h needs
    two weighted sums of the filtered inputs, which do not depend on h.

    Parameters
    ----------
    rim
        Geometry, material and inner row of the disk.
    drive
        Inputs of the test, N samples.
    share
        Shares of the power, (B,): beta, or 1 - beta.
    h_W_m2K
        Heat-transfer coefficients of the running surface, (H,) [W/m2K].
    points
        (depth, z) of the P points [m].
    half_width_m
        Half-width of the contact [m].
    profile
        Shape of the temperature along r = R_i, see ``tcdyn.heat.modal.profile_basis``.
    flux
        Profile of the heat flux across the track, see ``tcdyn.heat.modal.flux_density``.
    mesh
        Nodes in r and z.

    Returns
    -------
    Temperatures, (H, B, P, N) [degC].

    Raises
    ------
    InputError
        As :func:`tcdyn.heat.modal.rim_gains`.

    Notes
    -----
    ``tests/heat/test_rim_engine.py`` compares the map with single runs. The loops may be written in
    another way; the power must stay column 0 of ``RimInputs.inputs``, and must have no direct term.
    """
    shares = np.atleast_1d(np.asarray(share, dtype=float))
    hs = np.atleast_1d(np.asarray(h_W_m2K, dtype=float))
    rates = basis_rates(drive.dt_s)
    u = drive.inputs
    by_h = [rim_gains(rim, float(h), points, half_width_m, rates, profile, flux, mesh) for h in hs]
    weights = np.concatenate([g.gains for g in by_h], axis=1)  # (I, H P, K)
    direct = np.concatenate([g.direct for g in by_h], axis=1)
    out = np.empty((len(hs), len(shares), len(points), len(u)))
    # the part that does not depend on the share is built in the memory of the last share
    base = out[:, -1]
    base[:] = (direct.T @ u.T).reshape(base.shape)
    for k in range(1, len(weights)):
        base += (weights[k] @ drive.lag_responses(k, rates).T).reshape(base.shape)
    # the power has no direct term: it changes no point at once
    heat = (weights[0] @ drive.lag_responses(0, rates).T).reshape(base.shape)
    for i, value in enumerate(shares[:-1]):
        np.multiply(heat, value, out=out[:, i])
        out[:, i] += base
    base += shares[-1] * heat
    return out


def fields_at(
    rim: Rim,
    drive: RimInputs,
    h_W_m2K: float,
    half_width_m: float,
    samples: Sequence[int],
    *,
    share: float = 1.0,
    profile: Profile = "modal",
    flux: Flux = "hertz",
    mesh: Mesh = MESH_IV,
) -> Array:
    """Temperature fields of the whole mesh at chosen samples of a test [degC].

    Parameters
    ----------
    rim
        Geometry, material and inner row of the disk.
    drive
        Inputs of the test, N samples.
    h_W_m2K
        Heat-transfer coefficient of the running surface [W/m2K].
    half_width_m
        Half-width of the contact [m].
    samples
        Indices of the S samples.
    share
        Factor for the power: beta, 1 - beta, or 1 if ``drive`` has the heat into this disk.
    profile
        Shape of the temperature along r = R_i.
    flux
        Profile of the heat flux across the track.
    mesh
        Nodes in r and z.

    Returns
    -------
    Fields, (S, nr, nz); node 0 in r has the imposed profile, the last node is the running surface.

    Notes
    -----
    The amplitude of a mode is its steady amplitude for each input times the input through the
    mode's lag. Modes faster than the basis use its fastest lag, as in
    ``tcdyn.heat.modal.rim_gains``; change both alike. ``tests/heat/test_rim_engine.py`` checks that
    the fields pass through the temperatures of ``temperature_map``.
    """
    rates = basis_rates(drive.dt_s)
    rows = np.asarray(samples, dtype=int)
    s = spectrum(rim, h_W_m2K, half_width_m, profile, flux, mesh)
    banks = np.stack(
        [drive.lag_responses(k, rates)[rows] for k in range(drive.inputs.shape[1])]
    )  # (I, S, K)
    banks[0] *= share
    weights = lag_weights(rates, np.log(np.minimum(s.rates, rates[-1])).ravel())
    amplitude = np.einsum(
        "ix,isx->sx", steady_amplitudes(s).reshape(len(banks), -1), banks @ weights.T
    )
    inner = drive.inputs[rows] @ s.boundary
    return _nodal_fields(s, amplitude.reshape(len(rows), *s.rates.shape), inner)


def step_fields(
    rim: Rim,
    h_W_m2K: float,
    half_width_m: float,
    before: Sequence[float],
    after: Sequence[float],
    time_s: ArrayLike,
    profile: Profile = "modal",
    flux: Flux = "hertz",
    mesh: Mesh = MESH_IV,
) -> Array:
    """Fields after a step of the inputs from the steady state of ``before`` [degC].

    The scheme without any error in time, for studies of mesh and order.

    Parameters
    ----------
    rim
        Geometry, material and inner row of the disk.
    h_W_m2K
        Heat-transfer coefficient of the running surface [W/m2K].
    half_width_m
        Half-width of the contact [m].
    before, after
        Inputs before and after the step, (I,): power [W], inner row and ambient [degC], in the
        order of ``tcdyn.heat.modal.inputs_of``.
    time_s
        Times after the step, (T,) [s].
    profile
        Shape of the temperature along r = R_i.
    flux
        Profile of the heat flux across the track.
    mesh
        Nodes in r and z.

    Returns
    -------
    Fields, (T, nr, nz).

    Raises
    ------
    InputError
        ``before`` or ``after`` has another number of inputs than the rim.

    Notes
    -----
    T(t) = T_after + sum over modes of (X_before - X_after) exp(-lambda t)

    X are the amplitudes of ``tcdyn.heat.modal.steady_amplitudes``. The row r = R_i takes its new
    profile at once. Guarded by ``tests/heat/test_rim_fields.py`` and
    ``tests/heat/test_rim_convergence.py``.
    """
    s = spectrum(rim, h_W_m2K, half_width_m, profile, flux, mesh)
    if len(before) != len(s.boundary) or len(after) != len(s.boundary):
        raise InputError(
            f"step_fields: needed are, in this order, {', '.join(inputs_of(len(rim.boundary_z_m)))}"
        )
    old = np.tensordot(np.asarray(before, dtype=float), steady_amplitudes(s), axes=1)
    new = np.tensordot(np.asarray(after, dtype=float), steady_amplitudes(s), axes=1)
    t = np.atleast_1d(np.asarray(time_s, dtype=float))
    amplitude = new + (old - new) * np.exp(-t[:, None, None] * s.rates)
    return _nodal_fields(s, amplitude, np.asarray(after, dtype=float) @ s.boundary)


def free_decay(
    rim: Rim,
    h_W_m2K: float,
    start: Array,
    time_s: float,
    mesh: Mesh = MESH_IV,
    profile: Profile = "modal",
) -> Array:
    """The field [K] that remains after ``time_s`` with boundary and ambient at zero.

    Parameters
    ----------
    rim
        Geometry and material.
    h_W_m2K
        Heat-transfer coefficient of the running surface [W/m2K].
    start
        Field at the start, (nr, nz) [K]. Its row at r = R_i is not used: the boundary is at zero.
    time_s
        Duration of the decay [s].
    mesh
        Nodes in r and z.
    profile
        Shape along r = R_i; without effect, because the boundary is at zero.

    Returns
    -------
    Field, (nr, nz) [K].

    Raises
    ------
    InputError
        ``start`` has not the shape of the mesh.

    Notes
    -----
    The half-width and the flux passed to ``spectrum`` are without effect, because there is no
    power. Guarded by ``tests/heat/test_rim_convergence.py`` and ``tests/heat/test_rim_fields.py``.
    """
    if start.shape != (mesh.nr, mesh.nz):
        raise InputError(
            f"the field has shape {start.shape}", expected=f"{(mesh.nr, mesh.nz)}: all nodes"
        )
    s = spectrum(rim, h_W_m2K, rim.width_m / 4, profile, "uniform", mesh)
    amplitude = np.linalg.solve(s.shape_r, np.linalg.solve(s.shape_z, start[1:].T).T)
    return _nodal_fields(s, amplitude * np.exp(-time_s * s.rates), np.zeros(mesh.nz))


def _nodal_fields(modes: Spectrum, amplitude: Array, inner: Array) -> Array:
    """Nodal fields from modal amplitudes and the imposed profile.

    Parameters
    ----------
    modes
        Modes.
    amplitude
        Modal amplitudes, (..., m, n).
    inner
        Temperature of each z node at r = R_i, (..., nz).

    Returns
    -------
    Fields, (..., nr, nz).
    """
    outer = modes.shape_r @ amplitude @ modes.shape_z.T
    inner_row = np.broadcast_to(inner[..., None, :], (*outer.shape[:-2], 1, inner.shape[-1]))
    return np.concatenate([inner_row, outer], axis=-2)
