"""All candidates of a bench recording, which many tests rank."""

import pytest

from calib.mismatch.search.ranking import make_stack

from ..bench import problem


@pytest.fixture(scope="package")
def stacked():
    _, self_mode = problem()
    rows = self_mode.rows()
    return rows, make_stack(rows, skip=(), reference=False)
