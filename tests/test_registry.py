"""Every registered thing, whatever it is: a new file is tested here with no edit.

Each registry has its section; add yours below.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.effects import effects
from calib.effects.base import Effect, TransformEffect
from calib.mismatch.hypotheses.score import Stack
from calib.mismatch.noise.contrast import contrast_variance
from calib.mismatch.noise.noise import Whitener, expected_levels, make_whitener
from calib.mismatch.rows.grid import make_grid
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search.ranking import CLAIM, Ranking, make_stack, rank
from calib.mismatch.twin.selfmode import SelfProblem
from calib.model import SensorModel, Triad
from calib.poses import Poses
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER
from calib.solvers import accel_solvers
from calib.solvers.base import AccelSolver
from calib.solvers.quadric import NAMES, UNITS, parameters_of
from calib.statics import find_poses
from drivers.chips import chips, get_chip, normal_name
from drivers.chips.base import Setup
from drivers.emulators import emulators
from drivers.emulators.chips import chip_models
from drivers.transports import make_driver, transports

TESTS = Path(__file__).parent

# ---- accelerometer methods ----


@pytest.mark.parametrize("solver", accel_solvers().values(), ids=lambda solver: solver.name)
def test_an_accelerometer_method_recovers_the_truth_with_honest_errors(
    solver: AccelSolver,
) -> None:
    # Small enough that what the published method drops is below the noise; nothing else is special.
    true = Triad.from_matrix(
        np.diag([1.02, 0.97, 1.01]) + 1e-3 * np.tri(3, k=-1), np.array([0.03, -0.02, 0.04])
    )
    truth = parameters_of(true.matrix, true.bias)
    rng = np.random.default_rng(11)
    sigma, gravity, found = 0.01, 9.80665, []
    for _ in range(50):
        direction = rng.standard_normal((40, 3))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        measured = true.distort(gravity * direction) + sigma * rng.standard_normal((40, 3))
        fit = solver.solve(Poses.from_vectors(measured, sigma=sigma), gravity=gravity)
        error = fit.values - truth
        found.append(error @ np.linalg.solve(fit.covariance, error) / len(error))
        # The Fit says one thing: triad, values and residuals agree.
        assert fit.method == solver.name
        assert (fit.names, fit.units) == (NAMES, UNITS)
        np.testing.assert_allclose(parameters_of(fit.triad.matrix, fit.triad.bias), fit.values)
        assert fit.residuals.shape == (40, 1)
        assert fit.intervals.shape == (40, 2)
        assert 0.5 * sigma < fit.residual_rms < 1.5 * sigma
        assert 1 < fit.condition_number < 100
        assert not fit.undetermined
    assert 0.75 < np.mean(found) < 1.3  # 450 degrees of freedom: 0.07 is one standard deviation
    assert solver.summary


# ---- chips ----


@pytest.mark.parametrize("name", chips())
def test_a_chip_has_its_model_its_exchange_and_its_source(name: str) -> None:
    chip = chips()[name]
    assert name in chip_models(), f"add drivers/emulators/chips/{name}.py with a MODEL"
    assert (TESTS / "drivers/chips/exchanges" / f"{name}.txt").exists()
    assert chip.source
    assert chip.__doc__


@pytest.mark.parametrize("name", chips())
def test_a_chip_s_tables_are_sound(name: str) -> None:
    chip = chips()[name]
    for table in (chip.accel_ranges, chip.gyro_ranges):
        assert len({row.code for row in table}) == len(table)
        for row in table:
            # Counts are 16 bits signed: the range fills them, to the 5 % that gyroscopes leave.
            assert row.full_scale * row.counts == pytest.approx(32768, rel=0.13)
    chip.check(Setup(*chip.default_ranges, chip.default_rate))
    assert {"accel", "gyro", "temperature"} <= set(chip.frame.names or ())
    assert chip.fifo_frame <= chip.fifo_size
    for biases in chip.biases:
        parameters = [field.parameter for field in biases]
        assert len(set(parameters)) == len(parameters)
    for part in (*chip.models.values(), *chip.aliases):
        assert get_chip(part) is chip
        assert get_chip(normal_name(part)) is chip
        assert normal_name(part) in emulators()


def test_no_two_chips_answer_alike() -> None:
    keys = [
        (place, chip.identity.address, value)
        for chip in chips().values()
        for place in chip.addresses
        for value in chip.models
    ]
    assert len(set(keys)) == len(keys)


# ---- transports and emulators ----


@pytest.mark.parametrize("scheme", transports())
def test_a_transport_s_example_makes_a_driver_without_any_io(scheme: str) -> None:
    transport = transports()[scheme]
    assert transport.example.startswith(f"{scheme}://")
    assert not make_driver(transport.example).is_open


@pytest.mark.parametrize("name", emulators())
def test_an_emulator_gives_samples_of_a_resting_sensor(name: str) -> None:
    with make_driver(f"emulator://{name}?speed=0&seed=1") as driver:
        batches = []
        while sum(map(len, batches)) < 100:
            batch = driver.read(5.0)
            assert batch is not None
            batches.append(batch)
    accel = np.concatenate([batch.accel for batch in batches])
    gyro = np.concatenate([batch.gyro for batch in batches])
    # At rest but for a consumer part's errors: 40 mg and 2 °/s, five times over.
    assert np.linalg.norm(accel.mean(axis=0)) == pytest.approx(9.81, abs=2.0)
    assert np.abs(gyro.mean(axis=0)).max() < np.deg2rad(10)


# ---- effects ----

# At rest, and in turns by hand, a sensor shows these by itself; the others need a reference, a
# vibration, the samples themselves (their own tests), or two of a kind.
ELSEWHERE = {"clock_scale", "bandwidth", "dropped_samples"}


def _shows_by_itself(effect: Effect) -> bool:
    readout = isinstance(effect, TransformEffect) and effect.stage == "readout"
    alone = any(not p.reference_only for p in effect.parameters)
    return alone and not readout and effect.slug not in ELSEWHERE and "vibration" not in effect.slug


@pytest.fixture(scope="module")
def bench_problem() -> SelfProblem:
    rng = np.random.default_rng(21)
    motion = bench_protocol(rng, poses=16, first_pose=2.0, pose_duration=(3.0, 4.0))
    model = SensorModel(
        Triad(rng.normal(0, 0.2, 3), rng.normal(0, 0.01, 3)), Triad(rng.normal(0, 0.01, 3))
    )
    recording = simulate(motion, model, CONSUMER, rng=rng, rate=50.0)
    grid = make_grid(recording, find_poses(recording))
    return SelfProblem(grid, None, gravity=9.80665, full_gyro=False)


@pytest.fixture(scope="module")
def clean_rank(bench_problem: SelfProblem) -> tuple[Rows, Stack, Ranking, Whitener]:
    rows = bench_problem.rows()
    stack = make_stack(rows, skip=(), reference=False)
    clean = rank(rows, stack, [], expected_levels(rows))
    mean = np.hstack((rows.baseline, rows.nuisance))
    return rows, stack, clean, make_whitener(rows, clean.levels, contrast_variance(rows), mean)


@pytest.mark.parametrize(
    "effect", [e for e in effects().values() if _shows_by_itself(e)], ids=lambda e: e.slug
)
def test_an_effect_is_found_when_injected_silent_when_absent_and_not_blamed_on_another(
    effect: Effect, clean_rank: tuple[Rows, Stack, Ranking, Whitener]
) -> None:
    rows, stack, clean, whitener = clean_rank
    assert clean.groups[effect.slug] < np.log(CLAIM)
    assert clean.total < np.log(CLAIM)
    every = [c for c in stack if c.name == effect.slug]
    few = min(every, key=lambda c: len(c.index)).parameters
    # The middle shape of the first parameter, or of all that come together only.
    first = [c for c in every if c.parameters == few]
    own = first[len(first) // 2]
    column = stack.of(own) @ np.ones(len(own.index))
    size = np.sqrt(400.0 / np.square(whitener.project(column)).sum())
    injected = replace(rows, residual=rows.residual + size * column)
    found = rank(injected, stack, [], clean.levels)
    assert found.total > np.log(CLAIM)
    share = {g: np.exp(v - max(found.groups.values())) for g, v in found.groups.items()}
    # It leads, or is among those that a recording like this cannot tell from the leader, where only
    # what sizes are typical decides.
    assert share[effect.slug] > 1e-3, sorted(share.items(), key=lambda kv: -kv[1])[:4]
