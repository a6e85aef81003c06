"""Normal gravity against published values."""

import numpy as np
import pytest

from calib.gravity import normal_gravity


@pytest.mark.parametrize(
    ("latitude", "gravity"),
    # NIMA TR8350.2 table 3.4: at the equator and at the poles. Moritz, "Geodetic Reference System
    # 1980", gives 9.806199203 at 45° for GRS 80, whose formula differs by less than 2e-6 m/s².
    [(0.0, 9.7803253359), (90.0, 9.8321849378), (-90.0, 9.8321849378), (45.0, 9.806199)],
)
def test_on_the_ellipsoid(latitude: float, gravity: float) -> None:
    assert normal_gravity(np.radians(latitude), 0.0) == pytest.approx(gravity, abs=2e-6)


def test_falls_by_the_free_air_gradient() -> None:
    # 0.3086 mGal a metre near 45°
    step = normal_gravity(np.radians(45), 1.0) - normal_gravity(np.radians(45), 0.0)
    assert step == pytest.approx(-3.086e-6, rel=1e-3)


@pytest.mark.parametrize(("latitude", "height"), [(91.0, 0.0), (45.0, 3e4), (float("nan"), 0.0)])
def test_places_off_the_earth_are_refused(latitude: float, height: float) -> None:
    with pytest.raises(ValueError, match=r"`latitude`|`height`"):
        normal_gravity(np.radians(latitude), height)
