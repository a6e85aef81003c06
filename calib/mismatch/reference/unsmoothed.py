"""What a captured motion lost as it was smoothed, so that it is not taken for noise.

The recording is a witness of it whose noise has nothing in common with that of the capture: with
the columns X that smoothing has of captured motion, and Z those of what the sensor put out, sizes k
that leave ``Z' (y - X k) = 0`` of the differences y are right however noisy the capture is, where
least squares would see its noise in X and in y as well.

References
----------
.. [1] J. D. Angrist, A. B. Krueger, "Instrumental variables and the search for identification",
   Journal of Economic Perspectives 15(4), 2001, pp. 69-85.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calib.effects import get_effect
from calib.effects.base import Column, State
from calib.recording import CHANNELS
from calib.types import FloatArray

SLUG = "reference_smoothing"

ANGLES = ("orientation", "orientation_fourth")
PLACES = ("position", "position_fourth")
"""Of what is missing of angles, which shows on the gyroscope alone, and of positions."""


def smoothing(state: State, left: FloatArray, *, placed: bool = True) -> dict[str, float]:
    """Return how much a captured motion was smoothed; nothing where that does not show.

    Parameters
    ----------
    state : State
        The captured motion at n points, with orientations.
    left : (n, 6) array
        Recording minus model.
    placed : bool
        Whether positions were captured too.
    """
    columns = get_effect(SLUG).columns
    seen = replace(
        state,
        force=state.force + left[:, :3],
        rate=state.rate + left[:, 3:],
        angular_acceleration=None,
        known_gradient=None,
    )
    captured, measured = (columns(own, {}) for own in (state, seen))
    found = _fitting(state, seen, captured, measured, left[:, 3:], ANGLES, 3)
    if placed:
        y = left[:, :3] - _made(captured, found, 0)
        found |= _fitting(state, seen, captured, measured, y, PLACES, 0)
    return found


def _fitting(
    state: State,
    seen: State,
    captured: Mapping[str, Column],
    measured: Mapping[str, Column],
    y: FloatArray,
    names: tuple[str, ...],
    first: int,
) -> dict[str, float]:
    """Return the size of that power of the frequency that leaves least on a triad; none at best.

    A filter begins with one of them: both at once say little of each.
    """
    most = {p.name: p.most for p in get_effect(SLUG).parameters}
    beside, known = _beside(state, first), _beside(seen, first)
    found, least = dict[str, float](), float(np.square(y).sum())
    for name in names:
        x = np.stack([*beside, _made(captured, {name: 1.0}, first)]).reshape(-1, y.size)
        z = np.stack([*known, _made(measured, {name: 1.0}, first)]).reshape(-1, y.size)
        size = np.linalg.norm(z, axis=1)
        if not size.all():
            continue  # it does not move
        z = z / size[:, None]
        sizes = np.linalg.lstsq(z @ x.T / size, z @ y.ravel(), rcond=1e-9)[0] / size
        left = float(np.square(y.ravel() - sizes @ x).sum())
        own = float(sizes[-1])
        if left < least and 0.0 < own <= (most[name] or np.inf):
            found, least = {name: own}, left
    return found


def smoothed_by(state: State, sizes: Mapping[str, float]) -> FloatArray:
    """Return what smoothing of these sizes leaves of recording minus model, (n, 6)."""
    if not sizes:
        return np.zeros((len(state.time), len(CHANNELS)))
    columns = get_effect(SLUG).columns(state, {})
    return np.hstack([_made(columns, sizes, first) for first in (0, 3)])


def _beside(state: State, first: int) -> list[FloatArray]:
    """Return what else the differences of a triad may have: biases, a matrix, a delay, an arm."""
    signal = state.force if first == 0 else state.rate
    every = np.column_stack((np.ones(len(signal)), signal))
    gains = [own[:, None] * axis for own in every.T for axis in np.eye(3)]
    arm = list(np.moveaxis(state.gradient, 2, 0)) if first == 0 else []
    return [*gains, state.derivative(signal), *arm]


def _made(columns: Mapping[str, Column], sizes: Mapping[str, float], first: int) -> FloatArray:
    """Return the sum of columns in these sizes on the triad that begins with a channel, (n, 3)."""
    some = next(iter(columns[ANGLES[0]].values()))
    out = np.zeros((len(some), 3))
    for k, channel in enumerate(CHANNELS[first : first + 3]):
        for name, size in sizes.items():
            if channel in columns[name]:
                out[:, k] += size * columns[name][channel]
    return out
