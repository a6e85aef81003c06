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

SURE = 3.0
"""Standard errors, those of white noise, below which a size is none."""

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
    """Return the size of that power of the frequency that a triad shows; none at best.

    A filter begins with one of them: both at once say little of each. It is the one beside which
    both instruments see less, however noisy the capture is; and there is none where what is
    left without it is less.
    """
    most = {p.name: p.most for p in get_effect(SLUG).parameters}
    beside, known = _beside(state, first), _beside(seen, first)
    both = [_made(measured, {name: 1.0}, first) for name in names]
    every = np.stack([*known, *both]).reshape(-1, y.size)
    size = np.linalg.norm(every, axis=1)
    if not size.all():
        return {}  # it does not move
    every = every / size[:, None]
    basis = np.linalg.qr(every.T)[0]
    found, least, gains = dict[str, float](), np.inf, False
    for k, name in enumerate(names):
        own = [*range(len(known)), len(known) + k]
        x = np.stack([*beside, _made(captured, {name: 1.0}, first)]).reshape(-1, y.size)
        z = every[own]
        match = np.linalg.pinv(z @ x.T / size[own], rcond=1e-9)
        sizes = match @ (z @ y.ravel()) / size[own]
        left = y.ravel() - sizes @ x
        error = np.linalg.norm(match[-1] @ z) / size[own][-1] * left.std()
        told = float(sizes[-1])
        seen_of = float(np.square(basis.T @ left).sum())
        if not SURE * error < told <= (most[name] or np.inf):
            continue
        gains = gains or float(left @ left) < float(np.square(y).sum())
        if seen_of < least:
            found, least = {name: told}, seen_of
    return found if gains else {}


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
