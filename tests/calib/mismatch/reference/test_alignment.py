"""Two clocks that show the same motion: where one starts in the other, and how fast it runs."""

from functools import cache

import numpy as np
import pytest

from calib.errors import NoCommonMotionError
from calib.mismatch import diagnose_against
from calib.mismatch.reference.alignment import align
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.library import make_motion
from calib.simulation.noise import CONSUMER, NoiseModel

GRAVITY, START = 9.80665, 50.0


@cache
def pair(name: str, seconds: float, seed: int = 2) -> tuple[Recording, Recording]:
    """Return a recording, and the truth of some seconds less at another rate."""
    rng = np.random.default_rng(seed)
    motion = make_motion(name, rng=rng, duration=seconds, gravity=GRAVITY)
    real = simulate(motion, SensorModel(), CONSUMER, rng=rng, rate=100.0)
    truth = simulate(motion, SensorModel(), NoiseModel(), rng=rng, rate=80.0)
    return real, truth.slice(240, len(truth) - 160)


@pytest.mark.parametrize("faster", [0.0, -0.002, 0.005, -0.01, 0.02, -0.04, 0.08])
@pytest.mark.parametrize("name", ["bench", "hand-held", "pendulum", "rate-table"])
@pytest.mark.parametrize("seconds", [60.0, 120.0])
def test_clocks_that_run_apart_are_brought_together(
    name: str, seconds: float, faster: float
) -> None:
    """What repeats itself matches at other times nearly as well, unless it is stretched."""
    real, truth = pair(name, seconds)
    found = align(real.time, real.gyro, START + (1.0 + faster) * truth.time, truth.gyro)
    off = found.times(real.time) - (START + (1.0 + faster) * real.time)
    assert np.abs(off).max() < 0.02
    assert found.moments(found.times(real.time)) == pytest.approx(real.time, abs=1e-9)


@pytest.mark.parametrize("torn", ["recording", "truth", "both"])
def test_a_gap_that_hides_the_fastest_turn_moves_no_clock(torn: str) -> None:
    real, truth = pair("bench", 60.0)
    size = np.linalg.norm(truth.gyro, axis=1)
    fastest = float(truth.time[int(np.argmax(size))])
    kept = [
        np.abs(r.time - fastest - shift) > 0.4 if torn in (name, "both") else np.ones(len(r), bool)
        for r, name, shift in ((real, "recording", 0.0), (truth, "truth", 0.2))
    ]
    times = real.time[kept[0]], START + truth.time[kept[1]]
    found = align(times[0], real.gyro[kept[0]], times[1], truth.gyro[kept[1]])
    assert found.correlation > 0.99
    assert np.abs(found.times(real.time) - START - real.time).max() < 2e-3


def test_where_little_is_beside_anything_else_nothing_is_a_gap() -> None:
    """A log that wrote four samples of every forty is aligned by what is between them as well."""
    real, truth = pair("bench", 60.0)
    some = np.arange(len(truth)) % 40 < 4
    found = align(real.time, real.gyro, START + truth.time[some], truth.gyro[some])
    assert np.abs(found.times(real.time) - START - real.time).max() < 0.1


@pytest.mark.long
def test_a_rate_that_is_named_wrong_by_far_is_the_clock_and_nothing_else() -> None:
    real, truth = pair("bench", 120.0)
    late = Recording(1.03 * real.time, real.accel, real.gyro, real.clock)
    found = diagnose_against(late, truth, gravity=GRAVITY)
    (item,) = found.findings
    assert item.effect == "clock_scale"
    scale = item.parameters["scale"]
    assert scale.sigma is not None
    assert scale.value == pytest.approx(0.03, abs=4 * scale.sigma + 1e-6)
    assert not found.unexplained


@pytest.mark.parametrize("seed", [3, 4])
def test_however_stretched_another_motion_is_another(seed: int) -> None:
    real, _ = pair("bench", 120.0)
    _, other = pair("bench", 120.0, seed)
    with pytest.raises(NoCommonMotionError, match="same motion"):
        diagnose_against(real, other, gravity=GRAVITY)


@pytest.mark.parametrize("dps", [5.0, 200.0])
def test_a_rate_that_never_changes_is_said_to_align_nothing(dps: float) -> None:
    """A table's profile of one rate "does not turn", and its unit was to be checked."""
    real, _ = pair("bench", 60.0)
    time = np.arange(0.0, 90.0, 0.1)
    rate = np.tile([0.0, 0.0, np.radians(dps)], (len(time), 1))
    with pytest.raises(NoCommonMotionError, match=r"at one rate all along.*spin-up") as caught:
        align(real.time, real.gyro, time, rate)
    assert f"{dps:.3g} dps" in str(caught.value)
    assert "unit" not in str(caught.value)
    with pytest.raises(NoCommonMotionError, match="does not turn"):
        align(real.time, real.gyro, time, 0.0 * rate)
