"""A body that is waved and hardly rests, beside markers: what their angles err by comes back."""

from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from calib.effects.base import Term
from calib.mismatch import ReferenceMotion, diagnose_reference
from calib.mismatch.findings.diagnosis import Diagnosis
from calib.model import SensorModel
from calib.rotation import quat_from_rotvec, quat_multiply
from calib.simulate import simulate
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER
from calib.simulation.referenced import motion_from_reference

GRAVITY, RATE, DURATION = 9.80665, 120.0, 90.0


@cache
def waved(fastest: float) -> tuple[Motion, np.ndarray, np.ndarray, np.ndarray]:
    """Return a body that is waved throughout, at up to so many Hz; and its path at 480 Hz."""
    rng = np.random.default_rng(7)
    time = np.arange(0.0, DURATION, 0.25 / RATE)
    strength = np.clip(0.5 * np.minimum(time, DURATION - time) - 0.5, 0.0, 1.0)
    strength = gaussian_filter1d(strength, 4 * RATE)[:, None]
    turn, away = np.zeros((2, len(time), 3))
    for frequency in np.geomspace(0.1 * fastest, fastest, 9):
        phase = 2 * np.pi * (frequency * time[:, None] + rng.random((2, 1, 3)))
        turn += 0.35 * np.sqrt(fastest / frequency) * np.sin(phase[0])
        away += 0.02 / frequency * np.sin(phase[1])
    quat, place = quat_from_rotvec(strength * turn), strength * away
    return motion_from_reference(time, quat, place, gravity=GRAVITY), time, quat, place


def diagnosed(
    seed: int, *terms: Term, fastest: float, noise: float = 0.2, wander: float = 0.0
) -> Diagnosis:
    """Return what is said beside markers with ``noise`` and errors that ``wander``, both in deg."""
    motion, time, quat, place = waved(fastest)
    rng = np.random.default_rng(seed)
    model = SensorModel(terms=terms)
    real = simulate(motion, model, CONSUMER, rng=rng, rate=100.0)
    n = len(time[::4])
    off = rng.normal(0.0, np.radians(noise), (n, 3))
    slow = gaussian_filter1d(rng.normal(size=(n, 3)), 3.0 * RATE, axis=0)
    off += np.radians(wander) * slow / slow.std()
    seen = quat_multiply(quat[::4], quat_from_rotvec(off))
    position = place[::4] + rng.normal(0.0, 2e-4, (n, 3))
    return diagnose_reference(real, ReferenceMotion(time[::4], seen, position), gravity=GRAVITY)


@pytest.mark.long
def test_a_misalignment_shows_while_a_body_is_waved() -> None:
    true = {"mxy": 4e-4, "myz": -5e-4, "mzx": 3e-4}
    found = diagnosed(1, Term("gyro_misalignment", true), fastest=3.0)
    (item,) = (f for f in found.findings if f.effect != "time_offset")
    assert item.effect == "gyro_misalignment"
    # In the body's frame, where noise of angles times the rate does not come back, it was silent.
    assert item.p_value < 1e-12
    for name, q in item.parameters.items():
        assert abs(q.value - true.get(name, 0.0)) < 4.0 * q.sigma
    assert not found.unexplained


@pytest.mark.long
@pytest.mark.parametrize("wander", [0.0, 0.05])
@pytest.mark.parametrize("fastest", [0.25, 2.0])
def test_markers_that_wander_are_no_sensor_that_slips(fastest: float, wander: float) -> None:
    found = diagnosed(2, fastest=fastest, wander=wander)
    assert {f.effect for f in found.findings} <= {"time_offset"}
    # Chance alone may say something, at p = 0.01.
    assert min((u.p_value for u in found.unexplained), default=1.0) > 1e-3
