"""Whether samples resolve the turns."""

import numpy as np
import pytest

from calib.mismatch import diagnose_recording
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.rows.resolved import TERMS, _differences, are_resolved
from calib.mismatch.twin.selfmode import SelfProblem
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.statics import find_poses

from ..bench import GRAVITY


def shaky(rate: float, tremor: float, *, noise: float = 0.3, seed: int = 7012) -> Recording:
    rng = np.random.default_rng(seed)
    motion = bench_protocol(rng, poses=24, tremor=tremor)
    return simulate(motion, SensorModel(), CONSUMER.scaled(noise), rng=rng, rate=rate)


@pytest.mark.parametrize(
    ("rate", "tremor", "noise", "resolved"),
    [(25.0, 3.0, 0.3, False), (50.0, 1.0, 0.3, True), (100.0, 3.0, 0.3, True), (400, 1, 10, True)],
)
def test_a_hand_that_trembles_is_resolved_by_samples_that_are_fast_enough(
    rate: float, tremor: float, noise: float, resolved: bool
) -> None:
    made = shaky(rate, tremor, noise=noise)
    grid = make_grid(made, find_poses(made))
    rows = SelfProblem(grid, None, gravity=GRAVITY, full_gyro=False).rows()
    assert are_resolved(rows) == resolved
    assert are_resolved(rows.without(rows.channel < 0))


def test_what_a_cubic_misses_are_the_differences_that_follow() -> None:
    """Of a cosine everything is known: the integral between two samples, and what the rule has."""
    for w in (0.2, 0.5, 0.8):
        exact = 2.0 * np.sin(w / 2) / w
        cubic = (13.0 * 2.0 * np.cos(w / 2) - 2.0 * np.cos(3 * w / 2)) / 24.0
        time = np.arange(-20, 21.0) - 0.5
        made = [
            factor * _differences(np.cos(w * time)[:, None], weights, np.array([0, len(time)]))
            for factor, weights in TERMS
        ]
        # Halfway between the two samples on either side of the top.
        first, second = (values[20:22, 0].mean() for values in made)
        assert exact - cubic == pytest.approx(first, rel=0.25 * w**2)
        assert exact - cubic == pytest.approx(first + second, rel=0.06 * w**4)


def test_ends_of_turns_have_no_differences_of_their_own() -> None:
    values = np.random.default_rng(1).normal(size=(30, 3))
    first = np.array([0, 12, 30])
    found = _differences(values, TERMS[0][1], first)
    for edge in (0, 12, 30):
        assert not found[max(edge - 2, 0) : edge + 2].any()
    assert found[6, 1] == pytest.approx(np.diff(values[4:9, 1], 4)[0])


@pytest.mark.long
@pytest.mark.parametrize("seed", [7000, 7012])
def test_what_samples_do_not_resolve_is_no_low_pass(seed: int) -> None:
    found = diagnose_recording(shaky(25.0, 3.0, seed=seed), gravity=GRAVITY)
    assert "bandwidth" not in {f.effect for f in found.findings}
