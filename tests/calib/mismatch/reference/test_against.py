"""A recording against the user's own simulation: unequal rates, unequal start times."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from calib.effects.bandwidth import low_pass
from calib.effects.base import Term
from calib.errors import NoCommonMotionError
from calib.mismatch import diagnose_against, diagnose_recording, diagnose_reference
from calib.mismatch.reference.against import compare_simulation
from calib.mismatch.reference.alignment import Alignment, align
from calib.mismatch.reference.band import follows_noise
from calib.mismatch.reference.carried import ARM
from calib.mismatch.reference.comparison import ComparisonProblem
from calib.mismatch.reference.truths import RecordingTruth
from calib.mismatch.samples.samples import look_at_samples
from calib.mismatch.search.accepted import fitted
from calib.mismatch.search.refit import unmoved
from calib.model import SensorModel, Triad
from calib.recording import Recording
from calib.rotation import mat_from_rotvec
from calib.simulate import IDEAL, Sampling, digital_twin, simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.library import make_motion
from calib.simulation.noise import CONSUMER, NoiseModel
from calib.simulation.recorded import motion_of
from calib.statics import find_poses
from imu_cli.report.words import notes

GRAVITY = 9.80665
SHOWN = 30.0
"""What the simulation's clock shows at the true time 0, s."""


@cache
def motion(seed: int = 1) -> Motion:
    rng = np.random.default_rng(seed)
    return bench_protocol(rng, poses=8, first_pose=1.0, pose_duration=(2.0, 3.0))


@cache
def simulation() -> Recording:
    rng = np.random.default_rng(5)
    sampling = Sampling(clock_offset=SHOWN)
    whole = simulate(motion(), SensorModel(), NoiseModel(), rng=rng, rate=80.0, sampling=sampling)
    return whole.slice(100, len(whole))


def sensor(rng: np.random.Generator, *terms: Term) -> SensorModel:
    return SensorModel(
        Triad(
            rng.normal(0, 0.1, 3), rng.normal(0, 0.01, 3), np.tril(rng.normal(0, 0.01, (3, 3)), -1)
        ),
        Triad(rng.normal(0, 0.02, 3), rng.normal(0, 0.01, 3)),
        terms,
    )


def recorded(*terms: Term, seed: int = 2, sampling: Sampling = IDEAL) -> Recording:
    rng = np.random.default_rng(seed)
    model = sensor(rng, *terms)
    return simulate(motion(), model, CONSUMER, rng=rng, rate=50.0, sampling=sampling)


def test_nothing_but_baseline_noise_and_another_start_is_consistent():
    found = diagnose_against(recorded(), simulation(), gravity=GRAVITY)
    assert found.verdict == "consistent"
    assert found.summary["alignment"]["offset"] == pytest.approx(SHOWN, abs=1e-4)


@pytest.mark.parametrize(("start", "stop"), [(0.3, 0.6), (0.55, 1.0)])
def test_an_axis_that_is_late_for_a_while_is_unexplained_there(start: float, stop: float) -> None:
    """It was a clock, an offset, a skew and a nonlinearity; or it was not seen at all."""
    real = recorded()
    begin, end = np.array([start, stop]) * real.time[-1]
    slope = np.gradient(real.gyro[:, 1], real.time)
    within = (real.time >= begin) & (real.time <= end)
    gyro = real.gyro - 1e-3 * (slope * within)[:, None] * [0.0, 1.0, 0.0]
    found = diagnose_against(replace(real, gyro=gyro), simulation(), gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert (left.follows, left.channels) == ("delay in a window", ("gyro.y",))
    (first, last), *_ = left.intervals
    assert min(last, end) - max(first, begin) > 0.5 * (max(last, end) - min(first, begin))


def test_columns_are_made_anew_where_the_alignment_moved():
    real = recorded()
    seen = look_at_samples(real, find_poses(real))
    problem, _ = compare_simulation(real, simulation(), seen, gravity=GRAVITY)
    rows = problem.rows()
    before = fitted(rows, [])
    still = np.zeros(rows.nuisance.shape[1])
    late = np.where([n == "time_offset.delay" for n in rows.aligned], 1.0, 0.0)
    steady = dict.fromkeys(rows.names, 0.0)
    problem.move(steady, still, ())
    assert unmoved(before, problem.rows())
    problem.move(steady, 1e-5 * late, ())
    assert unmoved(before, problem.rows())
    problem.move(steady, 5e-3 * late, ())
    assert not unmoved(before, problem.rows())


def test_baseline_is_found_with_honest_errors():
    found = diagnose_against(recorded(), simulation(), gravity=GRAVITY)
    rng = np.random.default_rng(2)
    bias = rng.normal(0, 0.1, 3)
    sigma = np.sqrt(np.diag(found.covariance))
    off = [
        (found.model.accel.bias[i] - bias[i]) / sigma[found.names.index(f"accel.bias.{a}")]
        for i, a in enumerate("xyz")
    ]
    assert np.abs(off).max() < 4


def test_angles_of_a_calibrated_gyroscope_are_fitted_and_no_effect():
    """A calibration knows them to a few hundredths of a degree, a simulation far better."""
    real = recorded(Term("gyro_misalignment", {"mxy": 0.005, "mzx": -0.004}))
    angles = np.zeros((3, 3))
    angles[0, 1], angles[2, 0] = 0.0054, -0.0043
    known = SensorModel(gyro=Triad(misalignment=angles))
    found = diagnose_against(real, simulation(), gravity=GRAVITY, model=known)
    assert found.verdict == "consistent"
    sigma = dict(zip(found.names, np.sqrt(np.diag(found.covariance)), strict=True))
    left = found.model.gyro.misalignment - angles
    assert left[0, 1] == pytest.approx(-0.0004, abs=3 * sigma["gyro.misalignment.xy"])
    assert left[2, 0] == pytest.approx(0.0003, abs=3 * sigma["gyro.misalignment.zx"])


@pytest.mark.parametrize(
    ("slug", "values"),
    [
        ("accel_lever_arm", {"rx": 0.01, "ry": -0.02, "rz": 0.005}),
        ("gyro_misalignment", {"mxy": 0.005, "mzx": -0.004}),
        ("gyro_bias_step", {"bx": 0.003, "moment": 20.0}),
        ("time_offset", {"gyro_delay": 0.003}),
    ],
)
def test_one_effect_is_found_and_nothing_else(slug, values):
    found = diagnose_against(recorded(Term(slug, values)), simulation(), gravity=GRAVITY)
    assert [item.effect for item in found.findings] == [slug]
    assert not found.unexplained
    held = found.findings[0].held_out
    assert held is None or held.after < held.before
    for name, value in values.items():
        q = found.findings[0].parameters[name]
        assert q.value == pytest.approx(value, abs=5 * q.sigma + 0.02 * abs(value))


def test_gravity_of_another_place_is_no_scale_factor_where_a_hand_moves_the_sensor():
    rng = np.random.default_rng(2)
    there = bench_protocol(
        np.random.default_rng(1), poses=8, first_pose=1.0, pose_duration=(2.0, 3.0), gravity=9.7803
    )
    quiet = NoiseModel(accel_noise_density=4e-4, gyro_noise_density=1e-5)
    real = simulate(there, sensor(rng), quiet, rng=rng, rate=50.0)
    found = diagnose_against(real, simulation(), gravity=GRAVITY)
    assert [item.effect for item in found.findings] == ["gravity_magnitude"]
    assert not found.unexplained
    error = found.findings[0].parameters["error"]
    assert error.value == pytest.approx(9.7803 - GRAVITY, abs=3 * error.sigma)


@pytest.mark.long
def test_steps_go_on_until_nothing_is_left_that_noise_was_taken_for():
    """What another finding had bent raised the noise: a fit beside it ended before its end."""
    real = recorded(Term("time_offset", {"gyro_delay": 0.003}), seed=7)
    found = diagnose_against(real, simulation(), gravity=GRAVITY)
    assert [item.effect for item in found.findings] == ["time_offset"]
    assert not found.unexplained


@pytest.mark.parametrize("seed", [7, 3])
@pytest.mark.long
def test_a_delay_that_a_low_pass_mimics_is_a_tie_and_nothing_is_left(seed):
    real = recorded(Term("time_offset", {"gyro_delay": 0.003}), seed=seed)
    found = diagnose_against(real, simulation(), gravity=GRAVITY)
    (item,) = found.findings
    # A low-pass of 76 Hz is as late, and takes too little of any hand's motion to be told from it.
    assert {item.effect, *(r.effect for r in item.rivals)} == {"time_offset", "bandwidth"}
    assert not found.unexplained


@pytest.mark.long
@pytest.mark.parametrize("delay", [0.01, -0.012])
def test_a_delay_that_is_no_line_is_found_whichever_triad_is_late(delay):
    """An accelerometer that is 12 ms late was two low-passes, and something else."""
    real = recorded(Term("time_offset", {"gyro_delay": delay}), seed=3)
    found = diagnose_against(real, simulation(), gravity=GRAVITY)
    (item,) = found.findings
    assert item.effect == "time_offset"
    value = item.parameters["gyro_delay"]
    assert abs(value.value - delay) < 3 * value.sigma
    assert not item.rivals
    assert not found.unexplained


@pytest.mark.long
@pytest.mark.parametrize(("delay", "seed"), [(-0.045, 10), (0.08, 3)])
def test_a_delay_of_tens_of_milliseconds_is_found_as_it_is_and_alone(delay, seed):
    """Beside one a hand's tremor was noise, and columns were off by as much."""
    real = recorded(Term("time_offset", {"gyro_delay": delay}), seed=seed)
    found = diagnose_against(real, simulation(), gravity=GRAVITY)
    (item,) = found.findings
    assert item.effect == "time_offset"
    value = item.parameters["gyro_delay"]
    assert value.sigma < 1e-4
    assert abs(value.value - delay) < 3 * value.sigma
    assert not found.unexplained
    assert found.verdict == "explained"


def test_a_delay_that_a_calibration_has_is_there_once():
    delay = Term("time_offset", {"gyro_delay": 0.03})
    real, known = recorded(delay, seed=4), SensorModel(terms=(delay,))
    seen = look_at_samples(real, find_poses(real))
    problem, _ = compare_simulation(real, simulation(), seen, gravity=GRAVITY, model=known)
    assert problem.late == 0.0
    found = diagnose_against(real, simulation(), gravity=GRAVITY, model=known)
    assert found.verdict == "consistent"


@pytest.mark.long
def test_other_effects_are_found_beside_a_delay_of_tens_of_milliseconds():
    terms = (
        Term("time_offset", {"gyro_delay": 0.025}),
        Term("gyro_g_sensitivity", {"gxx": 2e-3, "gyz": 1e-3}),
    )
    found = diagnose_against(recorded(*terms, seed=8), simulation(), gravity=GRAVITY)
    assert {f.effect for f in found.findings} == {t.effect for t in terms}
    assert not found.unexplained
    for finding in found.findings:
        truth = next(t.parameters for t in terms if t.effect == finding.effect)
        for name, q in finding.parameters.items():
            assert abs(q.value - truth.get(name, 0.0)) < 3.5 * q.sigma


@pytest.mark.long
def test_a_scale_factor_hides_no_delay():
    """What is late is what the sensor puts out: else 2 % of scale leave 2 % of all that is fast."""
    long = bench_protocol(np.random.default_rng(4), poses=40, pose_duration=(2.0, 3.0))
    rng = np.random.default_rng(3)
    model = SensorModel(
        Triad(np.zeros(3), np.zeros(3)),
        Triad(np.zeros(3), np.array([0.02, -0.03, 0.02])),
        (Term("time_offset", {"gyro_delay": 0.004}),),
    )
    real = simulate(long, model, CONSUMER.scaled(0.2), rng=rng, rate=100.0)
    other = simulate(long, SensorModel(), NoiseModel(), rng=rng, rate=100.0)
    found = diagnose_against(real, other, gravity=GRAVITY)
    (item,) = found.findings
    # A low-pass of second order that comes as late is nearly the same.
    assert item.effect == "time_offset"
    assert {r.effect for r in item.rivals} <= {"bandwidth"}
    assert item.parameters["gyro_delay"].value == pytest.approx(0.004, abs=1e-4)
    assert not found.unexplained


@pytest.mark.long
@pytest.mark.parametrize(
    ("triad", "cutoff", "order", "seed"),
    [
        ("gyro", 20.0, 2, 6),
        ("gyro", 18.0, 1, 2),
        ("gyro", 44.0, 2, 8),
        ("accel", 20.0, 2, 6),
        ("accel", 15.0, 1, 6),
    ],
)
def test_a_low_pass_of_one_triad_is_found_however_strong(triad, cutoff, order, seed):
    """A gyroscope's was a delay, and other things that are not there."""
    shape = {triad: 1.0, f"{triad}_cutoff": cutoff, "order": float(order)}
    found = diagnose_against(
        recorded(Term("bandwidth", shape), seed=seed), simulation(), gravity=GRAVITY
    )
    (item,) = found.findings
    assert item.effect == "bandwidth"
    assert {r.effect for r in item.rivals} <= {"time_offset"}
    assert item.parameters["order"].value == order
    value = item.parameters[f"{triad}_cutoff"]
    assert abs(value.value - cutoff) < 3 * value.sigma
    assert not found.unexplained


@cache
def noisy_simulation(rate: float = 100.0, seed: int = 55) -> Recording:
    rng, sampling = np.random.default_rng(seed), Sampling(clock_offset=SHOWN)
    return simulate(motion(), SensorModel(), CONSUMER, rng=rng, rate=rate, sampling=sampling)


@pytest.mark.long
@pytest.mark.parametrize(("triad", "seed"), [("gyro", 2), ("accel", 3)])
def test_a_low_pass_is_found_beside_a_simulation_as_noisy_as_the_recording(triad, seed):
    """It was a delay, with things beside it that are not there."""
    shape = {triad: 1.0, f"{triad}_cutoff": 12.0, "order": 1.0}
    real = recorded(Term("bandwidth", shape), seed=seed)
    found = diagnose_against(real, noisy_simulation(), gravity=GRAVITY)
    (item,) = found.findings
    assert item.effect == "bandwidth"
    cutoff = item.parameters[f"{triad}_cutoff"]
    assert abs(cutoff.value - 12.0) < 3 * cutoff.sigma
    assert cutoff.sigma < 0.2
    assert item.parameters["order"].value == 1
    assert found.verdict == "explained"


@pytest.mark.long
@pytest.mark.parametrize("delay", [0.012, -0.006])
def test_a_delay_is_no_low_pass_of_a_noisy_simulation(delay):
    real = recorded(Term("time_offset", {"gyro_delay": delay}), seed=2)
    found = diagnose_against(real, noisy_simulation(), gravity=GRAVITY)
    (item,) = found.findings
    assert item.effect == "time_offset"
    value = item.parameters["gyro_delay"]
    assert abs(value.value - delay) < 3.5 * value.sigma
    assert found.verdict == "explained"
    # A short one may be that of a low-pass; ten milliseconds of one would be seen to damp.
    assert {r.effect for r in item.rivals} <= {"bandwidth"}
    assert bool(item.rivals) or abs(delay) > 0.002


def test_a_clock_that_runs_fast_is_found_beside_another_start():
    fast = recorded(sampling=Sampling(clock_offset=100.0, clock_scale=2e-3))
    found = diagnose_against(fast, simulation(), gravity=GRAVITY)
    assert [item.effect for item in found.findings] == ["clock_scale"]
    scale = found.findings[0].parameters["scale"]
    assert scale.value == pytest.approx(2e-3, abs=max(5 * scale.sigma, 2e-6))


def test_alignment_finds_offset_and_stretch():
    real, sim = recorded(sampling=Sampling(clock_offset=-7.0, clock_scale=-1e-3)), simulation()
    found = align(real.time, real.gyro, sim.time, sim.gyro)
    expected = SHOWN + (real.time + 7.0) / (1 - 1e-3)
    assert np.abs(found.times(real.time) - expected).max() < 0.03


def test_a_part_that_moves_is_not_aligned_with_a_rest():
    time = np.arange(0.0, 160.0, 0.01)
    rate = np.zeros((len(time), 3))
    moving = (time > 30.0) & (time < 60.0)
    rate[moving, 0] = np.sin(0.3 * np.square(time[moving] - 30.0))
    rate += np.random.default_rng(3).normal(0.0, 0.02, rate.shape)
    found = align(time[:4500], rate[:4500], time + 5.0, rate)
    assert found.offset == pytest.approx(5.0, abs=0.02)


def test_motion_that_repeats_itself_is_aligned_over_all_of_it():
    time = np.arange(0.0, 120.0, 0.01)
    rate = np.zeros((len(time), 3))
    rate[:, 0] = np.sin(np.pi * time / 20.0) ** 2 * np.sin(np.pi * time / 2.0)
    found = align(time, rate, time - 7.0, rate)
    assert found.offset == pytest.approx(-7.0, abs=0.02)


def test_another_motion_is_an_error_that_says_so():
    rng = np.random.default_rng(8)
    other = simulate(motion(9), SensorModel(), NoiseModel(), rng=rng, rate=80.0)
    with pytest.raises(NoCommonMotionError, match="same motion"):
        diagnose_against(recorded(), other, gravity=GRAVITY)


def test_a_simulation_in_g_is_named_with_its_factor():
    other = simulation()
    (found,) = diagnose_against(
        recorded(), replace(other, accel=other.accel / GRAVITY), gravity=GRAVITY
    ).findings
    assert found.effect == "unit_error"
    assert found.parameters["accel"].value == pytest.approx(GRAVITY - 1.0, rel=0.02)
    assert "it is the simulation that is off: the accelerometer is in g" in found.sentence


def test_what_is_wrong_with_samples_is_to_be_mended_as_without_a_simulation():
    real = recorded()
    gyro = real.gyro.copy()
    gyro[:, 1] = gyro[:, 0]
    twice = replace(real, gyro=gyro)
    alone, beside = (
        diagnose_recording(twice, gravity=GRAVITY),
        diagnose_against(twice, simulation(), gravity=GRAVITY),
    )
    assert beside.verdict == alone.verdict == "unexplained"
    assert beside.missing == alone.missing[-1:]
    assert "a register may be read twice" in beside.missing[0]
    with pytest.raises(NoCommonMotionError, match=r"gyro\.x, gyro\.y: one repeats the other"):
        diagnose_reference(real, replace(twice, time=real.time + 3.0), gravity=GRAVITY)


def test_a_simulation_at_rest_leaves_it_undetermined():
    sim = simulation()
    still = replace(sim, accel=np.tile([0.0, 0.0, GRAVITY], (len(sim), 1)), gyro=0 * sim.gyro)
    found = diagnose_against(recorded(), still, gravity=GRAVITY)
    assert found.verdict == "undetermined"
    assert "motion" in found.missing[0]


@pytest.mark.parametrize("samples", [1, 2, 40])
def test_a_simulation_of_next_to_nothing_leaves_it_undetermined(samples):
    found = diagnose_against(recorded(), simulation().slice(0, samples), gravity=GRAVITY)
    assert found.verdict == "undetermined"
    assert "motion" in found.missing[0]


@pytest.mark.parametrize("every", [50, 100, 300])
def test_a_simulation_of_few_samples_leaves_it_undetermined(every):
    sim = simulation()
    few = Recording(sim.time[::every], sim.accel[::every], sim.gyro[::every], sim.clock)
    assert few.duration > 6.0
    found = diagnose_against(recorded(), few.slice(0, min(len(few), 47)), gravity=GRAVITY)
    assert found.verdict == "undetermined"
    assert "fewer than 48" in found.missing[0]


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_a_twin_of_the_recording_itself_is_no_truth(noise):
    """Its motion holds the recording's noise; one that was simulated does not, shaken or not."""
    real = recorded()
    twin = digital_twin(
        real,
        motion_of(real, SensorModel(), find_poses(real), gravity=GRAVITY),
        SensorModel(),
        CONSUMER.scaled(noise),
        rng=np.random.default_rng(3),
    )
    found = diagnose_against(real, replace(twin, time=twin.time + 60.0), gravity=GRAVITY)
    assert found.verdict == "undetermined"
    assert "--calibration" in found.missing[0]
    truth = simulate(motion(), SensorModel(), CONSUMER, rng=np.random.default_rng(4), rate=50.0)
    shaken = np.zeros_like(real.accel)
    for begin, end in motion().statics[3:6]:
        here = (real.time > begin) & (real.time < end)
        shaken[here] = np.random.default_rng(6).normal(0.0, 0.3, (here.sum(), 3))
    for log in (real, replace(real, accel=real.accel + shaken)):
        for other in (truth, simulation()):
            alignment = align(log.time, log.gyro, other.time, other.gyro)
            assert not follows_noise(log, RecordingTruth(other, GRAVITY), alignment)


@pytest.mark.parametrize("lsb", [0.5, 1.0, 1.02, 1.5, 2.0])
@pytest.mark.parametrize("rate", [125.0, 400.0])
def test_what_steps_in_counts_at_rest_alone_has_no_more_noise_there(lsb, rate):
    """A median of counts is one of them: at rest, beside a simulation that does not move."""
    rng = np.random.default_rng(9)
    time = np.arange(0.0, 120.0, 1.0 / rate)
    turning = np.zeros((len(time), 3))
    turning[:, 1] = np.where(np.sin(0.5 * time) > 0, 6.0 * np.sin(time), 0.0)
    angle = np.cumsum(turning[:, 1]) / rate
    force = GRAVITY * np.stack((np.sin(angle), 0.5 * np.sin(angle), np.cos(angle)), axis=1)
    truth = Recording(time, force, turning, clock="device")
    step = lsb * 0.0024
    accel = np.rint((force + 0.0024 * rng.standard_normal(force.shape)) / step) * step
    gyro = turning + 1e-3 * rng.standard_normal(force.shape)
    real = replace(truth, accel=accel, gyro=gyro)
    assert not follows_noise(real, RecordingTruth(truth, GRAVITY), Alignment(0.0, 0.0, 0.0))


def test_a_motion_that_turns_one_way_on_average_is_at_rest_where_it_rests():
    """What is as slow as its median is loud there: a sensor's low-pass, or a tremor, say."""
    rng = np.random.default_rng(8)
    time = np.arange(8000) / 100.0
    moves = (time > 4.0) & (time < 76.0)
    rate = np.zeros((8000, 3))
    rate[moves, 0] = -0.2 + 2.0 * np.sin(0.7 * time[moves]) ** 3
    slow = moves & (np.abs(rate[:, 0] + 0.2) < 0.1)
    sigma = np.where(slow, 0.03, np.where(moves, 0.012, 0.01))
    force = np.tile([0.0, 0.0, GRAVITY], (8000, 1))
    truth = Recording(time, force, rate, clock="device")
    noise = sigma[:, None] * rng.standard_normal((8000, 3))
    real = replace(truth, accel=force + noise, gyro=rate + 1e-3 * rng.standard_normal((8000, 3)))
    assert not follows_noise(real, RecordingTruth(truth, GRAVITY), Alignment(0.0, 0.0, 0.0))


def turned(accel: bool, gyro: bool) -> tuple[Recording, Recording]:
    """Return a recording of a sensor whose triads are turned by half a degree, and a simulation."""
    rng = np.random.default_rng(4)
    mat = mat_from_rotvec(np.radians([0.3, -0.4, 0.2]))
    still = np.eye(3)
    model = SensorModel(
        Triad.from_matrix(mat if accel else still, np.array([0.1, -0.05, 0.02])),
        Triad.from_matrix(mat if gyro else still, np.array([0.01, 0.0, -0.01])),
    )
    return simulate(motion(), model, CONSUMER, rng=rng, rate=50.0), simulation()


def test_an_accelerometer_with_axes_of_its_own_is_no_effect():
    """Of its angles another convention, or the simulation's own, has the upper triangle."""
    real, simulated = turned(accel=True, gyro=False)
    found = diagnose_against(real, simulated, gravity=GRAVITY)
    assert found.verdict == "consistent"
    assert found.summary["own_axes"]
    values = found.model.accel.parameters("accel")
    sigma = dict(zip(found.names, np.sqrt(np.diag(found.covariance)), strict=True))
    true = Triad.from_matrix(mat_from_rotvec(np.radians([0.3, -0.4, 0.2])), np.zeros(3))
    for name, value in true.parameters("accel").items():
        if ".misalignment." in name:
            assert abs(values[name] - value) < 4 * sigma[name] < 1e-3


def test_a_sensor_that_is_mounted_at_an_angle_is_found():
    found = diagnose_against(*turned(accel=True, gyro=True), gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["reference_misalignment"]
    assert "own_axes" not in found.summary


@pytest.mark.parametrize(
    "term",
    [
        Term("accel_warm_up", {"kx": 0.1, "tau": 40.0}),
        Term("accel_bias_step", {"bx": 0.05, "moment": 20.0}),
        Term("accel_settling", {"kx": 0.05, "tau": 2.0}),
    ],
    ids=lambda term: term.effect,
)
def test_what_else_a_bias_may_do_turns_no_axes(term):
    """Poses are visited in order, so that it goes with the direction of gravity as well."""
    real = recorded(term, seed=5)
    seen = look_at_samples(real, find_poses(real))
    problem, _ = compare_simulation(real, simulation(), seen, gravity=GRAVITY)
    assert not problem.own_axes


@pytest.mark.long
def test_a_gyroscope_with_axes_of_its_own_is_found():
    found = diagnose_against(*turned(accel=False, gyro=True), gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["gyro_misalignment"]
    assert "own_axes" not in found.summary


@pytest.mark.long
def test_a_repeated_sample_is_one_finding():
    term = Term("dropped_samples", {"count": -1.0, "moment": float(motion().turns[3].mean())})
    found = diagnose_against(recorded(term), simulation(), gravity=GRAVITY)
    assert [f.effect for f in found.findings] == ["dropped_samples"]
    assert found.findings[0].parameters["count"].value == -1.0


def test_what_is_at_rest_where_the_other_turns_is_another_motion():
    """Scale factors of nothing would leave less than the other's rotation."""
    real = recorded()
    slow = replace(real, gyro=0.2 * real.gyro[::-1])
    alignment = Alignment(SHOWN, 0.0, 0.0)
    with pytest.raises(NoCommonMotionError, match="100 % of the rotation"):
        ComparisonProblem(slow, RecordingTruth(simulation(), GRAVITY), alignment, gravity=GRAVITY)


@pytest.mark.parametrize("cut", [0.3, 0.5, 0.7])
def test_a_simulation_that_ends_within_a_turn_is_cut_where_it_is_not_known(cut):
    """A spline is loose where its samples end; in a turn that shows."""
    begin, end = motion().turns[-1]
    stop = begin + cut * (end - begin)
    time = np.arange(0.0, stop, 1 / 50)
    sim = simulate(motion(), SensorModel(), NoiseModel(), rng=np.random.default_rng(5), time=time)
    truth = RecordingTruth(sim, GRAVITY)
    at = np.arange(0.0, time[-1], 1 / 400)
    known = truth.covers(at)
    error = np.abs(truth.state(at).rate - motion().state(at).rate).max(axis=1)
    noise = CONSUMER.gyro_noise_density * np.sqrt(50.0)
    assert at[known][-1] > stop - 0.2
    assert error[known & (at > stop - 0.3)].max() < 0.3 * noise < error[~known].max()


@pytest.mark.long
def test_a_simulation_of_few_samples_is_compared_up_to_what_it_resolves():
    """Its spline would err like a low-pass; a motion that is sampled well enough is left whole."""
    few = simulate(motion(), SensorModel(), NoiseModel(), rng=np.random.default_rng(5), rate=20.0)
    found = diagnose_against(
        recorded(Term("gyro_g_sensitivity", {"gxx": 1e-3})), few, gravity=GRAVITY
    )
    assert [f.effect for f in found.findings] == ["gyro_g_sensitivity"]
    assert not found.unexplained
    assert "20 Hz" in found.missing[0]


@pytest.mark.parametrize("part", [slice(None), slice(100, 900)])
def test_a_recording_beside_itself_is_no_comparison(part: slice):
    """Nothing differs, not even noise."""
    real = recorded()
    with pytest.raises(NoCommonMotionError, match="one recording"):
        diagnose_against(real, real.slice(*part.indices(len(real))[:2]), gravity=GRAVITY)
    with pytest.raises(NoCommonMotionError, match="one recording"):
        diagnose_reference(real, real, gravity=GRAVITY)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
def test_a_quiet_sensor_that_flickers_has_nothing_else(seed: int):
    """White noise says little of what it does over seconds."""
    rng = np.random.default_rng(seed)
    quiet = replace(
        CONSUMER,
        accel_noise_density=0.3 * CONSUMER.accel_noise_density,
        gyro_noise_density=0.3 * CONSUMER.gyro_noise_density,
        accel_bias_instability=3.0 * CONSUMER.accel_bias_instability,
        gyro_bias_instability=3.0 * CONSUMER.gyro_bias_instability,
    )
    handled = bench_protocol(rng, poses=16, first_pose=3.0, pose_duration=(3.0, 6.0))
    real = simulate(handled, SensorModel(), quiet, rng=rng, rate=100.0)
    sim = simulate(handled, SensorModel(), NoiseModel(), rng=rng, rate=80.0)
    found = diagnose_against(real, sim, gravity=GRAVITY)
    assert found.verdict == "consistent", [f.effect for f in found.findings]


@pytest.mark.long
def test_an_output_that_wanders_does_not_step() -> None:
    """The first thing to be found is a step, or four, and the rest is what these were part of."""
    real, rng = recorded(seed=2), np.random.default_rng(2)
    accel = real.accel.copy()
    part = slice(int(0.6 * len(real)), len(real))
    steps = rng.normal(0.0, 0.02, accel[part].shape)
    accel[part] += lfilter([1.0], [1.0, -0.98], steps, axis=0)
    found = diagnose_against(replace(real, accel=accel), simulation(), gravity=GRAVITY)
    assert not found.findings
    assert {c.split(".")[0] for u in found.unexplained for c in u.channels} == {"accel"}


@pytest.mark.parametrize("count", [0.0, 0.1])
def test_shorts_within_turns_are_pulses_where_they_are(count: float) -> None:
    """Rests hold one or none of them; where counts are coarse, steps of them are no pulses."""
    real = recorded()
    rests = find_poses(real)
    gyro = real.gyro.copy()
    for a, b in zip(rests.stop[1:-1], rests.start[2:], strict=True):
        middle = (a + b) // 2
        gyro[middle : middle + 5, 1] += 0.02
    if count:
        gyro = count * np.round(gyro / count)
    found = diagnose_against(replace(real, gyro=gyro), simulation(), gravity=GRAVITY)
    there = [u for u in found.unexplained if u.follows == "the time: pulses there"]
    if count:
        assert not there
        return
    (item,) = there
    assert item.channels == ("gyro.y",)
    assert item.intervals[0][0] < real.time[rests.start[2]]
    assert item.intervals[0][1] > real.time[rests.stop[-3]]


def beside_perfect(name: str, seconds: float, term: Term) -> tuple[Recording, Recording]:
    """Return a recording of a motion of the library, and a perfect simulation of it."""
    moves = make_motion(name, rng=np.random.default_rng(48), duration=seconds, gravity=GRAVITY)
    sensor = SensorModel(terms=(term,))
    real = simulate(moves, sensor, CONSUMER, rng=np.random.default_rng(1), rate=100.0)
    rng = np.random.default_rng(2)
    return real, simulate(moves, SensorModel(), NoiseModel(), rng=rng, rate=100.0)


def test_where_neither_turns_the_recording_is_judged_by_itself():
    warming = Term("gyro_warm_up", {"ky": 0.003, "tau": 60.0})
    real, other = beside_perfect("thermal", 200.0, warming)
    found = diagnose_against(real, other, gravity=GRAVITY)
    (item,) = found.findings
    assert "gyro_warm_up" in {item.effect, *(r.effect for r in item.rivals)}
    assert any("judged by itself" in need for need in found.missing)


@pytest.mark.long
@pytest.mark.parametrize("make", ["continuous", "of samples"])
def test_a_low_pass_of_any_make_is_one_finding(make: str):
    """Smoothing of samples has less delay for what it takes away than a filter of the motion."""
    rng = np.random.default_rng(60)
    long = bench_protocol(rng, poses=30, pose_duration=(2.0, 3.0))
    true = simulate(long, SensorModel(), NoiseModel(), rng=rng, rate=100.0)
    cutoff = 20.0
    if make == "continuous":
        passed = low_pass(true.time, true.gyro, cutoff, order=1)
    else:
        gain = 1.0 - np.exp(-2.0 * np.pi * cutoff / 100.0)
        start = (1.0 - gain) * true.gyro[:1]
        passed = lfilter([gain], [1.0, gain - 1.0], true.gyro, axis=0, zi=start)[0]
    gyro = passed + rng.normal(0.0, 6e-4, true.gyro.shape)
    accel = true.accel + rng.normal(0.0, 0.03, true.accel.shape)
    found = diagnose_against(replace(true, accel=accel, gyro=gyro), true, gravity=GRAVITY)
    (item,) = found.findings
    assert item.effect == "bandwidth"
    q = item.parameters["gyro_cutoff"]
    assert q.sigma is not None
    assert abs(q.value - cutoff) < 3.0 * q.sigma < 0.02 * cutoff
    assert item.parameters["order"].value == (1 if make == "continuous" else 0)


@pytest.mark.long
def test_a_pendulum_behind_a_low_pass_is_not_taken_for_one_with_a_cubic_scale():
    """``x'' = -w³/2 - ... w`` of a pendulum: what a low-pass takes away looks like a cube."""
    passed = Term("bandwidth", {"gyro": 1.0, "gyro_cutoff": 25.0})
    real, other = beside_perfect("pendulum", 120.0, passed)
    found = diagnose_against(real, other, gravity=GRAVITY)
    (item,) = found.findings
    assert item.effect == "bandwidth"


def test_a_simulation_of_a_part_is_said_to_be_of_a_part():
    """Of 33 s it knew 13, and the whole was "consistent"."""
    found = diagnose_against(recorded(), simulation().slice(0, 1000), gravity=GRAVITY)
    part = found.summary["compared"]
    assert part["seconds"] == pytest.approx(1000 / 80.0, abs=1.0)
    assert "compared" not in diagnose_against(recorded(), simulation(), gravity=GRAVITY).summary
    (said,) = [note for note in notes(found.to_json()) if note.startswith("Compared")]
    assert "of 32.7 s" in said


@pytest.mark.long
@pytest.mark.parametrize("noise", [NoiseModel(), CONSUMER], ids=["exact", "noisy"])
def test_an_arm_carries_the_errors_of_a_simulated_sensor(noise):
    """Two sensors differ by what the arm makes of either's errors, which is no size of a sensor."""
    rng = np.random.default_rng(7)
    seen = make_motion("bench", rng=rng, duration=90.0, gravity=GRAVITY)
    arm = dict(zip(("rx", "ry", "rz"), (0.04, -0.03, 0.02), strict=True))
    real = simulate(seen, sensor(rng, Term(ARM, arm)), CONSUMER, rng=rng, rate=100.0)
    other = simulate(seen, sensor(rng), noise, rng=rng, rate=200.0)
    found = diagnose_against(real, other, gravity=GRAVITY)
    assert [f.effect for f in found.findings] == [ARM]
    assert found.verdict == "explained"
    for name, q in found.findings[0].parameters.items():
        assert q.value == pytest.approx(arm[name], abs=3.5 * q.sigma)


@pytest.mark.parametrize("name", ["rate-table", "pendulum"])
def test_noise_of_a_simulation_is_no_motion_of_axes_that_hardly_turn(name):
    """The noise of a truth is in the differences and in the columns: that was a gain."""
    rng = np.random.default_rng(3)
    seen = make_motion(name, rng=rng, duration=60.0, gravity=GRAVITY)
    real, other = (
        simulate(seen, SensorModel(), CONSUMER, rng=rng, rate=rate) for rate in (100.0, 200.0)
    )
    found = diagnose_against(real, other, gravity=GRAVITY)
    assert (found.findings, found.unexplained) == ((), ())
    # Its samples are enough for its motion: what differs between them is noise.
    assert not any("higher rate" in item for item in found.missing)
