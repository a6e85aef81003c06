"""Parameters that a recording leaves open are no part of a finding, or of a model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.mismatch.noise.noise import expected_levels
from calib.mismatch.search.accepted import Accepted, accept, contrast_noise
from calib.mismatch.search.determined import determined, open_baseline, to_determine
from calib.mismatch.search.estimate import Estimate

SLUG = "gyro_misalignment"


@pytest.fixture
def found(stacked):
    """Return rows with 0.01 rad of myx in them, and a finding that has all six angles."""
    rows, stack = stacked
    six = max((c for c in stack.physics.values() if c.name == SLUG), key=lambda c: len(c.index))
    finding = accept(stack, six, 100.0)
    there = np.where([n == "myx" for n in six.parameters], 0.01, 0.0) / finding.typical
    return rows.with_residual(rows.residual + finding.columns @ there), finding


def silent(finding: Accepted, *names: str) -> Accepted:
    """Return a finding of which the motion shows next to nothing of some parameters."""
    seen = np.where([n in names for n in finding.candidate.parameters], 1e-6, 1.0)
    return replace(finding, columns=finding.columns * seen)


def tried(rows, finding: Accepted) -> tuple[list[Accepted], tuple[str, ...]]:
    return determined(rows, [finding], expected_levels(rows), contrast_noise(rows, [finding]))


def test_what_turns_show_stays(found):
    rows, finding = found
    (kept,), gone = tried(rows, finding)
    assert kept is finding
    assert gone == ()


def test_what_no_turn_shows_is_open(found):
    rows, finding = found
    (kept,), gone = tried(rows, silent(finding, "mxz", "myz"))
    assert set(gone) == {f"{SLUG}.mxz", f"{SLUG}.myz"}
    assert kept.candidate.parameters == ("mxy", "myx", "mzx", "mzy")
    assert kept.columns.shape[1] == len(kept.values) == len(kept.typical) == 4
    assert set(kept.candidate.channels) == {"gyro.x", "gyro.y", "gyro.z"}
    assert to_determine(gone[:1]).startswith("motion that determines gyro_misalignment.m")


def test_a_channel_of_which_nothing_is_left_is_none_of_a_finding(found):
    rows, finding = found
    (kept,), _ = tried(rows, silent(finding, "mxy", "mxz"))
    assert kept.candidate.channels == ("gyro.y", "gyro.z")


def test_of_two_that_only_go_together_one_stays(found):
    rows, finding = found
    names = finding.candidate.parameters
    columns = finding.columns.copy()
    columns[:, names.index("mxy")] = columns[:, names.index("myx")]
    (kept,), gone = tried(rows, replace(finding, columns=columns))
    assert len(gone) == 1
    assert len(kept.candidate.parameters) == 5


def test_the_last_parameter_of_a_finding_stays(found):
    rows, finding = found
    (kept,), gone = tried(rows, silent(finding, *finding.candidate.parameters))
    assert len(kept.candidate.parameters) == 1
    assert len(gone) == 5


def test_a_baseline_is_open_where_it_is_loose_or_nothing_is_said_of_it():
    names = ("accel.bias.x", "gyro.scale_factor_error.y", "accel.misalignment.yx")
    covariance = np.diag([0.05, 1e-9, 0.05]) ** 2
    told = np.array([True, False, True])
    fit = Estimate(np.zeros(3), covariance, (3,), {}, {}, {}, np.zeros(1), told)
    assert open_baseline(names, fit) == list(names[1:])
