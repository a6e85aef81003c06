"""Diagnose a recording against a reference: motion capture, a table, another IMU on the same body.

The reference has a clock, a frame and a point of its own. Its time and the rotation between the
frames are found first, and fitted along with the sensor's baseline; where they are not zero they
are findings (`time_offset`, `clock_scale`, `reference_misalignment`), and so are a leaning vertical
(`reference_tilt`) and the lever arm between the two points (`accel_lever_arm`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib.errors import NoCommonMotionError
from calib.mismatch.against import (
    at_rest,
    conclude,
    summarise,
    undetermined,
    unfit,
)
from calib.mismatch.alignment import Alignment, align
from calib.mismatch.band import Matched, common_band, limited, low_passed_as_motion, matched
from calib.mismatch.comparison import ComparisonProblem, Truth
from calib.mismatch.diagnosis import Diagnosis
from calib.mismatch.samples import Samples, look_at_samples
from calib.mismatch.truths import MotionTruth, RecordingTruth
from calib.model import SensorModel
from calib.recording import Recording
from calib.statics import find_poses
from calib.types import BoolArray, FloatArray

UNTURNED = 1e-3
"""Weight of no rotation in a mounting, relative to what was measured."""

SETUPS = ("time_offset", "clock_scale", "reference_misalignment")


@dataclass(frozen=True, eq=False)
class ReferenceMotion:
    """What motion capture or a table says: orientations, and positions if it knows them.

    Parameters
    ----------
    time : (n,) array, s
        Increasing, on the reference's own clock.
    quat : (n, 4) array
        Scalar first, ``mat_ns`` or its inverse (the recording tells which); rows that are not
        finite are gaps.
    position : (n, 3) array, m, or None
    """

    time: FloatArray
    quat: FloatArray
    position: FloatArray | None = None

    @property
    def known(self) -> BoolArray:
        """Where the reference saw the body, (n,) bool."""
        good = np.isfinite(self.quat).all(axis=1)
        if self.position is not None:
            good &= np.isfinite(self.position).all(axis=1)
        return np.asarray(good)

    def truth(self, *, gravity: float, bandwidth: float | None) -> MotionTruth:
        """Return the motion, band-limited."""
        from calib.simulation.recorded import motion_from_reference  # a second to import

        good = self.known
        if good.sum() < 4:
            raise ValueError(f"the reference has {good.sum()} finite rows, expected at least four")
        time = self.time[good]
        quat = self.quat[good]
        flip = np.where(np.einsum("ij,ij->i", quat[1:], quat[:-1]) < 0, -1.0, 1.0)
        quat = quat * np.concatenate(([1.0], np.cumprod(flip)))[:, None]
        # A filter needs even samples: gaps are bridged, and not compared.
        whole = self.time[(self.time >= time[0]) & (self.time <= time[-1])]
        position = None
        if self.position is not None:
            position = _bridged(time, self.position[good], whole)
        motion = motion_from_reference(
            whole,
            _bridged(time, quat, whole),
            position,
            gravity=gravity,
            bandwidth=bandwidth,
        )
        if bandwidth is not None:
            reach = 1.0 / bandwidth
            edges = np.append(self.time[~good], (time[0], time[-1]))
            edges.sort()
            after = np.clip(np.searchsorted(edges, time), 1, len(edges) - 1)
            away = np.minimum(np.abs(edges[after] - time), np.abs(time - edges[after - 1]))
            time = time[away > reach]
            if len(time) < 4:
                raise NoCommonMotionError(
                    "the reference lost the body too often: there is no stretch of "
                    f"{2 * reach:.2g} s without a gap"
                )
        return MotionTruth(motion, time, float(whole[0]))

    def inverted(self) -> ReferenceMotion:
        """Return the reference with the inverse orientations."""
        return replace(self, quat=self.quat * np.array([1.0, -1.0, -1.0, -1.0]))


def _bridged(time: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    return np.stack([np.interp(at, time, column) for column in values.T], axis=1)


def diagnose_reference(
    real: Recording,
    reference: Recording | ReferenceMotion,
    *,
    gravity: float,
    model: SensorModel | None = None,
) -> Diagnosis:
    """Find what a recording has that a reference of its motion lacks.

    Raises
    ------
    NoCommonMotionError
        If the two do not show the same motion.
    ValueError
        If the reference has fewer than four finite rows.
    """
    seen = look_at_samples(real, find_poses(real))
    summary = summarise(real)
    if seen.fatal:
        return unfit(seen, summary)
    if isinstance(reference, Recording):
        still = at_rest(real, reference)
        if still:
            return undetermined(still, summary)
    elif reference.position is None:
        summary["position"] = "not known: the point of the reference counts as at rest"
    problem, skip = compare_reference(real, reference, seen, gravity=gravity, model=model)
    return conclude(problem, seen, summary, setups=SETUPS, skip=skip)


def compare_reference(
    real: Recording,
    reference: Recording | ReferenceMotion,
    seen: Samples,
    *,
    gravity: float,
    model: SensorModel | None = None,
) -> tuple[ComparisonProblem, tuple[str, ...]]:
    """Align a reference with a recording; return what to compare, and what cannot show."""
    if isinstance(reference, Recording):
        poses = find_poses(reference)
        alignment = align(real.time, real.gyro, reference.time, reference.gyro)
        mat = mounting(real, RecordingTruth(reference, gravity), alignment)[0]
        known = look_at_samples(reference, poses)
        if known.fatal:
            raise NoCommonMotionError(
                "the reference cannot be trusted: "
                + "; ".join(f.sentence for f in known.findings or ())
            )
        common = matched(
            real,
            reference,
            poses,
            alignment,
            mat,
            gravity=gravity,
            spoilt=seen.spoilt,
            other_spoilt=known.spoilt,
        )
    else:
        common, alignment, mat = _captured(real, reference, gravity, seen.spoilt)
    problem = ComparisonProblem(
        common.real,
        common.truth,
        alignment,
        gravity=gravity,
        model=model,
        mat_sr=mat,
        spoilt=common.spoilt,
        blur=common.blur,
        passed=common.passed,
    )
    # What both were limited to hides the sensor's own low-pass.
    # Where samples do not resolve the motion, one that is lost cannot be told from motion either.
    return problem, (("bandwidth", "dropped_samples") if common.limited else ())


def _captured(
    real: Recording, reference: ReferenceMotion, gravity: float, spoilt: BoolArray
) -> tuple[Matched, Alignment, FloatArray]:
    """Align a captured motion, and limit both to the band that they share."""
    found: tuple[float, ReferenceMotion, Alignment, FloatArray] | None = None
    for item in (reference, reference.inverted()):
        truth = item.truth(gravity=gravity, bandwidth=None)
        rough = item.truth(gravity=gravity, bandwidth=20.0)
        known = truth.known
        alignment = align(real.time, real.gyro, known, rough.state(known).rate)
        mat, error = mounting(real, rough, alignment)
        if found is None or error < found[0]:
            found = (error, item, alignment, mat)
    assert found is not None
    _, item, alignment, mat = found
    truth = item.truth(gravity=gravity, bandwidth=None)
    bandwidth = common_band(real, truth, alignment, mat, forces=item.position is not None)
    if bandwidth is None:
        return Matched(real, truth, spoilt), alignment, mat
    truth = item.truth(gravity=gravity, bandwidth=bandwidth)
    return limited(real, truth, bandwidth, spoilt, low_passed_as_motion), alignment, mat


def mounting(real: Recording, truth: Truth, alignment: Alignment) -> tuple[FloatArray, float]:
    """Return the rotation from the truth's frame to s, and the share of rotation that it leaves.

    Wahba's problem over rates and specific forces, by singular values.

    References
    ----------
    .. [1] F. L. Markley, "Attitude determination using vector observations and the singular value
       decomposition", J. Astronaut. Sci. 36, 1988, p. 245.
    """
    at = alignment.times(real.time)
    inside = truth.covers(at)
    state = truth.state(at[inside])
    gyro = real.gyro[inside] - np.median(real.gyro[inside], axis=0)
    rate = state.rate - np.median(state.rate, axis=0)
    product = gyro.T @ rate / max(float(np.square(rate).sum()), 1e-12)
    product += real.accel[inside].T @ state.force / float(np.square(state.force).sum())
    # A turn that nothing tells of (heading, on a table) is none.
    product += UNTURNED * np.linalg.norm(product) * np.eye(3)
    u, _, vt = np.linalg.svd(product)
    mat = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    left = np.square(gyro - rate @ mat.T).sum() / max(float(np.square(gyro).sum()), 1e-12)
    return mat, float(left)
