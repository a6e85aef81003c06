"""A recording against a truth that something else measured: a simulation, or a reference.

``real(t) = model(x(t + offset + stretch (t - middle))) + noise``, x the truth. The differences are
not judged sample by sample: in each window and on each channel they are projected on its mean and
on the few shapes that the sensor's baseline, the alignment and the catalogue can have there. Those
projections are the rows; what is left of the samples is white noise, and gives its level.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from scipy import sparse

from calib.effects import get_effect
from calib.effects.base import Column, State, Term
from calib.effects.observed import observed
from calib.errors import NoCommonMotionError
from calib.faults import noise_at_rest, resolution, values_of
from calib.mismatch.findings.diagnosis import Unexplained
from calib.mismatch.reference.alignment import LEAST_OVERLAP, Alignment
from calib.mismatch.reference.alike import check_motion, check_units
from calib.mismatch.reference.band import BEYOND
from calib.mismatch.reference.captured import Known, known_noise
from calib.mismatch.reference.carried import (
    NAMES,
    SEEN,
    SIZES,
    arm_of,
    arm_term,
    carried,
    rough_arm,
    true_force,
)
from calib.mismatch.reference.colour import (
    WHITE,
    Blur,
    Colour,
    gaussian,
    whitening,
)
from calib.mismatch.reference.filters import FELT
from calib.mismatch.reference.floor import with_rounding
from calib.mismatch.reference.given import Further, further_columns, further_of, moved_terms
from calib.mismatch.reference.lateness import LATE, delaying, liveliest, rough_delay
from calib.mismatch.reference.noises import Differences, find_noise, wandering
from calib.mismatch.reference.scatter import scatter, silenced
from calib.mismatch.reference.sensed import (
    ALWAYS_MOVING,
    find_stillness,
    find_warmth,
    vibration,
)
from calib.mismatch.reference.setup import (
    ACCEL_ANGLES,
    BASELINE,
    GYRO_ANGLES,
    GYRO_TERM,
    LOOSE,
    Setup,
)
from calib.mismatch.reference.shapes import Shapes, find_shapes
from calib.mismatch.reference.sharpened import Sharpen, Sharpened, completed, dulled, lost_by
from calib.mismatch.reference.slips import find_slips
from calib.mismatch.reference.steadied import Steady, steadied
from calib.mismatch.reference.step import robust_step
from calib.mismatch.reference.stilled import gradient_in, resting, stilled
from calib.mismatch.reference.struck import struck
from calib.mismatch.reference.truths import RecordingTruth
from calib.mismatch.reference.unsmoothed import SLUG, smoothing
from calib.mismatch.reference.visible import catalogue_shapes
from calib.mismatch.reference.windowed import make_rows, seen_of, swayed_by
from calib.mismatch.reference.witnessed import between, shared, witnessed
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.accepted import UNLIKE
from calib.mismatch.twin.twin import baseline_column
from calib.model import SensorModel
from calib.recording import AXES, CHANNELS, Recording
from calib.types import BoolArray, FloatArray, IntArray

LEAST_GAIN = 0.5
"""What a sensor makes at least of its true signals."""

SAME = 0.3
"""Standard deviations by which no row has moved since windows and shapes were found: what is fitted
is among the shapes, and these would be the same now."""

STEPS = 8
"""Of the first fit, at most."""

COLOURED = 4
"""Step of the first fit before which the colour of noise is looked for: a sensor that swings is not
where it belongs after two, and what it is off by is no noise."""

LONG = 0.2
"""m: how far off the point that a truth describes a sensor may be where the motion does not tell:
along the axis of all turns."""


class ComparisonProblem:
    """Rows of a recording against a truth, under a sensor model that is fitted to it.

    Parameters
    ----------
    real : Recording
    truth : RecordingTruth
    alignment : Alignment
    gravity : float, m/s²
    model : SensorModel, optional
        Where the baseline starts. The angles of its gyroscope are fitted too if it has them, and
        its further terms, but for what acts on finished signals.
    mat_sr : (3, 3) array, optional
        From the truth's frame to s. Given, its three angles are fitted; else the frames are one.
    spoilt : (n,) array of bool, optional
        Samples that no model explains (clipped, repeated).
    blur : float, s
        Standard deviation of the Gaussian through which the differences are seen; 0 is none.
    band : float, Hz
        Cut-off of the low-pass that both have passed; 0 is none. What it leaves of the noise of
        derivatives (a captured motion's) grows with frequency, and is made white again.
    forces : float, Hz
        Up to where the accelerometer is seen, if that is lower; 0 is none.
    raw : Recording, optional
        The recording before it was limited to what a truth with noise knows. It shows how the
        sensor vibrates, and when it is at rest: what effects are functions of is still then. Noise
        that is in the differences and in a column as well would be a scale factor error of that
        rest. The differences keep it: it is white there.
    stuck : six sparse matrices, optional
        By how much rounding may be off, as `calib.mismatch.reference.floor.Heard` has it.
    folded : (n, 2) array, optional
        Power of the motion beyond the band, of both triads, as `Matched` has it.
    unknown : (n,) array of bool, optional
        Samples that say nothing, as their truth is not known. They are no gap: what acts on whole
        signals takes them as they are.
    other : two (18,) arrays, optional
        Of another IMU as the truth, or of a simulated one beside an arm: its errors, and how far
        they may be off (`known_errors`, `simulated_errors`).
    white : (2, 2) array, optional
        Densities of the noise of both, where the truth is a sensor's as well (`white_noise`).
    own_axes : bool
        Whether the accelerometer may be turned against the frame of the truth, all nine numbers of
        its matrix being fitted.
    sharpen : Sharpen, optional
        What makes the truth what it was before it was smoothed, if it may have been.
    notes : mapping, optional
        What was done to the truth before, for the summary.
    """

    reference = True
    moves_signals = True
    late: float
    """By how much a gyroscope is roughly late, where a derivative would not do, s; else 0."""

    def __init__(
        self,
        real: Recording,
        truth: RecordingTruth,
        alignment: Alignment,
        *,
        gravity: float,
        model: SensorModel | None = None,
        mat_sr: FloatArray | None = None,
        spoilt: BoolArray | None = None,
        blur: float = 0.0,
        band: float = 0.0,
        forces: float = 0.0,
        raw: Recording | None = None,
        stuck: tuple[sparse.csr_matrix, ...] = (),
        folded: FloatArray | None = None,
        unknown: BoolArray | None = None,
        other: tuple[FloatArray, FloatArray] | None = None,
        white: FloatArray | None = None,
        own_axes: bool = False,
        sharpen: Sharpen | None = None,
        notes: Mapping[str, object] | None = None,
    ) -> None:
        self.notes = notes or {}
        self.truth, self.gravity = truth, gravity
        self.sharpened = Sharpened(truth, sharpen)
        self._states: list[tuple[Setup, dict[str, float], State]] = []
        self.smoothed: dict[str, float] = {}
        self.turned = mat_sr is not None
        self.index = _common(real, truth, alignment, spoilt)
        self.time = real.time[self.index]
        self.stuck = tuple(own[self.index] for own in stuck)
        self.folded = None if folded is None else folded[self.index]
        self.unknown = None if unknown is None else unknown[self.index]
        self.band, self.interval, self.unresolved = band, real.interval, blur > 0
        self.bands = forces or band, band
        self.judged: BoolArray | None = None
        self.measured = np.hstack((real.accel, real.gyro))[self.index]
        self.warmth = find_warmth(real, self.time)
        start = SensorModel() if model is None else model
        if model is None and self.warmth.typical is not None:
            start = replace(start, reference_temperature=self.warmth.typical)
        self.noisy = raw is not None
        shaken = real if raw is None else raw
        self.thin = max(1, round(real.interval / shaken.interval))
        self.sampling = shaken.interval
        self.still, self.struck = ALWAYS_MOVING, None
        # Its noise is that of orientations: rates of another sensor have noise of their own.
        self.captured = band > 0 and truth.quat is not None and other is None and white is None
        if raw is not None:
            self.still = find_stillness(raw, self.time, band=band if self.captured else 0.0)
            self.struck = struck(raw, self.time, self.bands) if self.captured else None
        if not truth.placed:
            self.judged = resting(self.time, shaken, felt=FELT / band if band else 0.0)
        self.blur = self._judging(
            whitening(self.time, [WHITE, WHITE], self.interval, self.bands)
            if band
            else gaussian(self.time, blur, real.interval)
        )
        self.coarse = _coarse(shaken, *([] if white is None else [truth.recording]))
        at_rest = self.still.gyro
        bias = np.median(at_rest, axis=0) if len(at_rest) else start.gyro.bias
        self.vibration = vibration(shaken, self.time, bias=bias)
        self.given, self.rough = start.terms, tuple[Term, ...]()
        self.further: list[Further] = []
        self.power_on = float(real.time[0])
        mat = np.eye(3) if mat_sr is None else mat_sr
        self.white, self.carries = white, other is not None
        errors, own = (np.zeros(len(NAMES)), np.zeros(0)) if other is None else other
        self.setup = Setup(start, alignment, mat, errors)
        self.full_gyro = bool(start.gyro.misalignment.any())
        self.own_axes = own_axes
        self.names = (
            *BASELINE,
            *(ACCEL_ANGLES if own_axes else ()),
            *(GYRO_ANGLES if self.full_gyro else ()),
        )
        if self.given:
            beside = [*self.alignments, *GYRO_TERM] if self.full_gyro else self.alignments
            self.further = further_of(self.given, self._state({}), beside=beside)
        kinds = [n.split(".")[1] for n in (*self.names, *self.alignments)]
        loose = [*(LOOSE[k] for k in kinds), *(f.loose for f in self.further)]
        self.loose = np.append(loose, own)
        self.moved = np.zeros(len(self.loose))
        self.late = 0.0
        self.shapes: Shapes | None = None
        self.colours: list[Colour] | None = None
        self.known: Known | None = None
        self.wander = 0.0
        self.swayed: tuple[Shapes, FloatArray] | None = None
        self.fit()

    @property
    def alignments(self) -> tuple[str, ...]:
        """The parameters of alignment."""
        turned = tuple(f"reference_misalignment.r{a}" for a in AXES) if self.turned else ()
        return ("time_offset.delay", "clock_scale.scale", *turned)

    @property
    def aligned(self) -> tuple[str, ...]:
        """The nuisances in order: alignment, further terms, and errors that an arm carries."""
        further = (f.label for f in self.further)
        return (*self.alignments, *further, *(NAMES if self.carries else ()))

    @property
    def first_further(self) -> int:
        """Where the coefficients of a given model's further terms begin among all of a fit."""
        return len(self.names) + len(self.alignments)

    def state(self) -> State:
        """Return the true state at the recording's times, in frame s."""
        return self._at(lost_by(self.setup.model))

    def _at(self, lost: Mapping[str, float]) -> State:
        """Return the state if the truth was smoothed by so much."""
        for setup, sizes, state in self._states:
            if setup is self.setup and sizes == lost:
                return state
        state = self._state(lost)
        self._states = [*self._states[-1:], (self.setup, dict(lost), state)]
        return state

    def _state(self, lost: Mapping[str, float]) -> State:
        model, alignment, mat, errors = self.setup
        state = self.sharpened.before(lost).state(alignment.times(self.time))
        given = state.angular_acceleration
        state = replace(
            self.warmth.put_into(state),
            time=self.time,
            force=state.force @ mat.T,
            rate=state.rate @ mat.T,
            angular_acceleration=None if given is None else given @ mat.T,
            known_gradient=gradient_in(mat, state.known_gradient, self.still.rests),
            mat_ns=None if state.mat_ns is None else state.mat_ns @ mat.T,
            reference_temperature=model.reference_temperature,
            power_on=self.power_on,
            gravity=self.gravity,
            sampling=self.sampling,
            since_turn=None,
            turning=None,
            vibration=self.vibration,
        )
        if self.carries:
            state = replace(state, force=true_force(state, arm_of(self.setup.model), errors))
        if self.judged is not None:
            # What it feels between rests nothing tells but the accelerometer itself.
            own = model.accel.correct(self.measured[:, :3])
            state = replace(state, force=np.where(self.judged[:, None], state.force, own))
        return observed(state, ("since_turn", "turning"))

    def _judging(self, blur: Blur) -> Blur:
        return blur if self.judged is None else blur.judging(self.judged)

    def move(
        self, baseline: Mapping[str, float], nuisance: FloatArray, terms: tuple[Term, ...]
    ) -> None:
        """Move model and alignment by steps; set the terms beside those that are given."""
        self.moved = self.moved + np.append([baseline[n] for n in self.names], nuisance)
        start = len(self.alignments)
        own = slice(start, start + len(self.further))
        self.given = moved_terms(self.given, self.further, nuisance[own])
        self.setup = self.setup.moved(
            baseline,
            np.delete(nuisance, own),
            (*self.given, *self.rough, *terms),
            turned=self.turned,
        )

    def place(self) -> object:
        """Return where model and alignment stand."""
        return self.setup, self.moved, self.given

    def go_back(self, place: object) -> None:
        """Let model and alignment stand where they stood."""
        assert isinstance(place, tuple)
        self.setup, self.moved, self.given = place

    def rows(self) -> Rows:
        """Return recording minus model of the truth."""
        true, (state, felt, left, noise) = self.state(), self._seen()
        late = self._late()
        if self.shapes is None:
            columns = list(self._shape_columns(felt, left))
            if late is not None:
                columns = [(c, late @ v if c.startswith("gyro") else v) for c, v in columns]
            views, rough = self.blur.see_columns(columns), None
            if self.noisy:
                rough = scatter(
                    felt,
                    noise,
                    views,
                    blur=self.blur,
                    resolved=not self.unresolved,
                    folded=self.folded,
                    struck=self.struck,
                )
            elif self.unknown is not None:
                rough = silenced(self.unknown)
            still = self.time[np.minimum(self.still.settled, len(self.time) - 1)]
            self.shapes = find_shapes(
                self.time, noise, views, blur=self.blur, scatter=rough, still=still
            )
        level = np.median(self.shapes.noise, axis=0).reshape(2, 3).mean(axis=1)
        known = self._known(*np.sqrt(2.0 * self.interval * level).tolist())
        steady = None
        if known is not None:
            steady = steadied(
                self.time,
                true.rate,
                self.still.settled,
                true.mat_ns,
                angle=known.angle,
                interval=self.interval,
                band=self.band,
            )
        turned = [n.startswith("reference_misalignment") for n in self.alignments]
        rows = make_rows(
            self.shapes,
            felt,
            left,
            names=self.names,
            nuisance=[
                *(
                    self._nuisance(state if turn else felt, name)
                    for name, turn in zip(self.alignments, turned, strict=True)
                ),
                *further_columns(self.given, self.further, felt),
                *self._carried(state),
            ],
            aligned=self.aligned,
            prior=np.stack((self.moved, self.loose), axis=1),
            known=known,
            steady=steady,
            late=late,
            swayed=self._swayed(felt, known, steady),
        )
        model = self.setup.model
        matrices = np.stack((model.accel.matrix, model.gyro.matrix))
        rows = replace(rows, matrices=matrices, clustered=self.noisy)
        if self.stuck:
            rows = with_rounding(rows, self.stuck)
        if felt is state and not arm_of(self.setup.model).any():
            return rows
        plain = np.zeros((len(rows.residual), len(self.loose)))
        for k, name in enumerate(self.names):
            plain[:, k] = rows.column(baseline_column(name, state))
        # What an arm carries is not there without one.
        own = self.first_further
        plain[:, len(self.names) : own] = rows.nuisance[:, : len(self.alignments)]
        for k, column in enumerate(further_columns(self.given, self.further, state), own):
            plain[:, k] = rows.column(column)
        return replace(rows, plain=plain)

    def as_linearised(self, rows: Rows) -> Rows:
        """Return rows with the residual and the motion of where the model stands now.

        Between a clock or a delay and another all else is what it was: noise, windows, columns.
        """
        if self.known is not None:
            return self.rows()  # at rest captured orientations are lines, which move with it
        assert self.shapes is not None
        _, felt, left, _ = self._seen()
        return replace(rows.with_residual(seen_of(self.shapes, left)), state=felt)

    def _seen(self) -> tuple[State, State, FloatArray, FloatArray]:
        """Return the motion, as columns are of it; what the sensor feels of it; and what is left.

        Last what is left beside a truth as it was before it was smoothed.
        """
        state = self.state()
        left = noise = self.residual(state)
        said = lost_by(self.setup.model)
        lost = completed(said, self.smoothed)
        if lost != said:
            # What is not said yet has been seen: columns are those of the motion as it was.
            state = self._at(lost)
            noise = self.residual(state, lost)
        if self.known is not None:
            gain = np.maximum(self._gain(), LEAST_GAIN)
            state = witnessed(state, noise / gain, self.known)
        elif self.still.densities is not None:
            state = shared(state, self.measured)
        elif self.white is not None:
            state = between(state, left, self.white)
        ramp = round(1.0 / (self.band * self.interval)) if self.band else 0
        state = stilled(state, self.still.rests, ramp=ramp)
        if lost and self.sharpened.sharpen is not None:
            step = self.truth.recording.interval
            seen = dulled(state, lost, bands=self.bands, interval=step)
            state = replace(state, captured=seen)
        # The sensor's errors act on what it feels where it is. Of a motion that is not resolved
        # that is not known: it would be noise, and the same in many columns.
        felt = state if self.unresolved else self.sharpened.sensor(self.setup.model).felt(state)
        return state, felt, left, noise

    def _known(self, accel: float, gyro: float) -> Known | None:
        """Return what is known of the noise of a captured motion once its colour is.

        Beside differences of these densities where they are slow, SI/√Hz.
        """
        own = self.still.densities
        if own is None and self.blur.mat_ns is not None:
            own = accel, gyro  # where it never rests both are all that is known
        if own is None or self.colours is None or not np.isfinite(accel + gyro):
            return None
        cutoff = min(BEYOND * self.band, 0.5 / self.truth.recording.interval)
        return known_noise(own, (accel, gyro), self.colours, interval=self.interval, cutoff=cutoff)

    def told_by_noise(self, rows: Rows, axis: FloatArray) -> float:
        """Return what noise alone seems to tell of a turn about an axis (3,), 1/rad².

        What the sensor's own noise has across the axis is no motion that shows the angle.
        """
        if self.known is not None:
            square = np.square([self.known.accel, self.known.gyro]) / self.known.interval
        elif self.white is not None:
            # What two sensors have between them is quieter than either.
            one, other = np.square(self.white)
            square = one * other / np.maximum(one + other, np.finfo(float).tiny) / self.interval
        else:
            return 0.0
        own = np.repeat(square, 3) / 2.0
        own *= np.tile(1.0 - np.square(axis), 2)
        seen = sum(v * f.multiply(f).sum(axis=1) for v, f in zip(own, rows.functional, strict=True))
        noise = np.concatenate((rows.expected_variance(), rows.white_diagonal))
        return float((np.ravel(seen) / noise).sum())

    def residual(self, state: State, lost: Mapping[str, float] | None = None) -> FloatArray:
        """Return recording minus model, (n, 6), of a truth that was smoothed as the model says."""
        predicted = self.sharpened.sensor(self.setup.model).distort(state)
        lost = lost_by(self.setup.model) if lost is None else lost
        gyro = self._late_gyro(state, lost) if self._gyro_delay() else predicted.gyro
        return np.asarray(self.measured - np.hstack((predicted.accel, gyro)))

    def left(self, filters: tuple[Term, ...]) -> tuple[FloatArray, FloatArray] | None:
        """Return what is left of samples, relative to how they scatter: (m,) s, (m, 6).

        None where that is no noise: of a motion that samples, or a simulation, do not resolve. Of
        channels that are coarse, as it steps in counts there, it is 0. Samples of which ``filters``
        take so much away that others of their kind would leave another noise are left out.
        """
        if self.judged is not None or self.unresolved or (self.noisy and not self.turned):
            return None
        every, taken = self._behind(filters)
        seen = self.blur.see(every)
        time, known = self.time[self.blur.seen], np.ones(len(seen), bool)
        if self.unknown is not None:
            known = ~self.unknown[self.blur.seen]
        assert self.shapes is not None
        noise = np.sqrt(np.median(self.shapes.noise, axis=0))
        known &= (UNLIKE * np.abs(taken[self.blur.seen]) <= noise).all(axis=1)
        if self.noisy and (scatters := self.shapes.scatter) is not None:
            seen = seen / np.sqrt(scatters.variance[self.blur.seen] * scatters.seen)
        return time[known], np.where(self.coarse, 0.0, seen[known])

    def slips(self, filters: tuple[Term, ...]) -> tuple[Unexplained, ...]:
        """Return the corners about which the truth and the sensor turn by different angles.

        What ``filters`` hold back of a turn comes when it is over, and is no slip.
        """
        if self.unknown is None:
            return ()
        every, taken = (values[:, 3:] / self._gain()[3:] for values in self._behind(filters))
        rate, unlike = self.measured[:, 3:], UNLIKE * taken
        return find_slips(self.time, every, rate, self.unknown, self.interval, unlike)

    def _behind(self, filters: tuple[Term, ...]) -> tuple[FloatArray, FloatArray]:
        """Return the residual behind filters, and what they take away: (n, 6) each.

        The model may have taken them up already, or not.
        """
        state, place, number = self.state(), self.setup, len(self.given)
        if not filters:
            left = self.residual(state)
            return left, np.zeros_like(left)
        found = {t.effect for t in filters}
        others = [t for t in place.model.terms[number:] if t.effect not in found]
        terms = (*place.model.terms[:number], *others)
        each = []
        for own in (terms, (*terms, *filters)):
            self.setup = place._replace(model=replace(place.model, terms=own))
            each.append(self.residual(state))
        self.setup = place
        plain, behind = each
        return behind, plain - behind

    def _late_gyro(self, state: State, lost: Mapping[str, float]) -> FloatArray:
        """Return what a gyroscope that is late puts out: the motion before, as the truth has it.

        A cubic between samples as few as these may be would lose some of it.
        """
        alignment, mat, model = (
            self.setup.alignment,
            self.setup.mat_sr,
            self.sharpened.sensor(self.setup.model),
        )
        before = self.sharpened.before(lost).state(alignment.times(self.time - self._gyro_delay()))
        given = before.angular_acceleration
        moved = replace(
            state,
            force=before.force @ mat.T,
            rate=before.rate @ mat.T,
            angular_acceleration=None if given is None else given @ mat.T,
        )
        prompt = [
            replace(t, parameters={k: v for k, v in t.parameters.items() if k != "gyro_delay"})
            if t.effect == "time_offset"
            else t
            for t in model.terms
        ]
        terms = tuple(t for t in prompt if t.parameters)
        return np.asarray(replace(model, terms=terms).distort(moved).gyro)

    def fit(self) -> None:
        """Fit baseline and alignment by robust Gauss-Newton.

        Beside an arm: what half a metre makes a sensor feel would draw scale factors and time with
        it, and in a swing 6 cm lead to where no fit returns from. So would a gyroscope that is late
        by far, and it would look like noise. Both are left to be found as any other effect.
        """
        check_units(self.state(), self.measured)
        arm = np.zeros(3)
        self._align_accel()
        late, moved = self.rough, 0.0
        # Beside a truth without noise the first step leads nearly there.
        anew = 2 if self.noisy or self.band else 1
        for k in range(STEPS):
            coloured = bool(self.band) and k == COLOURED
            if k <= anew or coloured:
                self.shapes, moved = None, 0.0
            if coloured:
                self._whiten()
            rows = self.rows()
            beside = self._arm_columns(rows)
            prior = np.stack((arm, np.full(3, LONG)), axis=1)[: beside.shape[1]]
            step, further, most = robust_step(rows, beside, prior)
            moved += most
            p = len(self.names)
            terms = self.setup.model.terms[len(self.given) + len(self.rough) :]
            self.move(dict(zip(self.names, step[:p], strict=True)), step[p:], terms)
            if k > (COLOURED if self.band else anew) and np.abs(step).max() < 1e-7:
                break
            if not len(further):
                continue
            arm = arm + further
            if np.linalg.norm(arm) <= SEEN:
                arm = np.zeros(3)
            known = (Term(SLUG, self.smoothed),) if self.smoothed else ()
            self._suppose((*late, *known, *((arm_term(arm),) if arm.any() else ())))
        if moved > SAME or arm.any() or self.late:
            self.shapes = None
        if self.late:
            # Windows, and their noise, as they are beside a gyroscope that is not late.
            self._suppose(late)
            self.rows()
        self._suppose(())
        if self.known is not None and self.blur.mat_ns is not None:
            self.wander = self._wander()
        state = self.state()
        check_motion(state, self.measured, self.residual(state))

    def _swayed(
        self, state: State, known: Known | None, steady: Steady | None
    ) -> FloatArray | None:
        """Return what wandering angles add to the variance of shapes, as it first was."""
        if known is None or not self.wander:
            return None
        assert self.shapes is not None
        if self.swayed is None or self.swayed[0] is not self.shapes:
            moved = swayed_by(self.wander, self.shapes, state, known, steady)
            self.swayed = self.shapes, moved
        return self.swayed[1]

    def _wander(self) -> float:
        """Return by how much captured angles wander, rad²."""
        rows = self.rows()
        return wandering(rows, self._shape_columns(rows.state, self.residual(self.state())))

    def _arm_columns(self, rows: Rows) -> FloatArray:
        """Return what an arm does to the rows, (m, 3); (m, 0) where no forces are compared."""
        if self.judged is not None:
            return np.zeros((len(rows.residual), 0))
        columns = get_effect("accel_lever_arm").columns(rows.state, {})
        return np.stack([rows.column(column) for column in columns.values()], axis=1)

    def _late(self) -> sparse.csr_matrix | None:
        """Return what makes signals late by as much as the model has a gyroscope, if it is much."""
        delay = self._gyro_delay()
        return delaying(self.time, delay) if abs(delay) >= LATE else None

    def _gyro_delay(self) -> float:
        """Return by how much the model has the gyroscope late, s."""
        terms = [t.parameters for t in self.setup.model.terms if t.effect == "time_offset"]
        return sum(p.get("gyro_delay", 0.0) for p in terms)

    def _align_accel(self) -> None:
        """Align the accelerometer in time, the gyroscope being roughly as late as it is."""
        if self.judged is not None:
            return
        state = self.state()
        # A long arm is felt as well, and is no delay.
        part = liveliest(state.rate)
        measured = self.measured[part]
        felt = (state.force[part], *np.moveaxis(state.gradient[part], -1, 0))
        force = rough_delay(measured[:, :3], felt, self.interval)
        rate = rough_delay(measured[:, 3:], (state.rate[part],), self.interval)
        if force is None or rate is None:
            return
        # A calibration may have some of it already.
        late = rate - force - self._gyro_delay()
        if abs(late) < LATE:
            return
        self.late = late
        self.setup = self.setup._replace(alignment=self.setup.alignment.moved(-force, 0.0))
        self._suppose((Term("time_offset", {"gyro_delay": self.late}),))

    def _suppose(self, terms: tuple[Term, ...]) -> None:
        """Let the model have terms for the time of the first fit, which are found later on."""
        if terms == self.rough:
            return
        model = self.setup.model
        found = model.terms[len(self.given) + len(self.rough) :]
        self.rough = terms
        terms = (*self.given, *self.rough, *found)
        self.setup = self.setup._replace(model=replace(model, terms=terms))

    def _whiten(self) -> None:
        """Look from here on through what makes the noise that is left white."""
        state = self.state()
        left = self.residual(state)
        if self.sharpened.sharpen is not None:
            self.smoothed = smoothing(state, left, placed=self.judged is None)
        if self.smoothed:
            self._suppose((*self.rough, Term(SLUG, self.smoothed)))
            state = self.state()
            left = self.residual(state)
        densities = self.still.densities or (0.0, 0.0)
        seen = Differences(state, left, self.interval, self.bands, densities, self.judged)
        felt = self.sharpened.sensor(self.setup.model).felt(state)
        columns = self._shape_columns(felt, left) if self.captured else None
        self.colours, blur = find_noise(seen, columns)
        self.blur = self._judging(blur)
        self.known = self._known(*(own.density for own in self.colours))

    def _carried(self, state: State) -> list[Column]:
        if not self.carries:
            return []
        return carried(state, arm_of(self.setup.model), self.setup.errors)

    def arm(self) -> FloatArray:
        """Return roughly by which arm (3,) the truth is off, m; 0 if it is short."""
        state = self.state()
        return self._arm(state, self.residual(state))

    def _arm(self, state: State, left: FloatArray) -> FloatArray:
        return arm_of(self.setup.model) + rough_arm(state, left[:, :3])

    def _nuisance(self, state: State, name: str) -> Mapping[str, FloatArray]:
        slug, parameter = name.split(".")
        if slug == "reference_misalignment":
            return get_effect(slug).columns(state, {})[parameter]
        # What is late is what the sensor puts out.
        gain = dict(zip(CHANNELS, self._gain(), strict=True))
        since = state.time - self.setup.alignment.middle if slug == "clock_scale" else 1.0
        delay = get_effect("time_offset").columns(state, {})["delay"]
        return {c: gain[c] * since * values for c, values in delay.items()}

    def _gain(self) -> FloatArray:
        """Return what the channels make of their true signals, (6,)."""
        model = self.setup.model
        return 1.0 + np.concatenate((model.accel.scale_factor_error, model.gyro.scale_factor_error))

    def _shape_columns(self, state: State, left: FloatArray) -> Iterator[tuple[str, FloatArray]]:
        """Yield what can show in the signals, in units of its typical size: channel and values."""
        for name in self.names:
            if ".bias." not in name:
                for channel, values in baseline_column(name, state).items():
                    yield channel, 0.01 * values
        for name, size in zip(self.alignments, (5e-3, 1e-4, 0.02, 0.02, 0.02), strict=False):
            for channel, values in self._nuisance(state, name).items():
                yield channel, size * values
        if self.carries:
            arm = self._arm(state, left)
            if arm.any():
                for size, column in zip(SIZES, carried(state, arm, self.setup.errors), strict=True):
                    for channel, values in column.items():
                        yield channel, size * values
        for f, column in zip(
            self.further, further_columns(self.given, self.further, state), strict=True
        ):
            for channel, values in column.items():
                yield channel, f.typical * values
        yield from catalogue_shapes(state)
        if self.smoothed:
            yield from get_effect(SLUG).contribution(state, self.smoothed).items()


def _common(
    real: Recording, truth: RecordingTruth, alignment: Alignment, spoilt: BoolArray | None
) -> IntArray:
    """Return the samples that are whole and whose truth is known."""
    covered = truth.covers(alignment.times(real.time))
    if spoilt is not None:
        covered = covered & ~spoilt
    common = float(covered.sum()) * real.interval
    if common < LEAST_OVERLAP:
        raise NoCommonMotionError(
            f"the two have {common:.2g} s in common that both know without gaps, expected "
            f"{LEAST_OVERLAP:g} s or more"
        )
    return np.flatnonzero(covered)


def _coarse(*recordings: Recording) -> BoolArray:
    """Return which channels step in counts at rest in any of some recordings, (6,)."""
    values = [values_of(recording) for recording in recordings]
    return np.asarray(np.any([resolution(v) >= noise_at_rest(v) for v in values], axis=0))
