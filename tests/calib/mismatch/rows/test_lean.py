"""The lean of a sensor at rest, against draws of what walks, or comes back, upon a steady turn."""

from __future__ import annotations

import numpy as np
import pytest

from calib.mismatch.rows.lean import STEADY, TIMES, Lean, Sway

GRAVITY = 9.80665
CUTS = (1 / 6, 1 / 2)


def two_poses(
    size: tuple[float, float] = (1.0, 1.0),
    creep: float = 0.0,
    back: float = np.inf,
    steady: float = 1.0 / STEADY,
) -> Lean:
    """Return three cells of two poses."""
    up = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
    interval = np.array([[10.0, 13.0], [13.0, 16.0], [20.0, 26.0]])
    pose, sway = np.array([0, 0, 1]), Sway(back=back, steady=steady)
    return Lean.of(up, interval, pose, GRAVITY, np.array(size), creep, sway)


def wandering(lean: Lean, steps: np.ndarray, step: float) -> np.ndarray:
    """Return a walk of these steps, or what comes back from them to where it was."""
    if np.isinf(lean.sway.back):
        return np.asarray(np.cumsum(steps, axis=1) - steps[:, :1])
    out = np.empty_like(steps)
    keep = np.exp(-step / lean.sway.back)
    spread = np.sqrt(0.5 * lean.sway.back)
    out[:, 0] = spread * steps[:, 0] / np.sqrt(step)
    for k in range(1, steps.shape[1]):
        out[:, k] = keep * out[:, k - 1] + spread * np.sqrt((1 - keep**2) / step) * steps[:, k]
    return out


def draws(lean: Lean, number: int, step: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """Return means of the angle and of its rate over each part, (number, n) each."""
    rng = np.random.default_rng(3)
    angle, rate = (np.empty((number, len(lean.pose))) for _ in range(2))
    for p in np.unique(lean.pose):
        own = np.flatnonzero(lean.pose == p)
        end = (lean.begin[own] + lean.length[own]).max()
        time = np.arange(0.0, end + step / 2, step)
        steps = rng.normal(0.0, np.sqrt(step), (number, len(time)))
        path = wandering(lean, steps, step)
        path += rng.normal(0.0, lean.sway.steady**0.5, (number, 1)) * time
        # One of the times, or another, with the variance of them all.
        decay = np.exp(-time / rng.choice(TIMES, number)[:, None])
        path -= np.sqrt(lean.creep) * rng.normal(size=(number, 1)) * decay
        path *= np.sqrt(lean.size[p])
        for k in own:
            a, b = np.searchsorted(time, [lean.begin[k], lean.begin[k] + lean.length[k]])
            angle[:, k] = 0.5 * (path[:, a:b] + path[:, a + 1 : b + 1]).mean(axis=1)
            rate[:, k] = (path[:, b] - path[:, a]) / lean.length[k]
    return angle, rate


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize(
    ("size", "creep", "back", "steady"),
    [
        ((1.0, 1.0), 0.0, np.inf, 1 / STEADY),
        ((1.0, 5.0), 30.0, np.inf, 1 / STEADY),
        ((1.0, 1.0), 0.0, 2.0, 0.0),
        ((2.0, 1.0), 5.0, 0.8, 0.03),
    ],
)
def test_covariance_is_that_of_draws(
    cut: bool, size: tuple[float, float], creep: float, back: float, steady: float
) -> None:
    lean = two_poses(size, creep, back, steady)
    lean = lean.cut(CUTS) if cut else lean
    angle, rate = draws(lean, 20_000)
    for p in np.unique(lean.pose):
        own = lean.pose == p
        angle[:, own] -= np.average(angle[:, own], axis=1, weights=lean.length[own])[:, None]
    for channel, seen in ((1, GRAVITY * angle), (4, rate)):
        expected = np.cov(seen, rowvar=False)
        size = np.sqrt(np.diag(expected))
        size[size < 1e-9] = 1.0  # of a pose of one part
        off = (lean.covariance(channel) - expected) / np.outer(size, size)
        assert np.abs(off).max() < 0.06
        if channel < 3:
            np.testing.assert_array_equal(
                lean.of_force()[channel, :, channel] == 0.0, lean.covariance(channel) == 0.0
            )


def test_along_gravity_nothing_is_seen() -> None:
    lean = two_poses()
    assert not lean.covariance(2)[:2].any()
    lean = lean.cut(CUTS)
    across = lean.covariance(0)[-1, -1] / lean.covariance(1)[-1, -1]
    assert across == pytest.approx(1 - 0.6**2)


def test_gravity_keeps_its_length() -> None:
    """So that a pose of one cell, whose attitude is fitted, shows nothing of how it leans."""
    lean = two_poses()
    force = lean.of_force()
    along = np.einsum("nc,cndm,md->nm", lean.up, force, lean.up)
    np.testing.assert_allclose(along, 0.0, atol=1e-9)
    assert not force[:, 2].any()
    assert force[0, 0, 0, 0] == pytest.approx(lean.covariance(0)[0, 0])


def test_poses_lean_by_themselves() -> None:
    for channel in range(6):
        assert not two_poses().covariance(channel)[:2, 2].any()


@pytest.mark.parametrize(("back", "steady"), [(np.inf, 1 / STEADY), (1.5, 0.02)])
def test_ends_are_off_the_mean_as_draws_are(back: float, steady: float) -> None:
    lean = two_poses(back=back, steady=steady)
    found = lean.at_ends()
    rng = np.random.default_rng(5)
    for p, length in enumerate((6.0, 6.0)):
        time = np.linspace(0.0, length, 301)
        steps = rng.normal(0.0, np.sqrt(time[1]), (20_000, 301))
        path = wandering(lean, steps, time[1])
        path += rng.normal(0.0, steady**0.5, (20_000, 1)) * time
        for end in (0, -1):
            off = path[:, end] - path.mean(axis=1)
            assert found[p] == pytest.approx(np.var(off), rel=0.05)
