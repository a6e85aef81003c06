"""What drift makes of the changes within a rest, once its means are known.

A bias that drifts goes on within a rest as it does from rest to rest. Where rests are long and the
sensor is quiet, changes within them are drift, and the means of the rests foretell most of it: with
M the means of one channel and C its contrasts,

    C - Cov(C, M) Cov(M)^-1 M

is what is new in the contrasts, and even that is correlated. Taken for independent they say once
more what the means have said, and whatever is slow (a temperature, a fluctuation) is believed
twice.

References
----------
.. [1] Rasmussen, Williams, "Gaussian Processes for Machine Learning", 2006, eq. (A.6).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import linalg, sparse

from calib.mismatch.noise.sensornoise import DRIFT_TIME, LEAN, flicker_covariance
from calib.mismatch.rows.rows import UNKNOWN, Kind, Rows
from calib.recording import CHANNELS
from calib.types import FloatArray, IntArray

PARTS = (1 / 6, 1 / 2)
"""Where a cell of a rest is cut, in its length: what a turn leaves behind fades at its start. Means
and contrasts are sums over these parts."""

SLIGHT = 0.02
"""Share of the variance of contrasts up to which drift in them is not worth foretelling."""


class Foretold(NamedTuple):
    """Contrasts of one channel, numbered as such, as far as dense rows foretell them.

    ``weight`` is what each counts in that; ``root`` whitens what is left, in standard deviations.
    Beside white noise alone these are the roots of ``variance``.
    """

    contrast: IntArray
    mean: IntArray
    weight: FloatArray
    root: FloatArray
    variance: FloatArray

    def restricted(self, dense: IntArray, contrast: IntArray) -> Foretold | None:
        """Return the same with rows numbered as in these, which hold whole channels."""
        if self.mean[0] not in dense:
            return None
        places = np.searchsorted(contrast, self.contrast), np.searchsorted(dense, self.mean)
        return Foretold(*places, self.weight, self.root, self.variance)


class _Drifts(NamedTuple):
    """What one channel's means and contrasts have of drift, by kinds, and of white noise.

    Covariances of the means, of the contrasts with them, and of the contrasts: as flicker, as a
    walk, and as the sensor leans.
    """

    contrast: IntArray
    mean: IntArray
    white: FloatArray
    means: FloatArray
    crossed: FloatArray
    own: FloatArray
    noise: FloatArray


def foretold(rows: Rows, levels: FloatArray) -> tuple[Foretold, ...]:
    """Return what the means at rest foretell of the contrasts, for drift of these levels.

    The last is kept of each channel: where one's levels are tried, those of the others stay.
    """
    drifts = _all_drifts(rows)
    level = {c.name: value for c, value in zip(rows.components, levels, strict=True)}
    kept: dict[str, tuple[bytes, Foretold | None]] = rows.kept.setdefault("foretold", {})
    for name, drift in drifts.items():
        size = np.array([level.get(kind, 0.0) for kind in (*_kinds(name), f"{name} jitter")])
        if drift is not None and kept.get(name, (b"",))[0] != size.tobytes():
            kept[name] = size.tobytes(), _alone(drift, size[:3], float(size[3]))
    return tuple(known for _, known in kept.values() if known is not None)


def drift_in_contrasts(rows: Rows) -> FloatArray:
    """Return the variance (k, n) that each of k components gives n contrasts, for levels of one.

    None where nobody knows how much to expect of drift, as without a clock: how far a bias walks
    from rest to rest, changes within them do not say then.
    """
    out = np.zeros((len(rows.components), len(rows.residual) - rows.n_dense))
    number = {c.name: i for i, c in enumerate(rows.components)}
    if any(c.spread >= UNKNOWN for c in rows.components if c.name.endswith(" flicker")):
        return out
    for name, drift in _all_drifts(rows).items():
        if drift is None:
            continue
        for kind, own in zip(_kinds(name), drift.own, strict=True):
            if kind in number:
                out[number[kind], drift.contrast] = np.diag(own)
    return out


def lean_in_contrasts(rows: Rows) -> FloatArray:
    """Return the variance that a lean of one gives the contrasts, (n,)."""
    out = np.zeros(len(rows.residual) - rows.n_dense)
    for drift in _all_drifts(rows).values():
        if drift is not None:
            out[drift.contrast] = np.diag(drift.own[2])
    return out


def _kinds(channel: str) -> tuple[str, str, str]:
    """Return the components that change a channel within a rest, as `_Drifts` has them."""
    leaning = channel if channel.startswith("gyro") else "accel"
    return f"{channel} flicker", f"{channel} walk", f"{leaning} {LEAN}"


def _all_drifts(rows: Rows) -> dict[str, _Drifts | None]:
    """Return what there is of each channel; nothing where there is no rest, or no contrast."""
    if not rows.is_rest.any() or rows.n_dense == len(rows.residual):
        return {}
    if "drifts" not in rows.kept:
        rows.kept["drifts"] = {name: _drifts(rows, c) for c, name in enumerate(CHANNELS)}
    drifts: dict[str, _Drifts | None] = rows.kept["drifts"]
    return drifts


def _alone(drift: _Drifts, size: FloatArray, jitter: float) -> Foretold | None:
    """Return what is foretold on one channel; None where that is not worth it."""
    if not (np.einsum("k,kii->i", size, drift.own) > SLIGHT * drift.noise).any():
        return None
    means = drift.white + np.tensordot(size, drift.means, 1)
    means[np.diag_indices_from(means)] += jitter
    crossed = np.tensordot(size, drift.crossed, 1)
    weight = linalg.cho_solve(linalg.cho_factor(means), crossed.T).T
    left = np.tensordot(size, drift.own, 1) - weight @ crossed.T
    left[np.diag_indices_from(left)] += drift.noise
    variance = np.diag(left).copy()
    scale = np.sqrt(variance)
    root = linalg.cholesky(left / np.outer(scale, scale), lower=True, check_finite=False)
    root = linalg.lapack.dtrtri(root, lower=1)[0]
    return Foretold(drift.contrast, drift.mean, np.ascontiguousarray(weight), root, variance)


def _drifts(rows: Rows, c: int) -> _Drifts | None:
    own, start = rows.channel == c, rows.n_dense
    mean = np.flatnonzero(own[:start] & (rows.kind[:start] == Kind.MEAN))
    contrast = np.flatnonzero(own[start:])
    if len(mean) < 2 or not len(contrast):
        return None
    part, kernels = _parts(rows.interval.tobytes(), rows.is_rest.tobytes())
    lean = np.zeros_like(kernels[0]) if rows.lean is None else rows.lean.cut(PARTS).covariance(c)
    kernels = np.concatenate((kernels, lean[None]))
    begin, length = rows.interval[:, 0], np.ptp(rows.interval, axis=1)
    at = rows.point_segment
    place = (rows.state.time - begin[at]) / np.maximum(length[at], 1e-9)
    slot = part[at] + np.searchsorted(PARTS, place)
    still = np.flatnonzero(rows.is_rest[at])
    member = sparse.csr_matrix(
        (np.ones(len(still)), (still, slot[still])), shape=(len(at), kernels.shape[1])
    )
    felt = rows.functional[c] @ member
    # Each feels the parts of its own rest alone.
    of_means, of_contrasts = felt[mean], felt[start + contrast]
    means, contrasts = ([own @ k for k in kernels] for own in (of_means, of_contrasts))
    return _Drifts(
        contrast,
        mean,
        rows.white[np.ix_(mean, mean)],
        np.stack([(of_means @ k.T).T for k in means]),
        np.stack([(of_means @ k.T).T for k in contrasts]),
        np.stack([(of_contrasts @ k.T).T for k in contrasts]),
        rows.white_diagonal[contrast],
    )


@lru_cache(maxsize=1)
def _parts(interval: bytes, is_rest: bytes) -> tuple[IntArray, FloatArray]:
    """Return the first part of each segment, and how parts of rests drift together, (2, n, n).

    Flicker and walk of a level of one, as `sensornoise` has them of segments.
    """
    times, rest = np.frombuffer(interval).reshape(-1, 2), np.frombuffer(is_rest, bool)
    cuts = np.array([0.0, *PARTS, 1.0])
    first = (len(PARTS) + 1) * (np.cumsum(rest) - 1)
    start, length = times[rest, 0], np.ptp(times[rest], axis=1)
    middle = (start[:, None] + length[:, None] * 0.5 * (cuts[1:] + cuts[:-1])).ravel()
    size = (length[:, None] * np.diff(cuts)).ravel()
    walk = np.minimum.outer(middle - times[0, 0], middle - times[0, 0]) / DRIFT_TIME
    return np.asarray(first), np.stack((flicker_covariance(middle, size), walk))
