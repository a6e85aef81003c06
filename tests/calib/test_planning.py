"""The next action is worth what it says, and a plan beats a fixed routine."""

import numpy as np
import pytest

from calib.planning import (
    NAMES,
    Accuracy,
    candidate_actions,
    next_action,
    pose_information,
    prior_information,
    six_face_information,
    standard_errors,
)

G = 9.80665
ACCURACY = Accuracy(pose=0.01, static=2e-4, turn=2e-3)
TARGETS = {
    name: {
        "accel.bias": 0.01,
        "accel.scale_factor_error": 1e-3,
        "accel.misalignment": 1e-3,
        "gyro.bias": 2e-4,
        "gyro.scale_factor_error": 1e-3,
        "gyro.misalignment": 1e-3,
    }[name.rpartition(".")[0]]
    for name in NAMES
}
ANGLES = (np.pi / 2, np.pi)


def plan(rounds: int) -> tuple[int, np.ndarray]:
    """Follow the plan until every target is met; return how many actions that took."""
    up = np.array([0.0, 0.0, 1.0])
    information = pose_information(up, gravity=G, accuracy=ACCURACY)
    for count in range(rounds):
        ratios = standard_errors(information + prior_information(TARGETS))
        if all(ratios[name] <= TARGETS[name] for name in NAMES):
            return count, information
        choice = next_action(
            information,
            up,
            targets=TARGETS,
            actions=candidate_actions(up, angles=ANGLES),
            turn_time=2.0,
            gravity=G,
            accuracy=ACCURACY,
        )
        from calib.planning import action_information

        information = information + action_information(
            choice.action, up, turn_time=2.0, gravity=G, accuracy=ACCURACY
        )
        up = choice.action.up
    return rounds, information


def test_pose_information_is_that_of_the_norm_equation() -> None:
    # d|a| by finite differences of the forward model, for a pose in no special direction.
    up = np.array([0.3, -0.5, 0.8])
    up /= np.linalg.norm(up)
    base = np.zeros(9)

    def norm(p: np.ndarray) -> float:
        m = np.eye(3) + np.diag(p[3:6])
        m[1, 0], m[2, 0], m[2, 1] = p[6:]
        measured = m @ (G * up) + p[:3]
        return float(np.linalg.norm(measured))

    step = 1e-6
    row = [(norm(base + step * e) - norm(base - step * e)) / (2 * step) for e in np.eye(9)]
    expected = np.outer(row, row) / ACCURACY.pose**2
    found = pose_information(up, gravity=G, accuracy=ACCURACY)[:9, :9]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-3)


def test_a_plan_meets_targets_that_six_faces_never_meet() -> None:
    count, _ = plan(60)
    assert count < 40
    routine = six_face_information(gravity=G, accuracy=ACCURACY, turn_time=2.0)
    errors = standard_errors(1000 * routine + prior_information(TARGETS))
    # On its six faces a sensor's non-orthogonality does not change |a|.
    assert errors["accel.misalignment.yx"] > 50 * TARGETS["accel.misalignment.yx"]


def test_the_worst_parameter_is_named_and_falls() -> None:
    up = np.array([0.0, 0.0, 1.0])
    information = pose_information(up, gravity=G, accuracy=ACCURACY)
    choice = next_action(
        information,
        up,
        targets=TARGETS,
        actions=candidate_actions(up, angles=ANGLES),
        turn_time=2.0,
        gravity=G,
        accuracy=ACCURACY,
    )
    assert choice.worst in NAMES
    assert choice.ratio_after <= choice.ratio_before


def test_no_action_turns_about_the_vertical() -> None:
    up = np.array([0.0, 1.0, 0.0])
    actions = candidate_actions(up, angles=ANGLES)
    assert actions
    assert all(abs(a.axis @ up) < np.cos(np.radians(25)) for a in actions)
    for action in actions:
        assert np.linalg.norm(action.up) == pytest.approx(1)
