"""What is far more probable in the place of a finding takes it."""

from __future__ import annotations

import pytest

from calib.effects.base import Term
from calib.mismatch import diagnose_recording
from calib.mismatch.rows.rows import Rows
from calib.mismatch.search import search as searching
from calib.mismatch.search.accepted import Accepted
from calib.mismatch.search.choice import Choice, choose
from calib.mismatch.search.ranking import Ranking

from ..bench import GRAVITY, recording


def test_a_step_takes_the_place_of_a_fluctuation_that_was_preferred_where_places_are_tried(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In rests of a minute a step lies far from the moments that are tried."""
    asked: list[str] = []

    def preferring(rows: Rows, ranking: Ranking, accepted: list[Accepted]) -> Choice | None:
        other = ranking.best.get("fluctuation in a window accel.x")
        if other is None or any(a.candidate.name == other.name for a in accepted):
            return choose(rows, ranking, accepted)
        asked.append(other.name)
        return Choice(other, ranking.total)

    monkeypatch.setattr(searching, "choose", preferring)
    step = Term("accel_bias_step", {"bx": 0.015, "moment": 40.0})
    found = diagnose_recording(recording(step, poses=16), gravity=GRAVITY)
    assert len(asked) >= 2
    (named,) = found.findings
    assert named.effect == "accel_bias_step"
    assert named.parameters["moment"].value == pytest.approx(40.0, abs=2.0)
    assert found.unexplained == ()
