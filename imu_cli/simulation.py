"""What `imu-cal simulate` does between its options and its files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calib.calibration import Calibration
from calib.effects import effects
from calib.effects.base import Term
from calib.model import SensorModel
from calib.recording import DeviceInfo, Recording
from calib.simulate import Sampling, digital_twin, simulate
from calib.simulation.kinematics import Motion
from calib.simulation.library import make_motion
from calib.simulation.noise import CONSUMER, NoiseModel, noise_at_rest
from calib.simulation.recorded import motion_of
from calib.statics import find_poses
from drivers.calibration_file import describe_input, load_calibration
from drivers.formats import read_recording

G = 9.80665
MOST_SAMPLES = 5e7
"""About 24 h at 500 Hz, and 20 GB of memory."""


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
        samples = self.rate * self.duration
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

    @property
    def span(self) -> tuple[float, float]:
        """The times that an event may have by default, s."""
        return 0.0, self.duration


@dataclass(frozen=True, eq=False)
class Simulated:
    """A simulated recording with all that is true of it."""

    recording: Recording
    truth: Recording | None
    motion: Motion
    model: SensorModel
    noise: NoiseModel

    def summary(self, path: Path) -> list[str]:
        """Return lines of text for the screen."""
        r = self.recording
        rate = 1 / r.interval if r.interval else 0.0
        lines = [
            f"{path}: {len(r)} samples, {r.duration:.1f} s at {rate:.6g} Hz, {self.motion.name}"
        ]
        counts = [
            f"{len(found)} {label}"
            for kind, label in (("static", "static poses"), ("turn", "turns"), ("spin", "spins"))
            if len(found := self.motion.intervals(kind))
        ]
        if counts:
            lines.append("motion: " + ", ".join(counts))
        for term in self.model.terms:
            values = ", ".join(f"{k} = {v:.4g}" for k, v in term.parameters.items())
            lines.append(f"effect: {term.effect} ({values})")
        return lines


def run(plan: Plan, terms: tuple[Term, ...], *, rng: np.random.Generator) -> Simulated:
    """Simulate what was asked for.

    Raises
    ------
    ImuError
        If a calibration or the recording cannot be read.
    """
    if plan.like is not None:
        return _twin(plan, terms, rng=rng)
    calibration = None if plan.sensor is None else load_calibration(plan.sensor)
    model = SensorModel() if calibration is None else calibration.model
    model = replace(model, terms=model.terms + terms)
    gravity = plan.gravity or (G if calibration is None else calibration.gravity.value)
    noise = _noise(calibration).scaled(plan.noise)
    motion = make_motion(plan.motion, rng=rng, duration=plan.duration, gravity=gravity)
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
    return Simulated(recording, truth, motion, model, noise)


def _twin(plan: Plan, terms: tuple[Term, ...], *, rng: np.random.Generator) -> Simulated:
    assert plan.like is not None
    assert plan.calibration is not None
    recording = read_recording(plan.like, profile=plan.profile, imu=plan.imu)
    calibration = load_calibration(plan.calibration)
    sensor = calibration if plan.sensor is None else load_calibration(plan.sensor)
    events = _events_of(plan.like, calibration)
    own = replace(calibration.model, terms=calibration.model.terms + events)
    model = own if sensor is calibration else sensor.model
    model = replace(model, terms=model.terms + terms)
    gravity = plan.gravity or calibration.gravity.value
    poses = find_poses(recording)
    noise = noise_at_rest(recording, poses).scaled(plan.noise)
    motion = motion_of(recording, own, poses, gravity=gravity)
    twin = digital_twin(recording, motion, model, noise, rng=rng)
    truth = None
    if plan.truth:
        truth = digital_twin(recording, motion, SensorModel(), NoiseModel(), rng=rng)
    return Simulated(twin, truth, motion, model, noise)


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
        "terms": [
            {"effect": t.effect, "parameters": dict(t.parameters)} for t in result.model.terms
        ],
        "noise": {name: getattr(result.noise, name) for name in result.noise.__dataclass_fields__},
    }
