"""Coarse counts beside a simulation: what rounding does to rests is no effect."""

from dataclasses import replace

import numpy as np
import pytest

from calib.effects.base import Term
from calib.mismatch import diagnose_against
from calib.mismatch.reference.counted import rounded_at_rest
from calib.mismatch.samples.samples import look_at_samples
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import NoiseModel
from calib.statics import find_poses

GRAVITY = 9.80665
SIGMA = np.array([1e-2, 1e-3])
PLACE = np.array([0.3, -0.2, 0.35])
"""Where the biases of the gyroscope are between two counts."""


def pair(seed: int, lsb: float, *terms: Term) -> tuple[Recording, Recording]:
    """Return a recording of which counts are ``lsb`` times the noise, and a simulation."""
    rng = np.random.default_rng(seed)
    motion = bench_protocol(
        rng,
        poses=10,
        first_pose=1.0,
        pose_duration=(2.0, 3.0),
        turn_duration=(0.8, 1.5),
        tremor=0.0,
    )
    noise = NoiseModel(accel_noise_density=1e-3, gyro_noise_density=1e-4)
    real = simulate(motion, SensorModel(terms=terms), noise, rng=rng, rate=200.0)
    exact = simulate(motion, SensorModel(), NoiseModel(), rng=rng, rate=200.0)
    accel, gyro = lsb * SIGMA
    real = replace(
        real,
        accel=np.rint(real.accel / accel) * accel,
        gyro=np.rint(real.gyro / gyro + PLACE) * gyro,
    )
    return real, exact


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_rests_that_are_off_by_their_rounding_are_no_effect_of_turning(seed):
    found = diagnose_against(*pair(seed, 4.0), gravity=GRAVITY)
    assert {f.effect for f in found.findings} == {"quantization"}
    assert not found.unexplained
    assert not found.missing


@pytest.mark.long
def test_an_effect_is_still_found_beside_it():
    term = Term("gyro_misalignment", {"mxy": 2e-3, "mzx": -2e-3})
    found = diagnose_against(*pair(1, 4.0, term), gravity=GRAVITY)
    assert [f.effect for f in found.findings if f.effect != "quantization"] == [term.effect]
    (own,) = (f for f in found.findings if f.effect == term.effect)
    for name, value in term.parameters.items():
        q = own.parameters[name]
        assert q.value == pytest.approx(value, abs=4 * q.sigma)


def test_rounding_errs_alike_at_rest_and_not_in_turns():
    real, exact = pair(1, 4.0)
    seen = look_at_samples(real, find_poses(real))
    stuck = rounded_at_rest(real, real.time, exact.gyro, seen.findings)
    lsb = 4.0 * SIGMA[1]
    moves = np.abs(exact.gyro) > lsb
    for c in range(3):
        own = stuck[3 + c].toarray()
        assert not own[moves[:, c]].any()
        size = np.sqrt(np.square(own).sum(axis=1))
        still = np.abs(exact.gyro[:, c]) < 1e-9
        off = float((real.gyro[still, c] - PLACE[c] * lsb).mean())
        assert 0.02 * lsb < abs(off) < 2.0 * float(np.median(size[still]))
        # Two rests are off together: their errors have most in common.
        first, last = own[np.flatnonzero(still)[[0, -1]]]
        assert first @ last > 0.5 * float(np.median(size[still])) ** 2


def test_fine_counts_leave_no_errors():
    real, exact = pair(1, 0.1)
    seen = look_at_samples(real, find_poses(real))
    assert rounded_at_rest(real, real.time, exact.gyro, seen.findings) == ()
