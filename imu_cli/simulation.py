"""What `imu-cal simulate` does between its options and its files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import typer

from calib.calibration import Calibration
from calib.effects import effects
from calib.effects.base import Term
from calib.effects.text import parse_term
from calib.gravity import STANDARD_GRAVITY as G
from calib.measured import mended
from calib.mismatch.reference.beside import motion_beside, without_alignment
from calib.mismatch.reference.referencemode import ReferenceMotion
from calib.mismatch.reference.twinned import with_sensor
from calib.model import SensorModel
from calib.recording import DeviceInfo, Recording
from calib.simulate import Sampling, digital_twin, simulate
from calib.simulation.kinematics import Motion
from calib.simulation.library import make_motion
from calib.simulation.noise import CONSUMER, NoiseModel, noise_at_rest
from calib.simulation.recorded import motion_of
from calib.simulation.referenced import motion_from_reference, shown_bandwidth
from calib.statics import find_poses
from drivers.calibration_file import describe_input, load_calibration
from drivers.formats import read_recording

MOST_SAMPLES = 5e7
"""About 24 h at 500 Hz, and 20 GB of memory."""


WHENEVER = -1e12, 1e12
"""s: the span of a recording that has not been read."""


@dataclass(frozen=True)
class Plan:
    """What was asked for, checked."""

    motion: str
    duration: float
    rate: float
    gravity: float | None
    noise: float
    sampling: Sampling
    sensor: Path | None = None
    effects: tuple[str, ...] = ()
    reference: ReferenceMotion | None = None
    bandwidth: float | None = None
    like: Path | None = None
    calibration: Path | None = None
    profile: str | None = None
    imu: int | None = None
    truth: bool = False
    accel_range: float | None = None
    gyro_range: float | None = None
    bits: int = 16

    def __post_init__(self) -> None:
        if not (np.isfinite(self.rate) and self.rate > 0):
            raise ValueError(f"--rate must be positive, got {self.rate}")
        samples = self.samples
        if samples < 2:
            raise ValueError(
                f"--rate and --duration give {samples:.2g} samples, expected 2 or more"
            )
        if samples > MOST_SAMPLES:
            raise ValueError(
                f"--rate and --duration give {samples:.3g} samples, more than the "
                f"{MOST_SAMPLES:.0e} that fit in memory: simulate shorter pieces with other seeds"
            )
        for name, value in (("accel", self.accel_range), ("gyro", self.gyro_range)):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise ValueError(f"--{name}-range must be positive, got {value}")
        if not 4 <= self.bits <= 32:
            raise ValueError(f"--bits must be 4 to 32, got {self.bits}")
        if not (np.isfinite(self.noise) and self.noise >= 0):
            raise ValueError(f"--noise must not be negative, got {self.noise}")
        if self.gravity is not None and not 9.7 < self.gravity < 9.9:
            raise ValueError(f"--gravity must be in m/s², 9.7 to 9.9 on Earth, got {self.gravity}")
        if self.bandwidth is not None and not (np.isfinite(self.bandwidth) and self.bandwidth > 0):
            raise ValueError(f"--bandwidth must be positive, got {self.bandwidth}")
        if self.like is None:
            self.terms((0.0, self.duration), samples)
        else:
            self.terms(WHENEVER, np.inf)

    @property
    def samples(self) -> float:
        """How many samples the rate and the duration give."""
        return self.rate * self.duration

    @property
    def device(self) -> DeviceInfo:
        """What clips and rounds the output: full scales in g and deg/s, cut into 2^bits counts."""
        accel = None if self.accel_range is None else self.accel_range * G
        gyro = None if self.gyro_range is None else float(np.radians(self.gyro_range))
        step = 2.0 ** (1 - self.bits)
        return DeviceInfo(
            chip="simulated",
            accel_full_scale=accel,
            gyro_full_scale=gyro,
            accel_lsb=None if accel is None else accel * step,
            gyro_lsb=None if gyro is None else gyro * step,
        )

    def terms(self, span: tuple[float, float], samples: float) -> tuple[Term, ...]:
        """Return the effects that were asked for, as a recording of that span, s, can have them."""
        terms = tuple(parse_term(text, span=span) for text in self.effects)
        for term in terms:
            effects()[term.effect].check_counts(term.parameters, samples=samples)
        return terms


@dataclass(frozen=True, eq=False)
class Simulated:
    """A simulated recording with all that is true of it."""

    recording: Recording
    truth: Recording | None
    motion: Motion
    model: SensorModel
    noise: NoiseModel
    reference: Mapping[str, Any] = field(default_factory=dict)
    """What is to be known of the reference whose motion it is."""

    def warnings(self) -> list[str]:
        """Return what a user has to know of a reference that was not there all the time."""
        holes = self.motion.intervals("hidden")
        if not len(holes):
            return []
        first, last = holes[0] + self.recording.time[0]
        many = "a hole" if len(holes) == 1 else f"{len(holes)} holes"
        return [
            f"the reference has {many} in which nobody knows how it moved, "
            f"{_hidden(self.motion):.3g} s in all, the first about {first:.2f} to {last:.2f} s: no "
            "samples were simulated there"
        ]

    def summary(self, path: Path) -> list[str]:
        """Return lines of text for the screen."""
        r = self.recording
        rate = 1 / r.interval if r.interval else 0.0
        lines = [
            f"{path}: {len(r)} samples, {r.duration:.1f} s at {rate:.6g} Hz, {self.motion.name}"
        ]
        counts = [
            f"{len(found)} {label}{'s' if len(found) > 1 else ''}"
            for kind, label in (("static", "static pose"), ("turn", "turn"), ("spin", "spin"))
            if len(found := self.motion.intervals(kind))
        ]
        if counts:
            lines.append("motion: " + ", ".join(counts))
        if self.reference:
            lines.append(f"reference: {_of_reference(self.reference)}")
        for term in self.model.terms:
            values = ", ".join(f"{k} = {v:.4g}" for k, v in term.parameters.items())
            lines.append(f"effect: {term.effect} ({values})")
        return lines


def run(plan: Plan, *, rng: np.random.Generator) -> Simulated:
    """Simulate what was asked for.

    Raises
    ------
    ImuError
        If a calibration or the recording cannot be read.
    """
    if plan.like is not None:
        return _twin(plan, plan.like, rng=rng)
    calibration = None if plan.sensor is None else load_calibration(plan.sensor)
    model = SensorModel() if calibration is None else calibration.model
    model = replace(model, terms=model.terms + plan.terms((0.0, plan.duration), plan.samples))
    gravity = plan.gravity or (G if calibration is None else calibration.gravity.value)
    noise = _noise(calibration).scaled(plan.noise)
    known: dict[str, Any] = {}
    if plan.reference is None:
        motion = make_motion(plan.motion, rng=rng, duration=plan.duration, gravity=gravity)
    else:
        motion, known = _referenced(plan, plan.reference, gravity)
    recording = simulate(
        motion,
        model,
        noise,
        rng=rng,
        rate=plan.rate,
        device=plan.device,
        sampling=plan.sampling,
    )
    truth = None
    if plan.truth:
        truth = simulate(motion, SensorModel(), NoiseModel(), rng=rng, rate=plan.rate)
    return Simulated(recording, truth, motion, model, noise, known)


def _referenced(
    plan: Plan, reference: ReferenceMotion, gravity: float
) -> tuple[Motion, dict[str, Any]]:
    """Return the motion of a reference by itself, and what is to be known of it."""
    reference = reference.evened()
    seen = reference.time, reference.quat, reference.position
    bandwidth = plan.bandwidth or shown_bandwidth(*seen)
    start = float(reference.time[reference.known][0])
    motion = motion_from_reference(*seen, gravity=gravity, bandwidth=bandwidth, start=start)
    motion = motion.until(plan.duration)
    return motion, _known(reference, motion, bandwidth)


def _known(reference: ReferenceMotion, motion: Motion, bandwidth: float | None) -> dict[str, Any]:
    gaps = ~reference.known
    return {
        "bandwidth": bandwidth,
        "samples_missing": int(gaps.sum()),
        "seconds_hidden": _hidden(motion),
        "position": reference.position is not None,
    }


def _hidden(motion: Motion) -> float:
    """Return how long nobody knows how it moved, s."""
    return float(np.diff(motion.intervals("hidden"), axis=1).sum())


def _of_reference(known: Mapping[str, Any]) -> str:
    band = known["bandwidth"]
    parts = [
        "exact" if band is None else f"low-passed at {band:.3g} Hz, against its noise",
        "with positions" if known["position"] else "its point does not move",
    ]
    if known["samples_missing"]:
        done = "left out or bridged" if known["seconds_hidden"] else "bridged"
        parts.append(f"{known['samples_missing']} missing samples were {done}")
    return "; ".join(parts)


def _twin(plan: Plan, log: Path, *, rng: np.random.Generator) -> Simulated:
    # Samples that were garbled on the way are no motion.
    recording, _ = mended(read_recording(log, profile=plan.profile, imu=plan.imu))
    calibration = None if plan.calibration is None else load_calibration(plan.calibration)
    sensor = calibration if plan.sensor is None else load_calibration(plan.sensor)
    own = SensorModel()
    if calibration is not None:
        events = _events_of(log, calibration)
        own = replace(calibration.model, terms=calibration.model.terms + events)
    model = own if sensor is calibration or sensor is None else sensor.model
    if plan.reference is not None:
        own = replace(own, terms=without_alignment(own.terms))
        model = replace(model, terms=without_alignment(model.terms))
    span = float(recording.time[0]), float(recording.time[-1])
    try:
        model = replace(model, terms=model.terms + plan.terms(span, len(recording)))
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--effect") from error
    assumed = calibration or sensor
    gravity = plan.gravity or (G if assumed is None else assumed.gravity.value)
    poses = find_poses(recording)
    noise = noise_at_rest(recording, poses).scaled(plan.noise)
    known: dict[str, Any] = {}
    if plan.reference is None:
        motion = motion_of(recording, own, poses, gravity=gravity)
    else:
        recording, motion, bandwidth, notes = motion_beside(
            recording,
            plan.reference,
            gravity=gravity,
            model=own if calibration else None,
            bandwidth=plan.bandwidth,
        )
        known = {**_known(plan.reference, motion, bandwidth), **notes}
    twin = digital_twin(recording, motion, model, noise, rng=rng)
    if plan.reference is None:
        twin = with_sensor(twin, model)
    truth = None
    if plan.truth:
        # What is true has no range and no counts.
        ideal = replace(recording, device=DeviceInfo(chip="simulated"))
        truth = digital_twin(ideal, motion, SensorModel(), NoiseModel(), rng=rng)
    return Simulated(twin, truth, motion, model, noise, known)


def _events_of(log: Path, calibration: Calibration) -> tuple[Term, ...]:
    """Return what happened once in the recording, if it is the one that was calibrated."""
    if not calibration.events:
        return ()
    digest = describe_input(log).sha256
    if digest not in {item.sha256 for item in calibration.provenance.inputs}:
        return ()
    return tuple(
        Term(event.effect, {name: item.value for name, item in event.parameters.items()})
        for event in calibration.events
        if event.effect in effects()
    )


def _noise(calibration: Calibration | None) -> NoiseModel:
    """Return a consumer part's noise, its white part as the calibration measured it."""
    if calibration is None or calibration.noise is None:
        return CONSUMER
    measured = calibration.noise
    return replace(
        CONSUMER,
        accel_noise_density=float(np.sqrt(np.mean(measured.accel**2))),
        gyro_noise_density=float(np.sqrt(np.mean(measured.gyro**2))),
    )


def describe(result: Simulated, path: Path, *, seed: int) -> dict[str, Any]:
    """Return what was simulated, with its truth, as one JSON document."""
    recording = result.recording
    values = result.model.accel.parameters("accel") | result.model.gyro.parameters("gyro")
    return {
        "format": "imu-cal/simulation",
        "version": 1,
        "output": str(path),
        "seed": seed,
        "samples": len(recording),
        "samples_lost": recording.samples_lost,
        "duration": recording.duration,
        "motion": result.motion.name,
        "gravity": result.motion.gravity,
        "segments": [
            {"kind": s.kind, "interval": [float(s.start), float(s.stop)], "label": s.label}
            for s in result.motion.segments
        ],
        "sensor": values,
        "reference": dict(result.reference) or None,
        "terms": [
            {"effect": t.effect, "parameters": dict(t.parameters)} for t in result.model.terms
        ],
        "noise": {name: getattr(result.noise, name) for name in result.noise.__dataclass_fields__},
    }
