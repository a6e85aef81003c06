"""The best twin: one from the rests alone, then baseline and attitudes by robust Gauss-Newton."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import linalg

from calib.effects.base import State
from calib.mismatch.rows.closure import across
from calib.mismatch.rows.grid import Grid
from calib.mismatch.rows.rows import Rows
from calib.mismatch.twin.residuals import Linear, build_rows, linearise
from calib.mismatch.twin.twin import Twin, baseline_column
from calib.model import SensorModel, Triad
from calib.recording import CHANNELS
from calib.types import BoolArray, FloatArray, IntArray

# Weak knowledge that keeps the iteration steady where a recording says nothing: standard deviations
# many times what uncalibrated parts have.
_LOOSE = {"bias": 2.0, "scale_factor_error": 0.5, "misalignment": 0.3}

PART = 0.05
"""How far scale factors and angles may be off: some more than data sheets say (MPU-6050 product
specification rev. 3.4: 3 % of scale, 2 % across axes). Where nothing points along an axis, what its
noise seems to say of tilts would be a scale factor of one half."""

# Of an axis that hardly turned a gyroscope shows how the others turned, by the two per cent that
# axes lie askew. Its scale factor error would be -1 where it was taken to have turned by that.
_HARDLY = 0.02

FEW = 9
"""Poses below which what they differ by is anything: as many as an accelerometer has parameters."""

_OFF = 0.05
"""How far off means at rest may be, where a hand or a machine shakes them, in m/s². Beside them it
is that knowledge: of few poses they would make a twin of a hundred g, from which no fit returns."""


def _loose(names: Sequence[str], poses: int) -> FloatArray:
    """Return how far parameters may be, (p,), for a fit to so many poses."""
    known = dict(_LOOSE)
    if poses >= FEW:
        known |= {"scale_factor_error": PART, "misalignment": PART}
    out = np.array([known[n.split(".")[1]] for n in names])
    if poses >= FEW:
        out[[n.startswith("gyro.scale_factor_error") for n in names]] = _HARDLY
    return out


def start_twin(grid: Grid, model: SensorModel | None, *, gravity: float, full_gyro: bool) -> Twin:
    """Return a first twin: the given model, or one from the rests alone."""
    means = _pose_means(grid)
    expected = SensorModel() if model is None else model
    if model is None:
        model = SensorModel(gyro=Triad(bias=means[:, 3:].mean(axis=0)))
        if grid.temperature is not None:
            model = replace(model, reference_temperature=float(np.median(grid.temperature)))
    up = means[:, :3] - model.accel.bias
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    twin = Twin(model, up, full_gyro, gravity, expected)
    accel = [n for n in twin.names if n.startswith("accel")]
    k = len(up)
    loose = _loose(accel, k)
    for _ in range(12):
        matrix, bias = twin.model.accel.matrix, twin.model.accel.bias
        force = gravity * twin.up
        residual = means[:, :3] - force @ matrix.T - bias
        state = State(np.arange(k, dtype=float), force, np.zeros_like(force))
        design = np.zeros((k, 3, len(accel) + 2 * k))
        for j, name in enumerate(accel):
            for channel, values in baseline_column(name, state).items():
                design[:, CHANNELS.index(channel), j] = values
        turn = gravity * np.einsum("ij,kjl->kil", matrix, across(twin.up))
        for p in range(k):
            design[p, :, len(accel) + 2 * p : len(accel) + 2 * p + 2] = turn[p]
        flat = design.reshape(3 * k, -1)
        pull = twin.unexpected()[: len(accel)] / loose
        ridge = np.zeros((len(accel), flat.shape[1]))
        ridge[:, : len(accel)] = np.diag(1.0 / loose)
        step = np.linalg.lstsq(
            np.vstack((flat, _OFF * ridge)),
            np.concatenate((residual.ravel(), -_OFF * pull)),
            rcond=None,
        )[0]
        twin = twin.moved(
            dict(zip(accel, step[: len(accel)], strict=True)),
            step[len(accel) :].reshape(k, 2),
        )
        if np.abs(step).max() < 1e-9:
            break
    return twin


def _pose_means(grid: Grid) -> FloatArray:
    pose = grid.pose
    rest = pose >= 0
    weight = np.where(rest, grid.count, 0).astype(float)[rest]
    both = np.hstack((grid.accel, grid.gyro))[rest]
    total = np.bincount(pose[rest], weight, grid.n_poses)
    out = np.empty((grid.n_poses, 6))
    for c in range(6):
        out[:, c] = np.bincount(pose[rest], weight * both[:, c], grid.n_poses) / total
    return out


def fit_twin(
    grid: Grid,
    twin: Twin,
    noise: FloatArray,
    *,
    iterations: int = 8,
    drop: BoolArray | None = None,
) -> Twin:
    """Fit baseline and attitudes to the recording by robust Gauss-Newton.

    Closures that disagree with the rest by far (a bumped turn, lost samples) are down-weighted.
    Segments in `drop` (s,) are left out.
    """
    # What noise does to the rows hardly changes as the twin moves a little.
    linear: Rows | Linear = (rows := build_rows(grid, twin, noise))
    sigma = np.sqrt(rows.expected_variance())
    own = np.arange(len(sigma))
    if drop is not None:
        own = own[~drop[rows.segment[own]]]
    for k in range(iterations):
        linear = linearise(grid, twin) if k else linear
        twin, size = _step(linear, own, sigma[own], rows.kind[own], twin)
        if size < 1e-7:
            break
    return twin


def _step(
    linear: Rows | Linear, dense: IntArray, sigma: FloatArray, kinds: IntArray, twin: Twin
) -> tuple[Twin, float]:
    """Return the twin after a step that fits some of the dense rows, and how large a step it is."""
    p = len(twin.names)
    loose = _loose(twin.names, len(twin.up))
    design = np.hstack((linear.baseline[dense], linear.nuisance[dense])) / sigma[:, None]
    y = linear.residual[dense] / sigma
    ridge = np.zeros((p, design.shape[1]))
    ridge[:, :p] = np.diag(1.0 / loose)
    pull = -twin.unexpected() / loose
    weight = np.ones(len(dense))
    step = np.zeros(design.shape[1])
    for _ in range(4):
        root = np.sqrt(weight)
        # Pivoted QR: the rank may be short, but nobody needs singular values.
        step = linalg.lstsq(
            np.vstack((design * root[:, None], ridge)),
            np.append(y * root, pull),
            lapack_driver="gelsy",
            check_finite=False,
        )[0]
        left = np.abs(y - design @ step)
        # Each kind has its own scale: what the closures leave is not known beforehand.
        for kind in np.unique(kinds):
            own = kinds == kind
            scale = max(float(np.median(left[own])) / 0.6745, 1.0)
            weight[own] = np.minimum(1.0, 3.0 * scale / np.maximum(left[own], 1e-12)) / scale**2
    angles = step[p:].reshape(-1, 2)
    moved = twin.moved(dict(zip(twin.names, step[:p], strict=True)), np.clip(angles, -0.5, 0.5))
    return moved, float(np.abs(step).max())
