"""Maximum likelihood from |a| = g: every pose weighed by its noise, bumped poses left out."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular

from calib.errors import InsufficientMotionError, NotConvergedError
from calib.fit import Exclusion, Fit
from calib.poses import Poses
from calib.recording import AXES
from calib.solvers.accel_exact import ellipsoid
from calib.solvers.base import AccelSolver
from calib.solvers.determined import Determined, split
from calib.solvers.outliers import MANY, between_variance, find_outliers
from calib.solvers.quadric import (
    COLUMNS,
    NAMES,
    ROWS,
    fit_quadric,
    make_fit,
    parameters_of,
    triad_of,
)
from calib.types import BoolArray, FloatArray

PRIOR = np.repeat([1.0, 0.15, 0.15], 3)
"""How far bias (m/s²), scale factor error and misalignment may be off before any pose is seen: more
than in most parts. It is used only in directions that the poses do not determine."""
CHUNK = 8192
ITERATIONS = 50
WORTH = 3.0
"""Standard error of a direction, in parts of the prior, that is still worth having."""
SAMPLE = 300
"""Poses from which it is found what noise in the derivatives fakes."""
NEAR = 0.1
"""A step, in parts of the prior, from which on the solution is near."""
LEAST = 1e-300
"""Keeps divisions by the variance of noise-free data finite."""


@dataclass(frozen=True, eq=False)
class _Equations:
    """The problem linearised at some values: ``r + J dx = e``, ``var e = variance + t²``."""

    residual: FloatArray
    variance: FloatArray
    information: FloatArray
    gradient: FloatArray
    spurious: FloatArray
    """Information that the noise in J and the prior would fake."""


def solve(poses: Poses, *, gravity: float) -> Fit:
    """Estimate accelerometer bias, scale factor and misalignment from static poses.

    Model: ``measured = (I + S + M) @ true + bias + noise``, M strictly lower triangular,
    ``|true| = g``, each pose's direction unknown, ``cov noise`` as `Poses` gives it.

    With ``K = inv(I + S + M)``, ``f = K (a - b)`` and ``C = K cov K.T``, the likelihood maximised
    over each pose's direction leaves the weighted squares of ``|f| - g``:

    - its variance is ``u.T C u + t²``, u the pose's direction; t² is what poses differ by beyond
      their noise, estimated from the residuals;
    - noise across u lengthens f: its expectation ``(tr C - u.T C u) / 2g`` is taken off;
    - derivatives are taken at the point of the sphere nearest to f in the metric of the noise,
      where their error is not correlated with the residual.

    The last two are what an algebraic fit lacks at high noise. Gauss-Newton starts from ``exact``,
    or from an ideal sensor where the poses do not determine everything; then directions of the
    parameter space with no more information than noise alone would fake keep their prior value 0,
    and parameters that are mostly such are named.

    Parameters
    ----------
    poses : Poses
        Four or more; nine or more in general directions determine everything.
    gravity : float, m/s²

    Raises
    ------
    InsufficientMotionError
        If no parameter is determined; the message says what to record.
    NotConvergedError

    References
    ----------
    .. [1] W. A. Fuller, Measurement Error Models, 1987, section 3.2 (nonlinear functional model).
    .. [2] R. C. Paule, J. Mandel, J. Res. NBS 87(5), 1982 (t²); for outliers see `outliers`.
    """
    keep = np.ones(len(poses), bool)
    values = _start(poses, gravity)
    for _ in range(3):
        values, extra, equations, parts = _gauss_newton(poses, keep, values, gravity)
        out = _outliers(poses, equations, parts, values, gravity)
        if np.array_equal(out, ~keep):
            break
        keep = ~out
    undetermined = parts.undetermined
    advice = _advice(parts, values, gravity) if undetermined.any() else ()
    if undetermined.all():
        raise InsufficientMotionError(
            f"{len(poses)} pose{'s' if len(poses) != 1 else ''} seen, which determine no parameter "
            "of the accelerometer: " + "; ".join(advice)
        )
    return make_fit(
        "maximum_likelihood",
        poses,
        triad_of(values),
        parts.covariance,
        equations.residual,
        degrees_of_freedom=int(keep.sum()) - parts.basis.shape[1],
        condition_number=_condition(equations.information),
        undetermined=tuple(n for n, u in zip(NAMES, undetermined, strict=True) if u),
        advice=advice,
        excluded=_exclusions(poses, equations, keep, extra),
    )


def _start(poses: Poses, gravity: float) -> FloatArray:
    ideal = np.zeros(9)
    equations = _linearise(poses, np.ones(len(poses), bool), ideal, 0.0, gravity, project=False)
    if _split(equations, len(poses)).null.size:
        return ideal
    try:
        matrix, bias = ellipsoid(fit_quadric(poses.accel), gravity=gravity)
    except InsufficientMotionError:
        return ideal
    return parameters_of(matrix, bias)


def _gauss_newton(
    poses: Poses, keep: BoolArray, values: FloatArray, gravity: float
) -> tuple[FloatArray, float, _Equations, Determined]:
    """Return values, t², the equations there, and what is determined."""
    extra = 0.0
    rank = None
    for _ in range(ITERATIONS):
        # Far from the solution the derivatives are taken at the readings themselves: brought to the
        # sphere they would leave the plane or cone that they lie in, and seem to determine more.
        near = rank is not None
        equations = _linearise(poses, keep, values, extra, gravity, project=near)
        parts = _split(equations, int(keep.sum()), rank=rank)
        step = -parts.basis @ (parts.basis.T @ equations.gradient)
        # How far in standard errors; or in parts of what could be off, where there is no noise.
        far = float(step @ equations.information @ step)
        freedom = int(keep.sum()) - parts.basis.shape[1]
        new = between_variance(equations.residual[keep], equations.variance[keep], freedom)
        settled = abs(new - extra) <= 1e-3 * (new + float(equations.variance.mean()))
        if not near and np.abs(step / PRIOR).max() < NEAR:
            rank = parts.basis.shape[1]
        elif near and settled and (far < 1e-6 or np.abs(step / PRIOR).max() < 1e-12):
            return values, extra, equations, parts
        values, extra = values + step, new
    raise NotConvergedError(
        f"the accelerometer fit did not settle in {ITERATIONS} steps: these readings are far from "
        "those of an accelerometer at rest; look at the poses, or record again"
    )


def _split(equations: _Equations, count: int, *, rank: int | None = None) -> Determined:
    """Return what is determined: what `count` readings' noise fakes scatters by sqrt(2 / count)."""
    enough = 1 + 4 * np.sqrt(2 / max(count, 1))
    return split(equations.information, equations.spurious, PRIOR, enough=enough, rank=rank)


def _linearise(
    poses: Poses,
    keep: BoolArray,
    values: FloatArray,
    extra: float,
    gravity: float,
    *,
    project: bool,
) -> _Equations:
    n = len(poses)
    residual, variance = np.empty(n), np.empty(n)
    information, gradient = np.zeros((9, 9)), np.zeros(9)
    for begin in range(0, n, CHUNK):
        part = slice(begin, begin + CHUNK)
        r, v, jacobian = _rows(
            poses.accel[part], poses.accel_covariance[part], values, gravity, project=project
        )
        residual[part], variance[part] = r, v
        weight = keep[part] / np.maximum(v + extra, LEAST)
        weighted = jacobian * weight
        information += weighted @ jacobian.T
        gradient += weighted @ r
    spurious = np.diag((WORTH * PRIOR) ** -2.0) + _faked(
        poses, keep, values, variance + extra, gravity
    )
    return _Equations(residual, variance, information, gradient, spurious)


def _faked(
    poses: Poses, keep: BoolArray, values: FloatArray, variance: FloatArray, gravity: float
) -> FloatArray:
    """Return the information (9, 9) that noise in the derivatives fakes, from some of the poses."""
    few = np.flatnonzero(keep)
    few = few[:: max(1, len(few) // SAMPLE)]
    triad = triad_of(values)
    inverse = solve_triangular(triad.matrix, np.eye(3), lower=True)
    true = triad.correct(poses.accel[few])
    # d(row)/d(f) of the rows -K.T f / g and -(K.T f)_i f_j / g.
    gradient = np.empty((len(few), 9, 3))
    gradient[:, :3] = inverse.T
    gradient[:, 3:] = true[:, COLUMNS, None] * inverse.T[list(ROWS)]
    gradient[:, np.arange(3, 9), COLUMNS] += (true @ inverse)[:, ROWS]
    # A clipped channel that was corrected with the others leaves covariances of rank two.
    power, axes = np.linalg.eigh(poses.accel_covariance[few])
    root = axes * np.sqrt(np.maximum(power, 0.0))[:, None, :]
    noisy = gradient @ (inverse @ root) / gravity
    weight = 1.0 / np.maximum(variance[few], LEAST)
    share = float(keep.sum()) / max(len(few), 1)
    return np.asarray(share * np.einsum("n,npk,nqk->pq", weight, noisy, noisy), np.float64)


def _rows(
    accel: FloatArray, covariance: FloatArray, values: FloatArray, gravity: float, *, project: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return residuals, their variances, and J transposed (9, n)."""
    triad = triad_of(values)
    inverse = solve_triangular(triad.matrix, np.eye(3), lower=True)
    true = inverse @ (accel - triad.bias).T
    length = np.sqrt(np.einsum("in,in->n", true, true))
    normal = inverse.T @ (true / length)
    if covariance.strides[0] == 0:  # the same for all poses
        noise = covariance[0] @ normal
        trace = np.full(len(accel), np.sum((inverse @ covariance[0]) * inverse))
    else:
        noise = np.einsum("nij,jn->in", covariance, normal)
        trace = np.einsum("nij,ij->n", covariance, inverse.T @ inverse)
    variance = np.einsum("in,in->n", normal, noise)
    excess = length - gravity
    residual = excess - (trace - variance) / (2 * gravity)
    # The nearest point of the sphere in the metric of the noise, to first order; then onto it.
    if project:
        true -= inverse @ noise * (excess / np.maximum(variance, LEAST))
        true *= gravity / np.sqrt(np.einsum("in,in->n", true, true))
    normal = inverse.T @ (true / gravity)
    jacobian = np.empty((9, len(accel)))
    np.negative(normal, out=jacobian[:3])
    for p, (i, j) in enumerate(zip(ROWS, COLUMNS, strict=True), start=3):
        np.multiply(jacobian[i], true[j], out=jacobian[p])
    return residual, variance, jacobian


def _outliers(
    poses: Poses, equations: _Equations, parts: Determined, values: FloatArray, gravity: float
) -> BoolArray:
    if len(poses) > MANY:
        return find_outliers(equations.residual, np.zeros((len(poses), 0)), equations.variance)
    *_, jacobian = _rows(poses.accel, poses.accel_covariance, values, gravity, project=True)
    return find_outliers(equations.residual, jacobian.T @ parts.basis, equations.variance)


def _exclusions(
    poses: Poses, equations: _Equations, keep: BoolArray, extra: float
) -> tuple[Exclusion, ...]:
    sigma = np.sqrt(np.maximum(equations.variance + extra, LEAST))
    return tuple(
        Exclusion(
            (float(poses.interval[k, 0]), float(poses.interval[k, 1])),
            0.0,
            f"its length is {equations.residual[k]:+.4f} m/s² from gravity, where the other poses "
            f"scatter by {sigma[k]:.4f}: bumped, or not at rest",
        )
        for k in np.flatnonzero(~keep)
    )


def _condition(information: FloatArray) -> float:
    unit = 1.0 / np.sqrt(np.maximum(np.diag(information), LEAST))
    values = np.linalg.eigvalsh(information * unit[:, None] * unit)
    return float(np.sqrt(values[-1] / max(values[0], np.finfo(float).eps * values[-1])))


def _advice(parts: Determined, values: FloatArray, gravity: float) -> tuple[str, ...]:
    """Return which poses to add: of faces, edges and corners, those that see most of the rest."""
    signs = np.array([d for d in product((-1, 0, 1), repeat=3) if any(d)])
    count = np.abs(signs).sum(axis=1)
    up = signs / np.sqrt(count)[:, None]
    measured = triad_of(values).distort(gravity * up)
    identity = np.broadcast_to(1e-6 * np.eye(3), (len(up), 3, 3))
    *_, jacobian = _rows(measured, identity, values, gravity, project=True)
    seen = jacobian.T @ parts.null
    wanted: list[str] = []
    for _ in range(parts.null.shape[1]):
        # A face is easier to set up than an edge, an edge than a corner.
        strength = np.linalg.norm(seen, axis=1) / count
        best = int(np.argmax(strength))
        if strength[best] < 1e-3 * gravity:
            break
        direction = seen[best] / np.linalg.norm(seen[best])
        seen = seen - np.outer(seen @ direction, direction)
        axes = [
            f"{'+' if s > 0 else '-'}{a.upper()}"
            for s, a in zip(signs[best], AXES, strict=True)
            if s
        ]
        wanted.append(
            f"add a pose with {axes[0]} up"
            if len(axes) == 1
            else f"add a pose with {' and '.join(axes)} equally far up"
        )
    return tuple(wanted)


ACCEL_SOLVER = AccelSolver(
    "maximum_likelihood",
    "weighs every pose by its noise, leaves bumped poses out; holds at high noise (default)",
    solve,
)
