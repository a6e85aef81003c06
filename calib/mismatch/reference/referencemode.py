"""Diagnose a recording against a reference: motion capture, a table, another IMU on the same body.

The reference has a clock, a frame and a point of its own. Its time and the rotation between the
frames are found first, and fitted along with the sensor's baseline; where they are not zero they
are findings (`time_offset`, `clock_scale`, `reference_misalignment`), and so are a leaning vertical
(`reference_tilt`) and the lever arm between the two points (`accel_lever_arm`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from calib import faults
from calib.errors import EmptyRecordingError, InvalidSampleError, NoCommonMotionError
from calib.measured import measured
from calib.mismatch.findings.diagnosis import Diagnosis, summarise
from calib.mismatch.noise.hush import audible
from calib.mismatch.reference.against import OWN_AXES, at_rest, undetermined, unfit
from calib.mismatch.reference.alignment import Alignment, align
from calib.mismatch.reference.alike import check_apart, misleads
from calib.mismatch.reference.axes import has_the_others
from calib.mismatch.reference.band import BEYOND, Matched, limited, matched, narrowed
from calib.mismatch.reference.carried import known_errors, settled
from calib.mismatch.reference.comparison import ComparisonProblem
from calib.mismatch.reference.conclusion import conclude
from calib.mismatch.reference.corners import FEWEST
from calib.mismatch.reference.filters import filtered, low_passed, smoothed
from calib.mismatch.reference.misread import MisreadError, misread
from calib.mismatch.reference.mounted import UNLIKE, mounting
from calib.mismatch.reference.oriented import oriented_at_rests
from calib.mismatch.reference.seldom import TooFewError, check_enough
from calib.mismatch.reference.shaken import noise_beside
from calib.mismatch.reference.sharpened import Sharpen, sharpening
from calib.mismatch.reference.sized import with_scale
from calib.mismatch.reference.swaps import swapped
from calib.mismatch.reference.truths import DEGREE, LONG_STEP, RecordingTruth, is_uneven, near
from calib.mismatch.reference.upright import TIPPED, in_words, turn_up, vertical
from calib.mismatch.reference.witnessed import white_noise
from calib.mismatch.samples.found import Samples
from calib.mismatch.samples.reading import with_reading
from calib.mismatch.samples.samples import look_at_samples
from calib.model import SensorModel
from calib.recording import Recording
from calib.rotation import mat_from_quat, quat_multiply, rotate
from calib.simulation.bridges import HOLE, LOOSE
from calib.simulation.through import spline_through, turning_along
from calib.statics import find_poses
from calib.stillness import runs
from calib.threads import one_thread
from calib.timing import clock_errors, even_times
from calib.types import BoolArray, FloatArray

MISTAKEN = 0.2
"""Share of the reference's time for which that is no mistake about markers, but another unit."""

BRISK = 2.0
"""Times the fastest rate that the sensor saw at which nothing of the body turned."""

OPPOSITE = (
    "the accelerometers of the two have opposite signs: an accelerometer at rest reads 1 g upwards "
    "(+9.8 m/s² on the axis that is up); mend the one that does not"
)
"""Turns tell nothing of it: what is up and what is down turn alike."""

ROUGH, SLOW = 20.0, 5.0
"""Hz up to which a captured motion is aligned and its frame is found, noisy as its rates are; the
second where the first shows nothing in common. A hand turns slowly, and the noise of rates that
angles make grows with frequency."""

EXACT = 1e-4
"""Of a quaternion that no system sees, but that rounding to four digits leaves: a motion captured
is never so much about one axis, a table's profile is."""

ASTRAY = 0.05
"""Share of the signals' power that a reference in another world leaves at least: gravity that is
`TIPPED` leaves a tenth of its own."""

UP = "up"
"""Of the summary: the axis of the reference's world that is up, where that is not z."""

SWAPPED = "swapped_markers"
"""Of the summary: what was left out, as one marker was taken for another."""

JUMPS = "jumps"
"""Of the summary: what was left out, as the motion jumped between two samples there."""

NOT_OF_IMUS = ("earth_rate", "reference_tilt", "reference_smoothing")
"""What is not asked of two IMUs: on one body they turn with the Earth alike, know up from nothing
but each other, and neither was captured."""

MISPLACED = (
    "positions that are those of the sensor: these explain little of what its accelerometer felt, "
    "so they were left out; check their axes, their unit, and the order of the quaternion's columns"
)
"""What a reference lacks of which the positions mislead."""

SETUPS = ("time_offset", "clock_scale", "reference_misalignment")


class _Placed(NamedTuple):
    """A captured motion in the time of a recording, the frame ``mat``, and what that leaves."""

    reference: ReferenceMotion
    truth: RecordingTruth
    alignment: Alignment
    mat: FloatArray
    error: float


@dataclass(frozen=True, eq=False)
class ReferenceMotion:
    """What motion capture or a table says: orientations, and positions if it knows them.

    Parameters
    ----------
    time : (n,) array, s
        Increasing, on the reference's own clock.
    quat : (n, 4) array
        Scalar first, ``mat_ns`` or its inverse (the recording tells which); rows that are not
        finite, or zero, are gaps.
    position : (n, 3) array, m, or None
    fixed : bool
        Whether the body is said to turn about a fixed point, as on a table of several axes.

    Raises
    ------
    EmptyRecordingError, InvalidSampleError
        If there is nothing, or time does not increase.
    """

    time: FloatArray
    quat: FloatArray
    position: FloatArray | None = None
    fixed: bool = False

    def __post_init__(self) -> None:
        if not len(self.time):
            raise EmptyRecordingError("the reference holds no samples")
        step = np.diff(self.time)
        if (step <= 0).any():
            k = int(np.argmax(step <= 0)) + 1
            raise InvalidSampleError(
                f"the reference's time does not increase at sample {k}: {self.time[k]} s follows "
                f"{self.time[k - 1]} s"
            )

    @property
    def known(self) -> BoolArray:
        """Where the reference saw the body, (n,) bool."""
        good = np.isfinite(self.quat).all(axis=1) & self.quat.any(axis=1)
        if self.position is not None:
            good &= np.isfinite(self.position).all(axis=1)
        return np.asarray(good)

    @property
    def duration(self) -> float:
        """From the first to the last time at which the reference saw the body, s."""
        time = self.time[self.known]
        return float(time[-1] - time[0]) if len(time) else 0.0

    @property
    def placed(self) -> bool:
        """Whether it is known where the body's point is while it moves.

        It is where positions are given, or the point is fixed: that is said, or the body turns
        about one axis and nothing else, as a table does and nothing that is carried.
        """
        if self.position is not None or self.fixed:
            return True
        quat = self.quat[self.known]
        # Turns about one axis lie in a plane through the origin.
        return bool(np.linalg.eigvalsh(quat.T @ quat)[1] < EXACT**2 * len(quat))

    def evened(self) -> ReferenceMotion:
        """Return it with times of a steady clock, if what it saw was taken evenly."""
        time = even_times(self.time, self.quat * _one_sign(self.quat, self.known))
        return self if time is None else replace(self, time=time)

    def regular(self) -> ReferenceMotion:
        """Return it at even times, by splines through what it saw, if its own are uneven.

        Whatever filters it, or tells the colour of its noise, counts on even times.
        """
        good = self.known
        if good.sum() < FEWEST or not is_uneven(self.time):
            return self
        from scipy.interpolate import make_interp_spline

        interval = float(np.median(np.diff(self.time)))
        seen = self.time[good]
        even = seen[0] + interval * np.arange(int((seen[-1] - seen[0]) / interval) + 1)
        values = self.quat * _one_sign(self.quat, good)
        if self.position is not None:
            values = np.hstack((values, self.position))
        values = make_interp_spline(seen - seen[0], values[good], k=DEGREE)(even - seen[0])
        values[:, :4] /= np.linalg.norm(values[:, :4], axis=1, keepdims=True)
        k = np.clip(np.searchsorted(seen, even), 1, len(seen) - 1)
        before, after = even - seen[k - 1], seen[k] - even
        unseen = (before + after > LONG_STEP * interval) & (
            np.minimum(before, after) > 0.5 * interval
        )
        values[unseen] = np.nan
        position = None if self.position is None else values[:, 4:]
        return replace(self, time=even, quat=values[:, :4], position=position)

    def truth(
        self,
        *,
        gravity: float,
        bands: tuple[float, float] | None = None,
        sharper: Callable[[FloatArray], FloatArray] | None = None,
    ) -> RecordingTruth:
        """Return what a perfect sensor at its point, in its frame, would have recorded.

        With ``bands`` (Hz) positions and orientations pass low-passes before all else, and then
        what makes them ``sharper``, a response to frequencies (m,), Hz: (m, 2) of both.
        """
        # A third of a second to import.
        from scipy.interpolate import PchipInterpolator, make_interp_spline

        good = self.known
        least = FEWEST + 2 * LOOSE
        if good.sum() < least:
            raise NoCommonMotionError(
                f"the reference has {good.sum()} rows that can be used, expected at least {least}: "
                "give the motion at even steps, not only the corners of a profile"
            )
        first, last = np.flatnonzero(good)[[0, -1]]
        good = good[first : last + 1]
        time = self.time[first : last + 1]
        values = self.quat[first : last + 1] * _one_sign(self.quat[first : last + 1], good)
        if self.position is not None:
            values = np.hstack((values, self.position[first : last + 1]))
        if not good.all():
            values[~good] = PchipInterpolator(time[good], values[good])(time[~good])
            holes = ~good & near(time[good], time, HOLE)
            values[holes] = make_interp_spline(time[good], values[good], k=DEGREE)(time[holes])
            good = good | holes
        if bands is not None:
            cutoff = np.repeat(bands[::-1], [4, values.shape[1] - 4])
            values = smoothed(time, values, cutoff)
        if sharper is not None:
            of_each = [0] * 4 + [1] * (values.shape[1] - 4)
            values = filtered(time, values, lambda f: sharper(f)[:, of_each])
        # A cubic spline would lose 2 % of the acceleration of a tremor.
        since = time - time[0]
        turning = turning_along(spline_through(time, values[:, :4]), since)
        total = np.tile([0.0, 0.0, gravity], (len(time), 1))
        if self.position is not None:
            total += spline_through(time, values[:, 4:])(since, nu=2)
        force = np.einsum("nij,ni->nj", mat_from_quat(turning.quat), total)
        bridged = np.convolve(~good, np.ones(2 * LOOSE + 1), mode="same") > 0
        # At its ends the derivatives of a spline are loose.
        inner = slice(LOOSE, -LOOSE)
        recording = Recording(time[inner], force[inner], turning.rate[inner], "device")
        quat = turning.quat[inner]
        return RecordingTruth(recording, gravity, bridged[inner], quat, placed=self.placed)

    def inverted(self) -> ReferenceMotion:
        """Return the reference with the inverse orientations."""
        return replace(self, quat=self.quat * np.array([1.0, -1.0, -1.0, -1.0]))


def _one_sign(quat: FloatArray, good: BoolArray) -> FloatArray:
    """Return the signs (n, 1) that make neighbours alike, over what is not known too."""
    known = quat[good]
    flip = np.where(np.einsum("ij,ij->i", known[1:], known[:-1]) < 0, -1.0, 1.0)
    sign = np.ones((len(quat), 1))
    sign[good, 0] = np.concatenate(([1.0], np.cumprod(flip)))
    return sign


@one_thread()
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
    """
    faults.check_sizes(real, "the recording")
    if isinstance(reference, Recording):
        faults.check_sizes(reference, "the reference")
        check_apart(real, reference)
    read, given = measured(real), real
    real = read.recording
    if isinstance(reference, Recording):
        reference, stamps, *_ = measured(reference)
    else:
        reference, stamps = reference.evened(), reference.time
    clocks = np.hypot(clock_errors(read.stamps, real.time), clock_errors(stamps, reference.time))
    if isinstance(reference, ReferenceMotion):
        reference = reference.regular()
    heard = audible(real)
    poses = find_poses(heard)
    seen = with_reading(look_at_samples(real, poses), given, read)
    summary = summarise(real)
    if seen.fatal:
        return unfit(seen, summary)
    if isinstance(reference, Recording):
        still = at_rest(real, reference)
        if still:
            return undetermined(still, summary)
    elif reference.position is None:
        summary["position"] = (
            "not known: the point of the reference counts as at rest"
            if reference.placed
            else "not known: the accelerometer is judged only at rest"
        )
    try:
        problem, skip = compare_reference(real, reference, seen, gravity=gravity, model=model)
    except MisreadError as error:
        return unfit(seen._replace(findings=(error.finding, *seen.findings)), summary)
    except TooFewError as error:
        return undetermined(str(error), summary)
    missing: tuple[str, ...] = ()
    if (
        isinstance(reference, ReferenceMotion)
        and reference.position is not None
        and misleads(problem.time, problem.state(), problem.measured[:, :3])
    ):
        reference, missing = replace(reference, position=None), (MISPLACED,)
        problem, skip = compare_reference(real, reference, seen, gravity=gravity, model=model)
    summary |= problem.notes
    other = reference if isinstance(reference, Recording) else None
    noisy = noise_beside(heard, poses, other, problem.setup.alignment)
    found = conclude(
        problem,
        seen,
        summary,
        setups=SETUPS,
        clocks=clocks,
        another=isinstance(reference, Recording),
        noisy=noisy,
        skip=skip,
        missing=missing,
    )
    placed = isinstance(reference, ReferenceMotion) and reference.position is not None
    return with_scale(found, gravity=gravity) if placed else found


def compare_reference(
    real: Recording,
    reference: Recording | ReferenceMotion,
    seen: Samples,
    *,
    gravity: float,
    model: SensorModel | None = None,
) -> tuple[ComparisonProblem, tuple[str, ...]]:
    """Align a reference with a recording; return what to compare, and what cannot show."""
    problem, skip, _ = compared(real, reference, seen, gravity=gravity, model=model, judge=True)
    return problem, skip


def compared(
    real: Recording,
    reference: Recording | ReferenceMotion,
    seen: Samples,
    *,
    gravity: float,
    model: SensorModel | None = None,
    judge: bool = False,
) -> tuple[ComparisonProblem, tuple[str, ...], Recording | ReferenceMotion]:
    """Return what `compare_reference` does, and the reference as it was used.

    To ``judge`` the sensor by it, samples must be enough for its motion.
    """
    notes: dict[str, object] = {}
    other, white = None, None
    if isinstance(reference, Recording):
        known = look_at_samples(reference, find_poses(audible(reference)))
        if known.fatal:
            wrong = [f.sentence for f in known.findings]
            wrong += [
                f"{', '.join(u.channels)}: {u.follows.removeprefix('nothing: ')}"
                for u in known.unexplained
            ]
            raise NoCommonMotionError(
                "the reference cannot be trusted: " + "; ".join(dict.fromkeys(wrong))
            )
        reference = settled(reference)
        alignment = align(real.time, real.gyro, reference.time, reference.gyro)
        whole = RecordingTruth(reference, gravity)
        mat, error = mounting(real, whole, alignment)
        if error > ASTRAY:
            opposite = RecordingTruth(replace(reference, accel=-reference.accel), gravity)
            if UNLIKE * mounting(real, opposite, alignment)[1] < error:
                raise NoCommonMotionError(OPPOSITE)
        _refuse_misread(real, whole, alignment)
        other = known_errors(reference, mat, gravity=gravity)
        white = white_noise(real, reference)
        truth = RecordingTruth(reference, gravity, known.spoilt)
        common = matched(real, truth, alignment, mat, spoilt=seen.spoilt)
        common = common._replace(truth=oriented_at_rests(common.truth))
    else:
        common, alignment, mat, notes, reference = _captured(real, reference, gravity, seen.spoilt)
        if judge:
            check_enough(real, reference.truth(gravity=gravity), common)
    if common.jumps is not None and common.jumps.any():
        notes[JUMPS] = _left_out(real.time, common.jumps, common.jumps)
    sharpen: Sharpen | None = None
    if isinstance(reference, ReferenceMotion) and common.band and not _commanded(reference):
        sharpen = partial(_sharpened, reference, gravity, common.bands)
    compare = partial(
        ComparisonProblem,
        common.real,
        common.truth,
        alignment,
        gravity=gravity,
        model=model,
        mat_sr=mat,
        spoilt=common.spoilt,
        blur=common.blur,
        band=common.band,
        forces=common.bands[0],
        raw=real if common.limited else None,
        stuck=common.stuck,
        folded=common.folded,
        unknown=common.unknown,
        other=other,
        white=white,
        sharpen=sharpen,
        notes=notes,
    )
    problem = compare()
    if other is not None and has_the_others(problem.rows(), *other):
        problem = compare(own_axes=True, notes={**notes, OWN_AXES: True})
    skip = list(NOT_OF_IMUS) if isinstance(reference, Recording) else []
    if common.limited:
        # What both were limited to hides the sensor's own low-pass.
        skip.append("bandwidth")
    if common.blur:
        # Where samples do not resolve the motion, one that is lost cannot be told from motion.
        skip.append("dropped_samples")
    if isinstance(reference, ReferenceMotion) and _commanded(reference):
        skip.append("reference_smoothing")
    return problem, tuple(skip), reference


def _captured(
    real: Recording, reference: ReferenceMotion, gravity: float, spoilt: BoolArray
) -> tuple[Matched, Alignment, FloatArray, dict[str, object], ReferenceMotion]:
    """Align a captured motion, and limit both to the band that they share; say what is left out."""
    notes: dict[str, object] = {}
    ways = [_placed(real, way, gravity) for way in (reference, reference.inverted())]
    best = min(ways, key=lambda placed: placed.error)
    if best.error > ASTRAY:
        for way in ways:
            up = _up(real, way)
            if up is not None and (other := _turned(real, way, up, gravity)).error < best.error:
                best, notes[UP] = other, in_words(up)
    reference, truth, alignment, mat, _ = best
    slow = replace(truth, recording=low_passed(truth.recording, ROUGH))
    _refuse_misread(low_passed(real, ROUGH), slow, alignment)
    bad = swapped(reference.time, reference.quat, real, alignment, mat)
    if bad.any():
        at = alignment.moments(reference.time)
        notes[SWAPPED] = _left_out(at, bad, bad & reference.known)
        seen = replace(reference, quat=np.where(bad[:, None], np.nan, reference.quat))
        reference, truth, alignment, mat, _ = _placed(real, seen, gravity)
    forces = reference.position is not None
    common = matched(real, truth, alignment, mat, spoilt=spoilt, forces=forces)
    if common.band and BEYOND * common.bands[0] < 0.5 / truth.recording.interval:
        truth = reference.truth(gravity=gravity, bands=_beyond(common.bands))
        spoilt = spoilt if common.jumps is None else spoilt | common.jumps
        kept = limited(real, truth, common.band, spoilt)
        common = kept._replace(
            forces=common.forces, folded=common.folded, jumps=common.jumps, jerky=common.jerky
        )
    return common, alignment, mat, notes, reference


def _commanded(reference: ReferenceMotion) -> bool:
    """Whether it is the motion of a table, which is commanded and not captured."""
    return reference.position is None and reference.placed


def _sharpened(
    reference: ReferenceMotion,
    gravity: float,
    bands: tuple[float, float],
    sizes: Mapping[str, float],
) -> RecordingTruth:
    """Return a captured motion in these bands, with what such a smoothing took put back."""
    interval = float(np.median(np.diff(reference.time)))
    response = partial(sharpening, sizes=sizes, bands=bands, interval=interval)
    truth = reference.truth(gravity=gravity, bands=_beyond(bands), sharper=response)
    return narrowed(truth, bands[1])


def _beyond(bands: tuple[float, float]) -> tuple[float, float]:
    return BEYOND * bands[0], BEYOND * bands[1]


def _refuse_misread(real: Recording, truth: RecordingTruth, alignment: Alignment) -> None:
    wrong = misread(real, truth, alignment, other="reference")
    if wrong is not None:
        raise MisreadError(wrong)


def _left_out(time: FloatArray, bad: BoolArray, missing: BoolArray) -> dict[str, object]:
    """Return how many samples are missing, and when they are bad, in the recording's time (n,)."""
    edges = np.stack(runs(bad), axis=1) - [0, 1]
    return {"samples": int(missing.sum()), "intervals": time[edges].round(3).tolist()}


def _placed(real: Recording, reference: ReferenceMotion, gravity: float) -> _Placed:
    try:
        return _placed_below(ROUGH, real, reference, gravity)
    except NoCommonMotionError:
        return _placed_below(SLOW, real, reference, gravity)


def _placed_below(
    bandwidth: float, real: Recording, reference: ReferenceMotion, gravity: float
) -> _Placed:
    truth = reference.truth(gravity=gravity)
    rough = replace(truth, recording=low_passed(truth.recording, bandwidth))
    known = rough.recording.time[truth.covers(truth.recording.time)]
    if len(known) < 2:
        raise NoCommonMotionError(
            "the reference is torn by gaps: it is nowhere free of them for long enough to be "
            "compared, expected some seconds"
        )
    rate = rough.state(known).rate
    # Faster than the sensor ever turned: markers that were taken for one another.
    speed, most = np.linalg.norm(rate, axis=1), float(np.linalg.norm(real.gyro, axis=1).max())
    if np.mean(speed > BRISK * most) > MISTAKEN:
        raise NoCommonMotionError(
            f"the reference turns by up to {float(speed.max()) / max(most, 1e-12):.3g} times what "
            "the recording ever does: check the unit of its angles or rates (degrees or radians; "
            "1 rad is 57.3 degrees), and that of its times"
        )
    rate[speed > BRISK * most] = 0.0
    alignment = align(real.time, real.gyro, known, rate)
    return _Placed(reference, truth, alignment, *mounting(real, rough, alignment))


def _up(real: Recording, placed: _Placed) -> FloatArray | None:
    """Return what is up in the reference's world, if that can be told and is not z."""
    at = placed.alignment.times(real.time)
    inside = placed.truth.covers(at)
    state = placed.truth.state(at[inside])
    if not inside.any() or state.mat_ns is None:
        return None
    up = vertical(state.mat_ns, state.rate, real.gyro[inside], real.accel[inside])
    return None if up is None or up[2] > np.cos(TIPPED) else up


def _turned(real: Recording, placed: _Placed, up: FloatArray, gravity: float) -> _Placed:
    """Return a reference of which the world is turned, so that `up` is z."""
    seen, turn = placed.reference, turn_up(up)[None]
    turned = replace(
        seen,
        quat=quat_multiply(turn, seen.quat),
        position=None if seen.position is None else rotate(turn, seen.position),
    )
    return _placed(real, turned, gravity)
