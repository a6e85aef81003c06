"""Further terms of a calibration beside a truth: what the model that is written has is the whole.

The model held only by how much they differ from the calibration, and what moved was counted from
there a second time.
"""

import numpy as np
import pytest

from calib.apply import correct_recording
from calib.calibration import Calibration, Gravity
from calib.effects.base import Term
from calib.mismatch import Diagnosis, ReferenceMotion, diagnose_against, diagnose_reference
from calib.mismatch.reference.others import axes_since
from calib.model import SensorModel
from calib.recording import Recording
from calib.simulate import simulate
from calib.simulation.noise import CONSUMER
from calib.simulation.turntable import turntable
from tests.calib.mismatch.reference.test_against import recorded, simulation

GRAVITY = Gravity(9.80665, "standard gravity")
G = "gyro_g_sensitivity"


def calibration(*terms: Term, sigma: float = 1e-5) -> Calibration:
    names = tuple(f"{term.effect}.{name}" for term in terms for name in term.parameters)
    return Calibration(
        model=SensorModel(terms=terms),
        names=names,
        covariance=np.eye(len(names)) * sigma**2,
        undetermined=(),
        gravity=GRAVITY,
    )


def compared(real: Recording, *terms: Term, sigma: float = 1e-5) -> tuple[Diagnosis, Calibration]:
    """Return the diagnosis beside a simulation under these terms, and the model it writes."""
    known = calibration(*terms, sigma=sigma)
    found = diagnose_against(real, simulation(), gravity=GRAVITY.value, model=known.model)
    return found.beside(known, real), found.calibration(real, gravity=GRAVITY)


@pytest.mark.parametrize("truth", [6e-4, 0.0])
def test_a_term_that_has_changed_is_written_whole_and_said_to_have_moved(truth):
    real = recorded(Term(G, {"gxz": truth}))
    found, made = compared(real, Term(G, {"gxz": 4e-4}))
    assert found.verdict == "consistent"
    (term,) = made.model.terms
    sigma = dict(zip(made.names, np.sqrt(np.diag(made.covariance)), strict=True))[f"{G}.gxz"]
    assert sigma < 1e-5
    assert term.parameters["gxz"] == pytest.approx(truth, abs=4 * sigma)
    moved = {d.name: d for d in found.moved}[f"{G}.gxz"]
    assert moved.difference == pytest.approx(truth - 4e-4, abs=4 * sigma)
    assert all(c.after < 1.3 * c.noise_floor for c in found.changes)
    left = correct_recording(made, real)
    assert diagnose_against(left, simulation(), gravity=GRAVITY.value).verdict == "consistent"


def test_what_has_not_changed_has_not_moved():
    found, made = compared(recorded(Term(G, {"gxz": 4e-4})), Term(G, {"gxz": 4e-4}))
    assert found.verdict == "consistent"
    assert not [d for d in found.moved if d.name.startswith(G)]
    assert f"{G}.gxz" in made.names


def test_other_effects_are_found_beside_what_has_moved():
    real = recorded(Term(G, {"gxz": 6e-4}), Term("gyro_scale_asymmetry", {"kx": 3e-3}))
    found, made = compared(real, Term(G, {"gxz": 4e-4}))
    assert [f.effect for f in found.findings] == ["gyro_scale_asymmetry"]
    terms = {t.effect: t.parameters for t in made.model.terms}
    assert terms[G]["gxz"] == pytest.approx(6e-4, abs=2e-5)
    assert terms["gyro_scale_asymmetry"]["kx"] == pytest.approx(3e-3, abs=3e-4)


def test_a_delay_that_has_grown_is_found_and_written_as_it_is_now():
    """What acts on whole signals stays as it is given, and what it has grown by is found."""
    real = recorded(Term("time_offset", {"gyro_delay": 0.03}), seed=4)
    found, made = compared(real, Term("time_offset", {"gyro_delay": 0.02}), sigma=1e-4)
    (item,) = found.findings
    assert item.parameters["gyro_delay"].value == pytest.approx(0.03, abs=5e-4)
    (term,) = made.model.terms
    assert term.parameters["gyro_delay"] == pytest.approx(0.03, abs=5e-4)
    (moved,) = (d for d in found.moved if d.name == "time_offset.gyro_delay")
    assert moved.difference == pytest.approx(0.01, abs=5e-4)


def test_what_motion_does_not_tell_stays_as_it_is_given():
    """Gravity has one direction on a table: what it makes of a rate is part of the bias."""
    rng = np.random.default_rng(3)
    given = Term(G, {"gxz": 4e-4})
    table = turntable([1.0, -2.0, 3.5, -5.0], offset=(0.0, 0.0, 0.0))
    real = simulate(table, SensorModel(terms=(given,)), CONSUMER, rng=rng, rate=50.0)
    time = np.arange(0.0, table.duration, 1 / 20)
    reference = ReferenceMotion(time, table.kinematics(time)[0].quat)
    found, plain = (
        diagnose_reference(real, reference, gravity=GRAVITY.value, model=model)
        for model in (SensorModel(terms=(given,)), None)
    )
    assert found.missing == plain.missing
    made = found.calibration(real, gravity=GRAVITY)
    (term,) = (t for t in made.model.terms if t.effect == G)
    assert f"{G}.gxz" not in made.names
    assert term.parameters["gxz"] == pytest.approx(4e-4, abs=2e-4)


def test_axes_of_a_gyroscope_are_known_no_better_than_those_of_the_other_one():
    name = "gyro_misalignment.mxy"
    spread = np.full(18, 2e-3)
    covariance, missing = axes_since({name: 2.2e-3}, (name,), np.array([[1e-10]]), spread)
    assert covariance[0, 0] == pytest.approx(4e-6, rel=1e-3)
    assert "0.13°" in missing[0]
    assert not axes_since({name: 1e-6}, (name,), np.array([[1e-10]]), spread)[1]
    assert not axes_since({name: 0.02}, (name,), np.array([[1e-10]]), spread)[1]
