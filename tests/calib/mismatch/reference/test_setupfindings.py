"""The evidence of an alignment against scipy's own densities."""

from functools import cache

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from calib.effects.base import Term
from calib.mismatch import ReferenceMotion, diagnose_reference
from calib.mismatch.hypotheses.factors import SCALES, SHARES
from calib.mismatch.reference.setupfindings import bayes_factor
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import Sampling, simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.noise import CONSUMER, NoiseModel

SLOW = Term("clock_scale", {"scale": 0.004})
LATE = Term("time_offset", {"delay": 0.02})


@cache
def motion() -> Motion:
    rng = np.random.default_rng(1)
    return bench_protocol(rng, poses=8, first_pose=1.0, pose_duration=(2.0, 3.0), tremor=0.3)


def recorded(terms: tuple[Term, ...], noise: NoiseModel) -> Recording:
    return simulate(
        motion(),
        SensorModel(terms=terms),
        noise,
        rng=np.random.default_rng(2),
        rate=50.0,
        sampling=Sampling(clock_offset=30.0),
    )


def captured(rate: float = 120.0) -> ReferenceMotion:
    time = np.arange(0.0, motion().duration, 1.0 / rate)
    turning, path = motion().kinematics(time)
    assert path is not None
    return ReferenceMotion(time + 30.0, turning.quat, path.position)


@pytest.mark.parametrize("value", [[0.0, 0.0], [3e-3, -1e-3]])
def test_evidence_is_a_ratio_of_densities(value: list[float]) -> None:
    covariance = np.array([[2.0, 0.5], [0.5, 1.0]]) * 1e-6
    typical = np.array([1e-2, 2e-3])
    none = multivariate_normal.pdf(value, cov=covariance)
    some = [
        multivariate_normal.pdf(value, cov=covariance + np.diag((s * typical) ** 2)) for s in SCALES
    ]
    found = bayes_factor(np.array(value), covariance, typical)
    assert found == pytest.approx(float(np.dot(SHARES, some)) / none, rel=1e-9)


def test_what_is_beyond_doubt_stays_finite() -> None:
    found = bayes_factor(np.array([1.0]), np.array([[1e-12]]), np.array([1.0]))
    assert 1e250 < found < np.inf


@pytest.mark.parametrize("terms", [(SLOW,), (LATE,), (LATE, SLOW)])
def test_what_is_said_of_the_clocks_makes_the_recording_again(terms):
    """A clock that ran slow was late as well, by its share of half of the recording."""
    found = diagnose_reference(recorded(terms, CONSUMER), captured(), gravity=9.80665)
    assert {f.effect for f in found.findings} == {t.effect for t in terms}
    for term in terms:
        said = next(f.parameters for f in found.findings if f.effect == term.effect)
        for name, value in term.parameters.items():
            assert said[name].value == pytest.approx(value, abs=4 * said[name].sigma)
    said = tuple(
        Term(f.effect, {n: q.value for n, q in f.parameters.items()}) for f in found.findings
    )
    again, real = recorded(said, NoiseModel()), recorded(terms, NoiseModel())
    noise = np.std(recorded(terms, CONSUMER).gyro - real.gyro)
    assert np.std(again.gyro - real.gyro) < 0.2 * noise


def test_an_alignment_has_its_plot() -> None:
    """Residuals without it, against what goes with it, as far as it acts in proportion."""
    late = Term("time_offset", {"delay": 0.01})
    (item,) = diagnose_reference(recorded((late,), CONSUMER), captured(), gravity=9.80665).findings
    assert item.effect == "time_offset"
    assert item.evidence is not None
    assert item.evidence.follows == "derivative of the signal, its sign changed"
    for series in item.evidence.series:
        assert np.square(series.before).sum() > 4 * np.square(series.after).sum()
        assert np.ptp(series.x) > 1.0
