"""Whole recordings through the diagnosis: silence, names, proof, verdicts, the document."""

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.calibration import Gravity
from calib.document import from_document, to_document
from calib.effects import get_effect
from calib.effects.accel_settling import NONE, WHOLE
from calib.effects.base import FORM, PRESENCE, State, Term
from calib.errors import InsufficientMotionError
from calib.mismatch import diagnose_recording
from calib.mismatch.findings.diagnosis import claimed
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER

from ..bench import GRAVITY, recording


@pytest.mark.parametrize(("seed", "drift"), [(11, 1.0), (12, 3.0), (13, 6.0)])
def test_nothing_is_found_in_clean_recordings(seed, drift):
    found = diagnose_recording(recording(seed=seed, drift=drift), gravity=GRAVITY)
    assert found.verdict == "consistent"
    assert not found.findings
    assert not found.unexplained


def test_two_effects_are_found_and_proven_and_become_a_calibration():
    truth = {
        "gyro_misalignment": {"mxy": 0.02, "myz": -0.015},
        "gyro_g_sensitivity": {"gxz": 2e-4},
    }
    real = recording(*(Term(k, v) for k, v in truth.items()), poses=18)
    found = diagnose_recording(real, gravity=GRAVITY)
    assert found.verdict == "explained"
    assert {f.effect for f in found.findings} == set(truth)
    for item in found.findings:
        for name, q in item.parameters.items():
            assert q.sigma is not None
            assert abs(q.value - truth[item.effect].get(name, 0.0)) < 4 * q.sigma, name
        assert item.held_out is not None
        assert item.held_out.after < item.held_out.before
        assert item.p_value < 0.01
    document = found.to_json()
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["format"] == "imu-cal/diagnosis"
    wanted = {"effect", "channels", "intervals", "regime", "parameters", "p_value"}
    wanted |= {"absorbed_by", "held_out", "rivals", "to_separate"}
    assert wanted <= set(document["findings"][0])
    made = found.calibration(real, gravity=Gravity(GRAVITY, "given"))
    again = from_document(to_document(made))
    assert {t.effect for t in again.model.terms} == set(truth)


@pytest.mark.long
def test_a_large_warm_up_is_not_the_temperature_that_rises_as_fast():
    """Between two time constants that are tried it leaves more than temperature squared does."""
    tau = 110.0
    size = {"kx": -0.35, "ky": 0.245, "kz": 0.315}
    real = recording(Term("accel_warm_up", {**size, "tau": tau}), poses=40, seed=4)
    (found,) = diagnose_recording(real, gravity=GRAVITY).findings
    assert found.effect == "accel_warm_up"
    assert abs(found.parameters["tau"].value - tau) < 3 * found.parameters["tau"].sigma
    assert {r.effect for r in found.rivals} <= {"accel_bias_temperature"}


@pytest.mark.long
@pytest.mark.parametrize(("size", "moment"), [(0.01, 30.03), (0.05, 51.3)])
def test_a_large_step_beside_a_misalignment_is_one_and_at_its_moment(size, moment):
    """A turn that closes badly for another reason draws it away from there, at first."""
    terms = (
        Term("gyro_misalignment", {"mxy": 0.015, "mzx": -0.012}),
        Term("gyro_bias_step", {"bx": 0.6 * size, "by": -0.8 * size, "moment": moment}),
    )
    found = diagnose_recording(recording(*terms, poses=18, rate=100.0), gravity=GRAVITY)
    assert found.verdict == "explained"
    assert sorted(f.effect for f in found.findings) == ["gyro_bias_step", "gyro_misalignment"]
    step = next(f for f in found.findings if f.effect == "gyro_bias_step")
    assert abs(step.parameters["moment"].value - moment) < 0.3
    assert abs(step.parameters["bx"].value - 0.6 * size) < 4 * step.parameters["bx"].sigma


def test_an_event_is_kept_apart_from_the_sensor():
    real = recording(Term("gyro_bias_step", {"by": 0.004, "moment": 45.0}), poses=18)
    found = diagnose_recording(real, gravity=GRAVITY)
    step = next(f for f in found.findings if f.effect == "gyro_bias_step")
    assert step.channels == ("gyro.y",)
    assert abs(step.intervals[0][0] - 45.0) < 4.0
    made = found.calibration(real, gravity=Gravity(GRAVITY, "given"))
    assert not made.model.terms
    assert [e.effect for e in made.events] == ["gyro_bias_step"]


@pytest.mark.long
def test_what_shakes_the_bench_is_the_cause_of_noise_and_of_a_mean_that_moves():
    rng = np.random.default_rng(31)
    motion = bench_protocol(rng, poses=16, vibration=2.5)
    term = Term("gyro_vibration_rectification", {"kx": 4e-5, "kz": -3e-5})
    for terms in ((), (term,)):
        real = simulate(motion, SensorModel(terms=terms), CONSUMER, rng=rng, rate=100.0)
        found = diagnose_recording(real, gravity=GRAVITY)
        assert [f.effect for f in found.findings] == [t.effect for t in terms]
        louder = [u.follows for u in found.unexplained]
        assert louder == ([] if terms else ["the time: noise is louder there"])
    for name, q in found.findings[0].parameters.items():
        assert abs(q.value - term.parameters.get(name, 0.0)) < 3.5 * q.sigma


def test_a_window_of_interference_gets_no_physical_name():
    real = recording()
    inside = (real.time > 30) & (real.time < 50)
    gyro = real.gyro.copy()
    gyro[:, 2] += 0.004 * inside * np.sign(np.sin(2 * np.pi * real.time / 9.0))
    odd = Recording(real.time, real.accel, gyro, "device", temperature=real.temperature)
    found = diagnose_recording(odd, gravity=GRAVITY)
    assert found.verdict == "unexplained"
    left = found.unexplained[0]
    assert "gyro.z" in left.channels
    start, stop = left.intervals[0]
    assert min(stop, 50) - max(start, 30) > 0.5 * (max(stop, 50) - min(start, 30))


def test_a_channel_that_is_stuck_for_some_rests_gets_no_physical_name():
    real = recording(seed=4)
    start, stop = np.searchsorted(real.time, [0.4 * real.time[-1], 0.55 * real.time[-1]])
    accel = real.accel.copy()
    accel[start:stop, 0] = accel[start, 0]
    odd = Recording(real.time, accel, real.gyro, "device", temperature=real.temperature)
    found = diagnose_recording(odd, gravity=GRAVITY)
    assert not found.findings
    (left,) = found.unexplained
    assert left.channels == ("accel.x",)
    np.testing.assert_allclose(left.intervals[0], real.time[[start, stop - 1]], atol=0.2)


def test_clipping_is_seen_in_the_samples():
    real = recording()
    limit = float(np.quantile(np.abs(real.gyro[:, 0]), 0.995))
    gyro = np.clip(real.gyro, -limit, limit)
    found = diagnose_recording(Recording(real.time, real.accel, gyro, "device"), gravity=GRAVITY)
    item = next(f for f in found.findings if f.effect == "saturation")
    assert "gyro.x" in item.channels
    np.testing.assert_allclose(item.parameters["gyro_full_scale"].value, limit, rtol=1e-6)
    assert item.parameters["gyro"].unit == PRESENCE


@pytest.mark.parametrize(
    ("accel", "gyro", "name"),
    [
        (1.0, np.degrees(1.0) * np.eye(3), "unit_error"),
        (1.0 / GRAVITY, np.eye(3), "unit_error"),
        (1.0, np.eye(3)[[1, 0, 2]], "axis_error"),
    ],
)
def test_wrong_units_and_axes_are_named_alone(accel, gyro, name):
    real = recording()
    wrong = Recording(real.time, accel * real.accel, real.gyro @ gyro.T, "device")
    found = diagnose_recording(wrong, gravity=GRAVITY)
    assert [f.effect for f in found.findings] == [name]
    if name == "axis_error":
        assert "The gyro's axes show x: y, y: x, z: z." in found.findings[0].sentence
        assert [q.unit for q in found.findings[0].parameters.values()] == [PRESENCE, FORM]


@pytest.mark.parametrize(
    ("accel", "gyro", "channels", "said"),
    [
        ([1, 1, -1], [1, 1, 1], ["accel.z"], "The accel's axes show x: x, y: y, z: -z."),
        ([1, 1, 1], [1, -1, 1], ["gyro.y"], "The gyro's axes show x: x, y: -y, z: z."),
        ([1, 1, 1], [-1, -1, 1], ["accel.z"], "The gyro's axes show x: -x, y: -y, z: z."),
    ],
)
def test_one_wrong_sign_is_likelier_than_two_and_what_else_it_may_be_is_said(
    accel, gyro, channels, said
):
    real = recording()
    wrong = Recording(real.time, real.accel * accel, real.gyro * gyro, "device")
    (found,) = diagnose_recording(wrong, gravity=GRAVITY).findings
    assert found.effect == "axis_error"
    assert list(found.channels) == channels
    assert said in found.sentence
    # A gyroscope's one wrong sign is no rotation, and no accelerometer makes up for it.
    assert [r.effect for r in found.rivals] == ["axis_error gyro"] * (channels[0] == "accel.z")


def test_a_model_has_no_parameter_that_the_recording_leaves_open():
    found = diagnose_recording(
        recording(Term("gyro_g_sensitivity", {"gxx": 1e-3})), gravity=GRAVITY
    )
    (item,) = found.findings
    (term,) = found.model.terms
    assert set(term.parameters) == set(item.parameters)
    more = replace(term, parameters={**term.parameters, "gzz": 0.5})
    model = claimed(replace(found.model, terms=(more,)), (), found.findings)
    assert model.terms == (term,)
    # What was given stays.
    given = claimed(replace(found.model, terms=(more,)), (more,), ())
    assert given.terms == (more,)
    # But not what was tried beside it and has no name.
    beside = claimed(replace(found.model, terms=(more, term)), (more,), ())
    assert beside.terms == (more,)


def test_what_shows_in_samples_is_none_of_what_a_recording_cannot_show():
    found = diagnose_recording(recording(), gravity=GRAVITY)
    assert "accel_vibration_rectification" in found.hidden
    assert not {"quantization", "saturation", "unit_error"} & set(found.hidden)


def test_one_pose_cannot_tell():
    real = recording(poses=1)
    found = diagnose_recording(real, gravity=GRAVITY)
    assert found.verdict == "undetermined"
    assert any("pose" in text for text in found.missing)


def test_of_a_recording_that_only_moves_nothing_is_known():
    time = np.arange(0, 20, 0.02)
    rng = np.random.default_rng(0)
    gyro = 3 * np.sin(2 * np.pi * time[:, None] * [0.9, 1.1, 1.3]) + rng.normal(0, 0.01, (1000, 3))
    accel = 9.8 * np.cos(2 * np.pi * time[:, None] * [0.7, 1.2, 0.8]) + rng.normal(
        0, 0.1, (1000, 3)
    )
    recording = Recording(time, accel, gyro, "device")
    found = diagnose_recording(recording, gravity=GRAVITY)
    assert found.verdict == "undetermined"
    assert not found.findings
    assert any("a moment of rest" in text for text in found.missing)
    with pytest.raises(InsufficientMotionError, match="no model is written"):
        found.calibration(recording, gravity=Gravity(GRAVITY, "given"))


@pytest.mark.long
def test_a_low_pass_that_both_triads_share_is_named() -> None:
    # Their common delay shows nowhere; what it takes from fast turns looks like a size effect.
    real = recording(Term("bandwidth", {"both_cutoff": 7.0}), rate=100.0)
    (found,) = diagnose_recording(real, gravity=GRAVITY).findings
    assert found.effect == "bandwidth"
    # The square of the time constant is what is seen.
    assert found.parameters["both"].value == 1.0
    assert abs((7.0 / found.parameters["both_cutoff"].value) ** 2 - 1.0) < 0.2


@pytest.mark.long
def test_a_strong_low_pass_of_one_triad_is_one_finding() -> None:
    # It delays a turn by more than any linear change of it holds for.
    real = recording(Term("bandwidth", {"accel_cutoff": 6.0, "order": 1.0}), seed=8)
    found = diagnose_recording(real, gravity=GRAVITY)
    (finding,) = found.findings
    assert finding.effect == "bandwidth"
    assert not found.unexplained
    assert finding.parameters["order"].value == 1
    cutoff = finding.parameters["accel_cutoff"]
    assert abs(cutoff.value - 6.0) < 4.0 * cutoff.sigma < 0.5


@pytest.mark.long
def test_a_low_pass_that_is_as_good_as_a_delay_is_either() -> None:
    # One of second order is late by 38 ms, and turns have next to nothing that it takes away.
    real = recording(Term("bandwidth", {"accel_cutoff": 6.0, "order": 2.0}), seed=8)
    found = diagnose_recording(real, gravity=GRAVITY)
    (finding,) = found.findings
    assert not found.unexplained
    assert {finding.effect, *(r.effect for r in finding.rivals)} == {"bandwidth", "time_offset"}


@pytest.mark.parametrize(("cutoff", "known"), [(10.0, True), (20.0, False)])
@pytest.mark.long
def test_a_low_pass_is_there_or_not_and_its_cutoff_is_right(cutoff: float, known: bool) -> None:
    real = recording(Term("bandwidth", {"gyro_cutoff": cutoff, "order": 1}), rate=100.0, seed=5)
    diagnosis = diagnose_recording(real, gravity=GRAVITY)
    (finding,) = diagnosis.findings
    assert finding.effect == "bandwidth"
    assert finding.parameters["gyro"].value == 1.0
    found = finding.parameters["gyro_cutoff"]
    assert found.sigma is not None
    assert abs(found.value - cutoff) < 3.0 * found.sigma
    # By its delay alone it may be of second order, with a cut-off 1.4 times as high.
    assert (found.sigma < 0.03 * cutoff) == known
    assert (found.sigma > 0.3 / 3 * cutoff) == (not known)
    # That it is there is no number with an error; what it is like is, in the calibration too.
    model = diagnosis.calibration(real, gravity=Gravity(GRAVITY, 0.0, "standard gravity"))
    assert model.status("bandwidth.gyro") == "fixed"
    assert model.sigmas["bandwidth.gyro_cutoff"] == pytest.approx(found.sigma)


@pytest.mark.long
def test_a_warm_up_is_counted_from_where_the_recording_begins() -> None:
    real = recording(Term("gyro_warm_up", {"kx": 0.02, "tau": 30.0}), seed=4)
    early = real.time < real.time[0] + 12.0
    # Whoever switched it on had it in the hand for a while.
    rng = np.random.default_rng(4)
    hand = 0.3 * early[:, None] * np.sin(9.0 * real.time[:, None] + rng.uniform(0, 6, 3))
    held = Recording(
        real.time, real.accel + hand, real.gyro + hand, real.clock, temperature=real.temperature
    )
    found = diagnose_recording(held, gravity=GRAVITY)
    warm = next(f for f in found.findings if f.effect == "gyro_warm_up")
    size, tau = warm.parameters["kx"], warm.parameters["tau"]
    assert size.sigma is not None
    assert abs(size.value - 0.02) < 3 * size.sigma
    assert size.sigma < 0.003
    assert abs(tau.value - 30.0) < 10.0


@pytest.mark.parametrize("form", [WHOLE, NONE])
@pytest.mark.long
def test_what_settles_after_turns_is_known_whatever_it_does_in_them(form: int) -> None:
    sizes = {"kx": 0.012, "ky": -0.009, "kz": 0.006}
    truth = Term("accel_settling", {**sizes, "tau": 4.0, "in_turns": form})
    real, without = recording(truth, seed=7), recording(seed=7)
    found = diagnose_recording(real, gravity=GRAVITY)
    (finding,) = found.findings
    assert finding.effect == "accel_settling"
    assert finding.parameters["in_turns"].value == form
    for name, value in {**sizes, "tau": 4.0}.items():
        q = finding.parameters[name]
        assert q.sigma is not None
        assert abs(q.value - value) < 3.0 * q.sigma
    # In words only where the recording tells.
    words = get_effect("accel_settling").in_words({"tau": 4.0, "in_turns": form})
    assert words in finding.sentence
    (term,) = found.model.terms
    clean = SensorModel(terms=(term,)).correct(State(real.time, real.accel, real.gyro)).accel
    left, size = (np.sqrt(np.mean(np.square(a - without.accel))) for a in (clean, real.accel))
    assert left < 0.6 * size


def test_what_differs_from_pose_to_pose_shows_in_what_is_left_at_rest():
    """Changes within rests are many, and have nothing of it."""
    found = diagnose_recording(
        recording(Term("gyro_g_sensitivity", {"gxz": 3e-5})), gravity=GRAVITY
    )
    assert [f.effect for f in found.findings] == ["gyro_g_sensitivity"]
    gyro = next(c for c in found.changes if c.rows == "gyro at rest")
    assert gyro.before > 2.5 * gyro.after
    # What was fitted takes its part of the noise, and most of it from the closures of turns.
    for change in found.changes:
        assert change.after == pytest.approx(change.noise_floor, rel=0.25)


@pytest.mark.parametrize(
    ("term", "follows", "x_unit", "channel"),
    [
        (Term("gyro_g_sensitivity", {"gxz": 3e-4}), "specific force along z", "m/s²", "gyro.x"),
        (
            Term("gyro_misalignment", {"mxy": 0.02}),
            "rate about y, added up over a turn",
            "rad",
            "attitude after turns",
        ),
    ],
)
def test_residuals_are_plotted_against_what_the_largest_entry_goes_with(
    term, follows, x_unit, channel
):
    """Against what the effect itself predicts, anything is a straight line."""
    found = diagnose_recording(recording(term), gravity=GRAVITY)
    (item,) = found.findings
    assert item.evidence is not None
    assert (item.evidence.follows, item.evidence.x_unit) == (follows, x_unit)
    (series,) = item.evidence.series
    assert series.channel == channel
    assert np.ptp(series.x) > 1.0
    (slope,) = term.parameters.values()
    # What the baseline had absorbed of it is not in what was left.
    assert 0.2 < np.polyfit(series.x, series.before - series.after, 1)[0] / slope < 1.1
