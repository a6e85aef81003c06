"""Rests of a recording that is compared: where what effects are functions of is still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib.effects.base import State
from calib.poses import Poses
from calib.recording import Recording
from calib.statics import find_poses
from calib.types import BoolArray, FloatArray, IntArray

BIASED = 0.5
"""rad/s that no gyroscope shows at rest: data sheets allow 20 dps an axis."""


def find_rests(recording: Recording) -> Poses:
    """Return the static poses of a recording in rad/s, without turns at one speed.

    On a table that spins about the vertical nothing that a sensor reads changes either.
    """
    poses = find_poses(recording)
    return poses.select(np.linalg.norm(poses.gyro, axis=1) < BIASED)


def resting(time: FloatArray, shaken: Recording, *, felt: float) -> BoolArray:
    """Return which of (n,) times are at rest, and so far (s) from motion that none is felt."""
    out = np.zeros(len(time), bool)
    poses = find_rests(shaken)
    for a, b in zip(poses.start, poses.stop, strict=True):
        out |= (time >= shaken.time[a] + felt) & (time <= shaken.time[b - 1] - felt)
    return out


def stilled(state: State, rests: IntArray, *, ramp: int = 0) -> State:
    """Return a state that is still in its (k, 2) rests, samples ``[first, last)``.

    It comes to rest within `ramp` samples: a step is faster than what a band has.
    """
    if not len(rests):
        return state
    force, rate = state.force.copy(), state.rate.copy()
    turning, gradient = state.rate_dot.copy(), state.gradient.copy()
    mat = None if state.mat_ns is None else state.mat_ns.copy()
    for a, b in rests:
        if b > a:
            end = np.minimum(np.arange(b - a), np.arange(b - a)[::-1]) + 1.0
            still = 0.5 - 0.5 * np.cos(np.pi * np.minimum(end / (ramp + 1.0), 1.0))[:, None]
            for values in (force, rate):
                values[a:b] += still * (values[a:b].mean(axis=0) - values[a:b])
            turning[a:b], gradient[a:b] = 0.0, 0.0
            if mat is not None:
                u, _, vt = np.linalg.svd(mat[a:b].mean(axis=0))
                mat[a:b] = u @ vt
    return replace(
        state,
        force=force,
        rate=rate,
        mat_ns=mat,
        angular_acceleration=turning,
        known_gradient=gradient,
    )


def gradient_in(mat: FloatArray, given: FloatArray | None, rests: IntArray) -> FloatArray | None:
    """Return a truth's gradient in frame `mat`, without what squares of its noise are at rest."""
    if given is None:
        return None
    still = [given[a:b].sum(axis=0) for a, b in rests if b > a]
    if still:
        given = given - np.sum(still, axis=0) / np.maximum(np.diff(rests), 0).sum()
    return np.asarray(mat @ given @ mat.T)
