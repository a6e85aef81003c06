"""Of two gyroscopes: what may be the other one's is no finding."""

import numpy as np
import pytest

from calib.calibration import Quantity
from calib.mismatch.findings.diagnosis import Finding
from calib.mismatch.reference.carried import NAMES, SIZES
from calib.mismatch.reference.others import told_from_the_other


def finding(effect: str, **values: float) -> Finding:
    parameters = {name: Quantity(value, 1e-4, "rad") for name, value in values.items()}
    return Finding(
        effect=effect,
        title="",
        kind="sensor",
        channels=("gyro.x",),
        intervals=((0.0, 1.0),),
        regime="",
        parameters=parameters,
        p_value=1e-6,
        absorbed_by=(),
        held_out=None,
        held_out_reason="",
        rivals=(),
        to_separate="",
        sentence="",
    )


def known(**values: float) -> np.ndarray:
    return np.array([values.get(name.rpartition(".")[2], 0.0) for name in NAMES])


@pytest.mark.parametrize(
    ("size", "errors", "spread", "kept"),
    [
        (0.01, known(), SIZES, False),  # a data sheet allows as much
        (0.05, known(), SIZES, True),  # and not that
        (0.01, known(), 0.1 * SIZES, True),  # its own turns tell that it is not the other one's
        (0.01, known(xy=-0.01), 0.1 * SIZES, False),  # or that it is
        (0.01, known(xy=0.01), 0.1 * SIZES, True),
    ],
)
def test_misalignment_is_the_sensor_s_beyond_what_the_other_one_s_may_be(
    size, errors, spread, kept
):
    other = finding("gyro_scale_nonlinearity", kx=size)
    found, missing = told_from_the_other(
        [finding("gyro_misalignment", mxy=size), other], errors, spread
    )
    assert [f.effect for f in found] == ["gyro_misalignment"] * kept + [other.effect]
    assert bool(missing) is not kept
