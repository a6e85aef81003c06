"""What the numbers of a finding must be for its name to stand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calib.calibration import Quantity
from calib.effects import get_effect
from calib.effects.base import Term
from calib.effects.earth_rate import components
from calib.mismatch import diagnose_recording
from calib.mismatch.findings.diagnosis import Unexplained
from calib.mismatch.hypotheses.candidates import Candidate
from calib.mismatch.search.accepted import Accepted, accept
from calib.mismatch.search.estimate import Estimate, Windows
from calib.mismatch.search.explain import (
    _Case,
    _go_together,
    _is_nothing,
    _is_taken_over,
    _judge,
    _of_windows,
    _rivals,
)
from calib.mismatch.search.ranking import make_stack
from calib.mismatch.search.search import SHOWN
from calib.model import SensorModel
from calib.simulate import simulate
from calib.simulation.bench import bench_protocol
from calib.simulation.noise import CONSUMER

from ..bench import GRAVITY, motion_of, problem, recording, with_added
from .stacked import candidate


def test_few_windows_tell_less_than_many(stacked):
    _, stack = stacked
    found = accept(stack, candidate(stack, "gyro_scale_nonlinearity", ("kx",)), 100.0)

    def estimate(z: float, windows: Windows | None) -> Estimate:
        told = np.ones(1, bool)
        return Estimate(np.full(1, z), np.eye(1), (0, 1), {}, {}, {}, np.zeros(1), told, windows)

    two, alike = (Windows(np.full(1, wider), np.full(1, 2.0)) for wider in (3.0, 1.2))
    few, many = _of_windows(estimate(3.0, two), 0, found, looks=1)
    # Student's t with two degrees of freedom, and a normal variable.
    assert few == pytest.approx(0.0955, abs=1e-4)
    assert many == pytest.approx(0.0027, abs=1e-4)
    assert _of_windows(estimate(3.0, two), 0, found, looks=7)[0] == pytest.approx(7 * few)
    assert _of_windows(estimate(3.0, alike), 0, found, looks=1) == (many, many)
    assert _of_windows(estimate(3.0, None), 0, found, looks=7) == (0.0, 0.0)


def test_sizes_that_no_number_of_is_sure_go_together_with_how_long_it_lasts() -> None:
    loose, sure = Quantity(1.0, 0.9, "m/s²"), Quantity(3.0, 0.9, "m/s²")
    assert _go_together([loose, loose, Quantity(1.0, None, "1")])
    assert not _go_together([loose, sure])
    assert not _go_together([loose])


def test_a_rival_of_what_has_come_to_nothing_is_so_much_more_probable_at_least():
    _, made = problem()
    rows = made.rows()
    stack = make_stack(rows, skip=(), reference=False)
    first = next(c for c in stack.physics.values() if c.name == "gyro_misalignment")
    gone = replace(
        accept(stack, first, 10.0), posterior={first.group: 0.0, "bandwidth": 1.0, "other": 1e-4}
    )
    (rival,) = _rivals(gone, ())
    assert rival.effect == "bandwidth"
    assert rival.odds == pytest.approx(1.0 / SHOWN)


def test_of_a_step_that_later_wandering_took_over_nothing_is_said():
    """A field that is fixed to the room was a step of half a standard error."""
    none = np.zeros((0, 1))

    def found(name: str, *, physical: bool, channel: str) -> Accepted:
        own = Candidate(name, np.zeros(0, np.int64), 0.1, physical, (channel,), parameters=("b",))
        return Accepted(own, none, np.ones(1), np.zeros(1), False, 1e9)

    step = found("gyro_bias_step", physical=True, channel="gyro.x")
    wanders = found("direction of gravity", physical=False, channel="gyro.x")
    elsewhere = found("direction of gravity", physical=False, channel="gyro.y")

    def fit(size: float) -> Estimate:
        told, left = np.ones(2, bool), np.zeros(0)
        return Estimate(np.array([size, 9.0]), np.eye(2), (0, 1, 2), {}, {}, {}, left, told)

    assert _is_nothing(fit(0.5), 0)
    assert not _is_nothing(fit(5.0), 0)
    assert _is_taken_over([step, wanders], 0)
    assert not _is_taken_over([step, elsewhere], 0)
    assert not _is_taken_over([wanders, step], 1)


def test_a_name_that_others_beat_by_ten_is_none_and_nothing_at_all_if_little_is_left(monkeypatch):
    own = Candidate(
        "gyro_bias_step", np.zeros(0, np.int64), 0.1, True, ("gyro.x",), parameters=("bx",)
    )
    none, told, left = np.zeros((0, 1)), np.ones(2, bool), np.zeros(0)
    step = Accepted(own, none, np.ones(1), np.zeros(1), False, 1e9)
    step = replace(step, posterior={own.group: 0.05, "accel_cubic": 0.45, "accel_quadratic": 0.4})
    rough = replace(own, name="direction of gravity", physical=False)
    wanders = Accepted(rough, none, np.ones(1), np.zeros(1), False, 1e9)

    def said(_outcome, _fit, which, rivals):
        return Unexplained(("gyro.x",), ((0.0, 1.0),), f"number {which}", 1e-3, rivals)

    def judged(size: float):
        rows = SimpleNamespace(clustered=True)
        outcome = SimpleNamespace(accepted=[step, wanders], tried=frozenset(), rows=rows)
        fit = Estimate(np.array([size, 9.0]), np.eye(2), (0, 1, 2), {}, {}, {}, left, told)
        return _judge(_Case(outcome, fit, (), {}, set(), set(), lambda: None), 0)

    monkeypatch.setattr("calib.mismatch.search.explain._unexplained", said)
    item = judged(5.0)
    assert isinstance(item, Unexplained)
    assert item.follows == get_effect("gyro_bias_step").follows
    assert [r.effect for r in item.rivals] == ["accel_cubic", "accel_quadratic"]
    assert judged(0.5) is None


@pytest.mark.long
def test_a_plot_shows_what_is_unexplained_where_it_is_or_against_what_it_follows():
    real = recording(seed=8)
    start, stop = 0.3 * real.time[-1], 0.6 * real.time[-1]
    inside = (real.time > start) & (real.time < stop)
    found = diagnose_recording(with_added(real, {"gyro.z": 2e-3 * inside}), gravity=GRAVITY)
    (left,) = found.unexplained
    assert left.evidence is not None
    assert (left.evidence.follows, left.evidence.x_unit) == ("time", "s")
    (own,) = (s for s in left.evidence.series if s.channel == "gyro.z")
    here = (own.x > start + 5) & (own.x < stop - 5)
    far = (own.x < start - 5) | (own.x > stop + 5)
    # The bias is fitted without it too, and so lies between.
    apart = own.before[here].mean() - own.before[far].mean()
    assert apart == pytest.approx(2e-3, rel=0.2)
    assert abs(own.after[here].mean() - own.after[far].mean()) < 0.1 * apart
    assert left.to_json()["evidence"]["unit"] == "rad/s"
    state = motion_of(real)
    assert state.mat_ns is not None
    heading = np.einsum("nij,i,j->n", state.mat_ns, [0.8, 0.6, 0.0], [0.6, 0.0, 0.8])
    found = diagnose_recording(with_added(real, {"gyro.z": 0.002 * heading}), gravity=GRAVITY)
    (left,) = found.unexplained
    assert left.evidence is not None
    assert left.evidence.follows == "what it predicts (orientation)"
    (own,) = (s for s in left.evidence.series if s.channel == "gyro.z")
    assert np.corrcoef(own.x, own.before)[0, 1] > 0.9


@pytest.mark.long
def test_an_earth_that_would_be_too_fast_has_a_g_sensitivity_beside_it():
    rng = np.random.default_rng(4)
    motion = bench_protocol(rng, poses=20, first_pose=2.0, pose_duration=(4.0, 6.0))
    quiet = replace(CONSUMER.scaled(0.05), temperature=CONSUMER.temperature)
    earth = Term("earth_rate", components(np.radians(48.0)))
    alike = Term("gyro_g_sensitivity", dict.fromkeys(("gxx", "gyy", "gzz"), 4e-5))
    for terms, rival in (((earth,), False), ((earth, alike), True)):
        real = simulate(motion, SensorModel(terms=terms), quiet, rng=rng, rate=50.0)
        found = diagnose_recording(real, gravity=GRAVITY)
        item = next(f for f in found.findings if f.effect == "earth_rate")
        assert ("times as fast as it turns" in item.sentence) == rival
        assert ("gyro_g_sensitivity" in {r.effect for r in item.rivals}) == rival
