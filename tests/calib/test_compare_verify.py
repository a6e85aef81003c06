"""A calibration against another, and against a new recording: what changed is named."""

from dataclasses import replace

import numpy as np
import pytest

from calib.calibrate import calibrate
from calib.calibration import Calibration, Gravity
from calib.compare import compare
from calib.effects.base import Term
from calib.errors import InsufficientMotionError
from calib.model import SensorModel, Triad
from calib.recording import DeviceInfo, Recording
from calib.simulate import NoiseModel, simulate
from calib.simulation.bench import bench_protocol
from calib.verify import verify

NOISE = NoiseModel(accel_noise_density=2e-3, gyro_noise_density=2e-4, gyro_bias_instability=3e-5)


def sensor(rng: np.random.Generator) -> SensorModel:
    return SensorModel(
        Triad(
            rng.normal(0, 0.2, 3),
            rng.normal(0, 0.02, 3),
            np.tril(rng.normal(0, 0.01, (3, 3)), -1),
        ),
        Triad(
            rng.normal(0, 0.02, 3),
            rng.normal(0, 0.02, 3),
            rng.normal(0, 0.01, (3, 3)) * (1 - np.eye(3)),
        ),
    )


def record(
    model: SensorModel,
    rng: np.random.Generator,
    poses: int = 20,
    serial: str = "1",
    temperature: float = 28.0,
) -> Recording:
    motion = bench_protocol(rng, poses=poses, temperature=temperature, warm_up=2.0)
    device = DeviceInfo("simulated", serial)
    return simulate(motion, model, NOISE, rng=rng, rate=50.0, device=device)


def changed(model: SensorModel, name: str, by: float) -> SensorModel:
    triad = name.split(".")[0]
    old = getattr(model, triad)
    moved = old.with_parameters({name: old.parameters(triad)[name] + by})
    return replace(model, **{triad: moved})


@pytest.fixture(scope="module")
def known() -> tuple[SensorModel, Calibration]:
    rng = np.random.default_rng(11)
    model = sensor(rng)
    return model, calibrate(record(model, rng), gravity=9.80665)


def test_an_unchanged_device_passes(known: tuple[SensorModel, Calibration]) -> None:
    model, calibration = known
    for seed, poses in enumerate([1, 2, 4, 8, 16, 24]):
        answer = verify(calibration, record(model, np.random.default_rng(seed), poses))
        assert answer.right, (poses, answer.failed)
        assert not answer.identity
        assert {check.name for check in answer.checks} >= {"gravity", "rest"}


@pytest.mark.parametrize(
    ("name", "by", "check"),
    [
        ("accel.bias.x", 0.02, "gravity"),
        ("accel.scale_factor_error.z", 0.002, "gravity"),
        ("accel.misalignment.yx", 0.004, "gravity"),
        ("gyro.bias.y", np.radians(0.06), "rest"),
        ("gyro.scale_factor_error.x", 0.004, "turns"),
        ("gyro.misalignment.xy", 0.004, "turns"),
    ],
)
def test_a_change_is_found_and_named(
    known: tuple[SensorModel, Calibration], name: str, by: float, check: str
) -> None:
    model, calibration = known
    new = record(changed(model, name, by), np.random.default_rng(5))
    answer = verify(calibration, new)
    assert not answer.right
    assert check in {item.name for item in answer.failed}
    assert answer.comparison is not None
    assert answer.comparison.changed[0].name == name
    assert answer.comparison.changed[0].difference == pytest.approx(by, rel=0.25)
    fresh = compare(calibration, calibrate(new, gravity=9.80665))
    assert not fresh.same
    assert name in {item.name for item in fresh.changed}


def test_one_pose_is_enough_to_see_a_bias(known: tuple[SensorModel, Calibration]) -> None:
    model, calibration = known
    moved = changed(model, "gyro.bias.z", np.radians(0.5))
    answer = verify(calibration, record(moved, np.random.default_rng(3), poses=1))
    assert [check.name for check in answer.failed] == ["rest"]
    assert answer.comparison is None


def test_another_temperature_is_allowed_for_and_said(
    known: tuple[SensorModel, Calibration],
) -> None:
    model, calibration = known
    tempco = Term("gyro_bias_temperature", {f"k{a}": np.radians(0.03) for a in "xyz"})
    warm = replace(model, terms=(tempco,), reference_temperature=29.0)
    new = record(warm, np.random.default_rng(4), temperature=45.0)
    answer = verify(calibration, new)
    assert answer.right
    assert any("above the calibrated" in remark for remark in answer.remarks)
    calibration = replace(calibration, temperature=None)
    assert not verify(calibration, new).right


def test_without_temperature_it_says_so(known: tuple[SensorModel, Calibration]) -> None:
    model, calibration = known
    new = replace(record(model, np.random.default_rng(12)), temperature=None)
    answer = verify(calibration, new)
    assert answer.right
    assert any("temperature is not known" in remark for remark in answer.remarks)


def test_a_model_with_terms_is_verified_as_a_whole(
    known: tuple[SensorModel, Calibration],
) -> None:
    model, calibration = known
    term = Term("gyro_g_sensitivity", {"gxz": 4e-4, "gyx": -3e-4})
    new = record(replace(model, terms=(term,)), np.random.default_rng(6))
    assert not verify(calibration, new).right
    with_term = replace(calibration, model=replace(calibration.model, terms=(term,)))
    assert verify(with_term, new).right


def test_another_device_is_said(known: tuple[SensorModel, Calibration]) -> None:
    model, calibration = known
    answer = verify(calibration, record(model, np.random.default_rng(7), 3, serial="2"))
    assert "serial number is 2, that of the calibration 1" in answer.identity


def test_no_pose_no_answer(known: tuple[SensorModel, Calibration]) -> None:
    moving = record(known[0], np.random.default_rng(8), 2).slice(0, 5)
    with pytest.raises(InsufficientMotionError, match="no static pose"):
        verify(known[1], moving)


@pytest.mark.parametrize("factor", [np.array([1.0, 0.0, 1.0]), np.full(3, 0.5), -np.ones(3)])
def test_what_cannot_be_calibrated_by_itself_is_still_judged(
    known: tuple[SensorModel, Calibration], factor: np.ndarray
) -> None:
    # A dead axis, and five poses of which the first half is in another unit, or upside down.
    model, calibration = known
    recording = record(model, np.random.default_rng(18), 6)
    odd = np.array(recording.accel)
    part = slice(None) if not factor.all() else slice(0, len(odd) // 2)
    odd[part] *= factor
    answer = verify(calibration, replace(recording, accel=odd))
    assert not answer.right
    assert {check.name for check in answer.failed} >= {"turns"}


def test_calibrations_of_one_device_agree_as_their_covariances_say() -> None:
    scores = []
    for seed in range(6):
        rng = np.random.default_rng(100 + seed)
        model = sensor(rng)
        first, second = (calibrate(record(model, rng, 16), gravity=9.80665) for _ in range(2))
        answer = compare(first, second)
        assert answer.rank == 21
        assert answer.same, answer.changed
        scores.append(answer.chi_square / answer.rank)
    # 6 x 21 squares over covariances of about 20 degrees of freedom, biases within allowances.
    assert 0.4 < np.mean(scores) < 1.7


def test_gravity_and_what_one_alone_determines(known: tuple[SensorModel, Calibration]) -> None:
    model, _ = known
    new = record(model, np.random.default_rng(9))
    here, there = (calibrate(new, gravity=Gravity(g)) for g in (9.80665, 9.78))
    assert compare(here, there).chi_square < 1e-3
    part = replace(
        here, names=here.names[:-1], covariance=here.covariance[:-1, :-1], undetermined=()
    )
    assert compare(here, part).only_first == (here.names[-1],)
    assert compare(part, here).only_second == (here.names[-1],)


def as_diagnosed(calibration: Calibration) -> Calibration:
    """Return a calibration as `diagnose` writes it: misalignment is a term, no residuals."""
    pairs = [a + b for a in "xyz" for b in "xyz" if a != b]
    values = calibration.model.gyro.parameters("gyro")
    aligned = calibration.model.gyro.with_parameters({f"gyro.misalignment.{p}": 0.0 for p in pairs})
    term = Term("gyro_misalignment", {f"m{p}": values[f"gyro.misalignment.{p}"] for p in pairs})
    names = tuple(
        name.replace("gyro.misalignment.", "gyro_misalignment.m") for name in calibration.names
    )
    model = replace(calibration.model, gyro=aligned, terms=(term,))
    return replace(
        calibration, model=model, names=names, accel=None, gyro=None, poses=None, noise=None
    )


def test_angles_are_compared_wherever_a_model_has_them(
    known: tuple[SensorModel, Calibration],
) -> None:
    _, calibration = known
    found = as_diagnosed(calibration)
    plain = compare(calibration, calibration)
    for pair in ((calibration, found), (found, calibration), (found, found)):
        answer = compare(*pair)
        assert answer.only_first == answer.only_second == ()
        assert [d.name for d in answer.differences] == [d.name for d in plain.differences]
        assert answer.rank == plain.rank
        assert answer.chi_square == pytest.approx(0.0, abs=1e-9)
    term = found.model.terms[0]
    other = Term(term.effect, {**term.parameters, "mzx": term.parameters["mzx"] + 0.01})
    turned = replace(found, model=replace(found.model, terms=(other,)))
    (worst, *_) = compare(calibration, turned).changed
    assert worst.name == "gyro.misalignment.zx"
    assert worst.difference == pytest.approx(0.01)


def test_turns_are_tested_without_the_residuals_of_a_fit(
    known: tuple[SensorModel, Calibration],
) -> None:
    model, calibration = known
    found = as_diagnosed(calibration)
    for seed, poses in enumerate([2, 4, 8, 16, 24]):
        answer = verify(found, record(model, np.random.default_rng(seed), poses))
        assert answer.right, (poses, answer.failed)
        assert [check.name for check in answer.checks] == ["gravity", "rest", "turns"]
        assert not answer.not_tested
    new = record(model, np.random.default_rng(5), 12)
    scaled = found.model.gyro.with_parameters(
        {
            f"gyro.scale_factor_error.{a}": v + 0.03
            for a, v in zip("xyz", found.model.gyro.scale_factor_error, strict=True)
        }
    )
    turned = {name: -value for name, value in found.model.terms[0].parameters.items()}
    for wrong in (
        replace(found.model, gyro=scaled),
        replace(found.model, terms=(Term("gyro_misalignment", turned),)),
    ):
        answer = verify(replace(found, model=wrong), new)
        assert [check.name for check in answer.failed] == ["turns"]
    # The last one has its misalignment turned: each angle has changed by twice of what it is.
    assert answer.comparison is not None
    for item in answer.comparison.changed[:4]:
        assert item.name.startswith("gyro.misalignment.")
        assert item.difference == pytest.approx(-2 * item.first, rel=0.1)


def test_a_wrong_term_does_not_excuse_itself(known: tuple[SensorModel, Calibration]) -> None:
    model, calibration = known
    found = as_diagnosed(calibration)
    asymmetry = Term("gyro_scale_asymmetry", {"kx": 0.01, "ky": -0.008, "kz": 0.01})
    wrong = replace(found, model=replace(found.model, terms=(*found.model.terms, asymmetry)))
    answer = verify(wrong, record(model, np.random.default_rng(6), 16))
    assert "turns" in {check.name for check in answer.failed}


def test_a_term_that_is_hardly_known_lets_turns_scatter(
    known: tuple[SensorModel, Calibration],
) -> None:
    model, calibration = known
    found = as_diagnosed(calibration)
    new = record(model, np.random.default_rng(5), 8)
    open_ = tuple(name for name in found.names if name.startswith("gyro_misalignment."))
    kept = [k for k, name in enumerate(found.names) if name not in open_]
    vague = replace(
        found,
        names=tuple(found.names[k] for k in kept),
        covariance=found.covariance[np.ix_(kept, kept)],
        undetermined=(*found.undetermined, *open_),
    )
    sure, unsure = (
        next(c for c in verify(item, new).checks if c.name == "turns") for item in (found, vague)
    )
    assert unsure.expected > 10 * sure.expected


def test_what_is_not_tested_is_said(known: tuple[SensorModel, Calibration]) -> None:
    model, calibration = known
    answer = verify(calibration, record(model, np.random.default_rng(3), poses=1))
    assert [(item.name, item.reason) for item in answer.not_tested] == [
        ("turns", "the recording has no turn between two rests that can be used")
    ]
    vague = tuple(n for n in calibration.names if n.startswith("gyro.scale_factor_error."))
    kept = [k for k, name in enumerate(calibration.names) if name not in vague]
    unsure = replace(
        calibration,
        names=tuple(calibration.names[k] for k in kept),
        covariance=1e6 * calibration.covariance[np.ix_(kept, kept)],
        undetermined=vague,
    )
    answer = verify(unsure, record(model, np.random.default_rng(3), poses=2))
    assert [item.name for item in answer.not_tested] == ["turns"]
    assert "does not tell the angle" in answer.not_tested[0].reason
