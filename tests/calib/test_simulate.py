"""The simulator: exact motion, and noise of the stated size."""

import numpy as np
import pytest

from calib.effects.base import Signals, Term
from calib.model import SensorModel
from calib.recording import DeviceInfo, Recording
from calib.rotation import integrate_rate, mat_from_quat, quat_from_rotvec
from calib.simulate import Sampling, simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.kinematics import Motion
from calib.simulation.motions import FACES, paper_sinusoid, pendulum, thermal_soak
from calib.simulation.noise import NoiseModel
from calib.simulation.turntable import turntable

MOTIONS = {
    "bench": lambda: bench_protocol(np.random.default_rng(1), poses=6, first_pose=1.0),
    "bench in the hand": lambda: bench_protocol(
        np.random.default_rng(2), poses=4, mixed=1.0, hold_tremor=0.3
    ),
    "bench that sways": lambda: bench_protocol(
        np.random.default_rng(4), poses=5, first_pose=0.5, sway=1.0, swayed=0.5
    ),
    "paper": paper_sinusoid,
    "pendulum": lambda: pendulum(hold=1.025, amplitude=2.0, duration=12.0),
    "pendulum mounted aslant": lambda: pendulum(
        hold=1.025, duration=12.0, mount=quat_from_rotvec(np.array([0.3, -0.5, 1.0]))
    ),
    "record player": lambda: turntable(spin=5.0),
    "rate table": lambda: turntable((1.0, -3.0), faces=("+z", "-y", "+x"), spin=1.0, tilt=0.05),
    "thermal soak": thermal_soak,
    "bench of one pose": lambda: bench_protocol(np.random.default_rng(3), poses=1),
}
QUIET = NoiseModel()


@pytest.fixture(params=MOTIONS)
def motion(request: pytest.FixtureRequest) -> Motion:
    return MOTIONS[request.param]()


def fine(motion: Motion, rate: float = 2000.0) -> np.ndarray:
    return np.arange(0.0, min(motion.duration, 20.0), 1 / rate)


def test_rate_integrates_to_the_orientation(motion: Motion) -> None:
    found = []
    for rate in (1000.0, 2000.0):
        state = motion.state(fine(motion, rate))
        found.append(state.mat_ns[0] @ mat_from_quat(integrate_rate(state.time, state.rate)))
    # The integral's error is of second order in the step: Richardson's extrapolation removes it,
    # and what is left would be the motion's own.
    half = found[1][::2][: len(found[0])]
    extrapolated = half + (half - found[0]) / 3
    true = motion.state(fine(motion, 1000.0)).mat_ns
    np.testing.assert_allclose(extrapolated, true, atol=2e-9)


def test_angular_acceleration_is_the_derivative_of_the_rate(motion: Motion) -> None:
    time = fine(motion, 20.0)
    h = 1e-4
    slope = (motion.state(time + h).rate - motion.state(time - h).rate) / (2 * h)
    inside = slice(1, -1)
    np.testing.assert_allclose(
        motion.state(time).angular_acceleration[inside], slope[inside], atol=2e-3
    )


def test_force_is_acceleration_and_gravity_in_the_sensor_frame(motion: Motion) -> None:
    time = fine(motion, 20.0)[1:-1]
    h = 1e-4
    path = [motion.kinematics(t).path for t in (time - h, time, time + h)]
    state = motion.state(time)
    if path[1] is None:
        acceleration = np.zeros((len(time), 3))
    else:
        acceleration = (path[2].velocity - path[0].velocity) / (2 * h)
        velocity = (path[2].position - path[0].position) / (2 * h)
        np.testing.assert_allclose(path[1].velocity, velocity, atol=1e-4)
    in_n = np.einsum("nij,nj->ni", state.mat_ns, state.force)
    in_n[:, 2] -= motion.gravity
    np.testing.assert_allclose(in_n, acceleration, atol=5e-3)


@pytest.mark.parametrize("name", ["bench", "pendulum", "record player", "rate table"])
def test_statics_are_at_rest(name: str) -> None:
    motion = MOTIONS[name]()
    assert len(motion.statics)
    for start, stop in motion.statics:
        state = motion.state(np.linspace(start, stop, 50))
        np.testing.assert_allclose(state.rate, 0.0, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(state.force, axis=1), motion.gravity, rtol=1e-12)


def test_since_turn_counts_from_the_end_of_each_turn() -> None:
    motion = MOTIONS["bench"]()
    start, stop = motion.turns[1]
    since = motion.state(np.array([0.0, 0.5 * (start + stop), stop + 0.25])).since_turn
    np.testing.assert_allclose(since, [np.inf, 0.5 * (start + stop) - motion.turns[0, 1], 0.25])


def test_without_noise_the_recording_is_the_model() -> None:
    motion = MOTIONS["bench"]()
    recording = simulate(motion, SensorModel(), QUIET, rng=np.random.default_rng(0), rate=100.0)
    state = motion.state(recording.time)
    np.testing.assert_array_equal(recording.accel, state.force)
    np.testing.assert_array_equal(recording.gyro, state.rate)
    assert recording.device.rate == 100.0


def test_device_rounds_and_clips() -> None:
    device = DeviceInfo(accel_lsb=0.5, accel_full_scale=8.0, gyro_lsb=0.25, gyro_full_scale=1.0)
    recording = simulate(
        MOTIONS["bench"](),
        SensorModel(),
        QUIET,
        rng=np.random.default_rng(0),
        rate=100.0,
        device=device,
    )
    assert set(np.unique(recording.accel % 0.5)) == {0.0}
    assert recording.accel.max() == 7.5
    assert recording.gyro.min() == -1.0
    assert recording.gyro.max() == 0.75


def test_clock_and_lost_samples() -> None:
    sampling = Sampling(clock_offset=5.0, clock_scale=1e-3, jitter=1e-3, lost=0.01, lost_run=2.0)
    recording = simulate(
        MOTIONS["bench"](),
        SensorModel(),
        QUIET,
        rng=np.random.default_rng(4),
        rate=100.0,
        sampling=sampling,
    )
    assert recording.samples_lost > 0
    index = np.cumsum(recording.lost + 1) - 1
    np.testing.assert_allclose(recording.time, 5.0 + 1.001 * index / 100.0, atol=0.0041)
    assert np.std(recording.time - 5.0 - 1.001 * index / 100.0) == pytest.approx(1e-3, rel=0.2)


def allan_variance(rate: np.ndarray, step: float, average: float) -> float:
    """Overlapping Allan variance by its definition, at one averaging time."""
    m = round(average / step)
    total = np.concatenate([[0.0], np.cumsum(rate)]) * step
    second = total[2 * m :] - 2 * total[m:-m] + total[: -2 * m]
    return float(np.mean(second**2) / (2 * (m * step) ** 2))


def drawn(model: NoiseModel, *, seconds: float, rate: float) -> Signals:
    return model.draw(np.arange(0, seconds, 1 / rate), rng=np.random.default_rng(7))


def test_white_noise_has_its_density() -> None:
    noise = drawn(NoiseModel(gyro_noise_density=1e-3), seconds=1000, rate=50.0)
    assert np.std(noise.gyro) == pytest.approx(1e-3 * np.sqrt(25.0), rel=0.01)
    found = np.mean([allan_variance(noise.gyro[:, i], 0.02, 1.0) for i in range(3)])
    assert found == pytest.approx(1e-6 / 2, rel=0.1)
    assert not noise.accel.any()


def test_bias_instability_has_its_floor() -> None:
    noise = drawn(NoiseModel(accel_bias_instability=1e-3), seconds=20000, rate=10.0)
    for average in (2.0, 20.0, 200.0):
        found = np.mean([allan_variance(noise.accel[:, i], 0.1, average) for i in range(3)])
        assert np.sqrt(found) == pytest.approx(np.sqrt(2 * np.log(2) / np.pi) * 1e-3, rel=0.15)


def test_random_walk_grows_as_it_should() -> None:
    noise = drawn(NoiseModel(gyro_random_walk=1e-3), seconds=20000, rate=10.0)
    for average in (10.0, 100.0):
        found = np.mean([allan_variance(noise.gyro[:, i], 0.1, average) for i in range(3)])
        assert found == pytest.approx(1e-6 * average / 3, rel=0.2)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({}, "rate"),
        ({"rate": -1.0}, "rate"),
        ({"rate": 1.0, "time": np.zeros(2)}, "rate"),
        ({"time": np.zeros(2)}, "time"),
    ],
)
def test_sample_times_are_checked(arguments: dict, name: str) -> None:
    with pytest.raises(ValueError, match=f"`{name}`"):
        simulate(
            MOTIONS["bench"](), SensorModel(), QUIET, rng=np.random.default_rng(0), **arguments
        )


def test_noise_model_refuses_negative_sizes() -> None:
    with pytest.raises(ValueError, match="`gyro_noise_density`"):
        NoiseModel(gyro_noise_density=-1.0)


def test_paper_sinusoid_is_the_stated_attitude() -> None:
    time = np.linspace(0.0, 100.0, 201)
    roll = np.pi * np.sin(2 * np.pi * 0.05 * time)
    pitch = np.pi / 2 * np.sin(2 * np.pi * 0.031 * time + 0.3)
    expected = 9.80665 * np.stack(
        [-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=1
    )
    np.testing.assert_allclose(paper_sinusoid().state(time).force, expected, atol=1e-12)


def test_pendulum_solves_its_equation_of_motion() -> None:
    """Against numerical integration of theta'' = -(g / l) sin theta."""
    from scipy.integrate import solve_ivp

    motion = pendulum(amplitude=2.5, length=0.7, distance=0.3, hold=0.0, duration=10.0)
    time = np.linspace(0.0, 10.0, 101)[1:]
    k = 9.80665 / 0.7
    solved = solve_ivp(
        lambda _, y: [y[1], -k * np.sin(y[0])],
        (0, 10),
        [2.5, 0.0],
        t_eval=time,
        rtol=1e-10,
        atol=1e-12,
    )
    theta, rate = solved.y
    state = motion.state(time)
    np.testing.assert_allclose(state.rate[:, 0], rate, atol=1e-6)
    # A bead on a rigid rod: the rod pulls with g cos + d rate², and pushes with g sin (1 - d/l).
    np.testing.assert_allclose(
        state.force[:, 2], 9.80665 * np.cos(theta) + 0.3 * rate**2, atol=1e-5
    )
    push = 9.80665 * np.sin(theta) * (1 - 0.3 / 0.7)
    np.testing.assert_allclose(state.force[:, 1], push, atol=1e-5)


def test_a_small_pendulum_swings_in_its_small_angle_period() -> None:
    motion = pendulum(amplitude=1e-3, length=0.5, hold=0.0)
    period = 2 * np.pi * np.sqrt(0.5 / 9.80665)
    later = motion.state(np.array([0.1, 0.1 + 5 * period])).rate[:, 0]
    assert later[1] == pytest.approx(later[0], rel=1e-4)


def test_turntable_feels_its_rate_and_the_centripetal_acceleration() -> None:
    motion = turntable((3.0,), faces=("+z", "-x"), offset=(0.1, 0.0, 0.0), spin=4.0)
    spins = [s for s in motion.segments if s.kind == "spin"]
    assert [s.label for s in spins] == ["+z at 171.887 dps", "-x at 171.887 dps"]
    first, second = (motion.state(np.linspace(s.start, s.stop, 9)) for s in spins)
    np.testing.assert_allclose(first.rate, np.tile([0, 0, 3.0], (9, 1)), atol=1e-12)
    np.testing.assert_allclose(first.force, np.tile([-0.9, 0, 9.80665], (9, 1)), atol=1e-12)
    np.testing.assert_allclose(second.rate, np.tile([-3.0, 0, 0], (9, 1)), atol=1e-12)
    np.testing.assert_allclose(second.force[:, 0], -9.80665, atol=1e-12)
    assert np.linalg.norm(second.force[:, 1:], axis=1) == pytest.approx(np.full(9, 0.9))


def test_faces_have_their_axis_up() -> None:
    for face, quat in FACES.items():
        up = mat_from_quat(quat)[2]
        assert up["xyz".index(face[1])] == pytest.approx(1.0 if face[0] == "+" else -1.0)


def test_thermal_soak_follows_the_chamber() -> None:
    motion = thermal_soak(temperatures=(20.0, 50.0), dwell=300.0, ramp=300.0, lag=30.0)
    assert motion.temperature is not None
    t = motion.temperature(np.array([0.0, 300.0, 500.0, 600.0, 900.0]))
    # In the middle of a long ramp the sensor is behind by lag times the slope of 0.1 K/s.
    np.testing.assert_allclose(t, [20.0, 20.0, 37.0 + 3 * np.exp(-200 / 30), 47.0, 50.0], atol=2e-3)
    assert motion.state(np.array([450.0])).temperature_rate == pytest.approx(0.1, rel=0.01)


def test_motions_check_their_arguments() -> None:
    rng = np.random.default_rng(0)
    for make, name in (
        (lambda: bench_protocol(rng, poses=0), "poses"),
        (lambda: bench_protocol(rng, turn_duration=(2.0, 1.0)), "turn_duration"),
        (lambda: paper_sinusoid(duration=0.0), "duration"),
        (lambda: pendulum(amplitude=4.0), "amplitude"),
        (lambda: turntable(faces=("up",)), "faces"),
        (lambda: turntable(spin=0.0), "spin"),
        (lambda: thermal_soak(temperatures=()), "temperatures"),
    ):
        with pytest.raises(ValueError, match=f"`{name}`"):
            make()


def test_vibration_shakes_some_poses_and_nothing_else() -> None:
    motion = bench_protocol(np.random.default_rng(9), poses=20, vibration=1.5)
    recording = simulate(motion, SensorModel(), QUIET, rng=np.random.default_rng(0), rate=200.0)
    left = recording.accel - motion.state(recording.time).force
    sizes = []
    for start, stop in motion.statics:
        inside = (recording.time > start) & (recording.time < stop)
        sizes.append(np.std(left[inside]))
    shaken = np.array(sizes) > 0.5
    assert 0 < shaken.sum() < 20
    np.testing.assert_allclose(np.array(sizes)[shaken], 1.5, rtol=0.15)
    assert not np.array(sizes)[~shaken].any()
    start, stop = motion.turns[0]
    assert not left[(recording.time > start) & (recording.time < stop)].any()


def test_sway_moves_some_poses_and_fades_in_the_turns_beside_them() -> None:
    options = {"poses": 20, "tremor": 0.0}
    still = bench_protocol(np.random.default_rng(9), **options)
    swaying = bench_protocol(np.random.default_rng(9), **options, sway=1.0, swayed=0.4)
    angles = []
    for start, stop in still.statics:
        time = np.linspace(start, stop, 200)
        change = still.state(time).mat_ns.transpose(0, 2, 1) @ swaying.state(time).mat_ns
        angles.append(np.sqrt(np.mean(np.square(change - np.eye(3)))))
    moved = np.array(angles) > 1e-6
    assert 2 < moved.sum() < 14
    # Each axis by 0.2 degrees: two of three elements of the skew matrix a row.
    size = np.sqrt(np.mean(np.square(np.array(angles)[moved])))
    np.testing.assert_allclose(np.degrees(size) * np.sqrt(1.5), 0.2, rtol=0.25)


def test_vibration_rectifies() -> None:
    motion = bench_protocol(np.random.default_rng(9), poses=20, vibration=2.0)
    model = SensorModel(terms=(Term("gyro_vibration_rectification", {"kx": 1e-3}),))
    recording = simulate(motion, model, QUIET, rng=np.random.default_rng(0), rate=100.0)
    state = motion.state(recording.time)
    assert state.vibration is not None
    expected = np.where(state.vibration[:, 0] > 0, 1e-3 * 12.0, 0.0)
    np.testing.assert_allclose(recording.gyro[:, 0] - state.rate[:, 0], expected, atol=1e-12)


def test_samples_that_a_clock_does_not_miss_are_not_made_up_at_the_end() -> None:
    motion = bench_protocol(np.random.default_rng(6), poses=3, first_pose=1.0)

    def record(*terms: Term) -> Recording:
        return simulate(
            motion, SensorModel(terms=terms), QUIET, rng=np.random.default_rng(0), rate=50.0
        )

    whole, moment = record(), 5.0
    short = record(Term("dropped_samples", {"count": 3.0, "moment": moment}))
    at = int(np.searchsorted(short.time, moment))
    assert len(short.time) == len(whole.time) - 3
    np.testing.assert_array_equal(short.time, whole.time[:-3])
    np.testing.assert_allclose(short.gyro[at:], whole.gyro[at + 3 :], atol=1e-12)
    # Repeated samples push others out of the end, where nothing is missing.
    assert len(record(Term("dropped_samples", {"count": -3.0, "moment": moment})).time) == len(
        whole.time
    )


@pytest.mark.parametrize("scale", [-0.01, 0.01])
def test_a_recording_by_a_slow_clock_ends_with_the_motion(scale: float) -> None:
    """Nothing stands still after it."""
    motion = paper_sinusoid()
    model = SensorModel(terms=(Term("clock_scale", {"scale": scale}),))
    found = simulate(motion, model, QUIET, rng=np.random.default_rng(0), rate=100.0)
    end = motion.duration * min(1.0, 1.0 + scale)
    assert found.time[-1] == pytest.approx(end, abs=0.02)
    true = motion.state(found.time / (1.0 + scale))
    np.testing.assert_allclose(found.gyro, true.rate, atol=1e-4)


@pytest.mark.parametrize("scale", [0.0, 0.05, -0.05])
@pytest.mark.parametrize("offset", [0.0, 1000.0])
def test_moments_are_read_off_the_clock_of_the_sensor(scale: float, offset: float) -> None:
    motion = paper_sinusoid()
    step = Term("gyro_bias_step", {"bx": 0.5, "moment": offset + 50.0037})
    with_step, without = (
        simulate(
            motion,
            SensorModel(terms=terms),
            QUIET,
            rng=np.random.default_rng(0),
            rate=100.0,
            sampling=Sampling(clock_offset=offset, clock_scale=scale),
        )
        for terms in ((step,), ())
    )
    stepped = with_step.gyro[:, 0] - without.gyro[:, 0] > 0.25
    np.testing.assert_array_equal(stepped, with_step.time > offset + 50.0037)


def test_samples_that_are_gone_after_the_end_leave_the_rest_as_it_is() -> None:
    motion = bench_protocol(np.random.default_rng(6), poses=3, first_pose=1.0)
    end = motion.duration

    def record(moment: float) -> Recording:
        model = SensorModel(terms=(Term("dropped_samples", {"count": 50.0, "moment": moment}),))
        return simulate(motion, model, QUIET, rng=np.random.default_rng(0), rate=50.0)

    whole = record(end + 1.0)
    assert len(whole) == int(end * 50) + 1
    # Only what is after the moment has moved up.
    near = record(whole.time[-10])
    assert len(near) == len(whole) - 10
    np.testing.assert_array_equal(near.gyro, whole.gyro[:-10])


@pytest.mark.parametrize("rate", [40.0, 100.0])
def test_what_is_late_is_the_motion_however_few_samples_it_has(rate: float) -> None:
    delay = 0.0065
    motion = bench_protocol(np.random.default_rng(2), poses=4, pose_duration=(1.0, 2.0))
    time = np.arange(0.5, motion.duration - 0.5, 1 / rate)
    late, prompt = (
        simulate(
            motion, SensorModel(terms=terms), QUIET, rng=np.random.default_rng(0), time=at
        ).gyro
        for terms, at in (
            ((Term("time_offset", {"gyro_delay": delay}),), time),
            ((), time - delay),
        )
    )
    inner = slice(20, -20)
    np.testing.assert_allclose(late[inner], prompt[inner], atol=3e-4)
