"""Normal gravity against published values."""

import numpy as np
import pytest

from calib.gravity import STANDARD, normal_gravity


def test_equator_and_pole_of_wgs84() -> None:
    # NGA.STND.0036: gamma_e and gamma_p.
    assert normal_gravity(0.0) == pytest.approx(9.7803253359, abs=1e-10)
    assert normal_gravity(np.pi / 2) == pytest.approx(9.8321849379, abs=1e-9)
    assert normal_gravity(-np.pi / 2) == normal_gravity(np.pi / 2)


def test_mid_latitude_is_gamma_45_of_grs80() -> None:
    # H. Moritz, Geodetic Reference System 1980: gamma_45 = 9.806199203 m/s²; WGS 84 differs by
    # less than 2e-6 m/s².
    assert normal_gravity(np.radians(45)) == pytest.approx(9.806199203, abs=2e-6)


def test_height_by_the_point_mass_it_nearly_is() -> None:
    # Free-air gradient at 45°: 0.30877 (1 - 0.00142 sin²) mGal/m, less 0.75e-7 h² (GRS 80).
    for height in (100.0, 1000.0, 5000.0):
        fall = normal_gravity(np.radians(45)) - normal_gravity(np.radians(45), height)
        published = (0.30877 * (1 - 0.00142 * 0.5) * height - 0.75e-7 * height**2) * 1e-5
        assert fall == pytest.approx(published, rel=1e-3)


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(ValueError, match="`latitude`"):
        normal_gravity(52.0)  # degrees
    with pytest.raises(ValueError, match="`latitude`"):
        normal_gravity(float("nan"))
    with pytest.raises(ValueError, match="`height`"):
        normal_gravity(0.9, 1e6)


def test_standard_gravity() -> None:
    assert pytest.approx(9.80665) == STANDARD
