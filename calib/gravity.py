"""Normal gravity by latitude and height."""

from __future__ import annotations

import numpy as np

# WGS 84 ellipsoid, NGA.STND.0036 (2014): tables 3.1, 3.5 and 3.6.
SEMI_MAJOR_AXIS = 6378137.0
FLATTENING = 1 / 298.257223563
GRAVITY_EQUATOR = 9.7803253359
SOMIGLIANA = 0.00193185265241
"""``k = b gamma_p / (a gamma_e) - 1``."""
ECCENTRICITY_SQUARED = 0.00669437999014
RATE_RATIO = 0.00344978650684
"""``m = omega² a² b / GM``."""

STANDARD = 9.80665
"""Standard gravity (3rd CGPM, 1901), m/s²; what is assumed where no place is given."""


def normal_gravity(latitude: float, height: float = 0.0) -> float:
    """Return the gravity of the WGS 84 ellipsoid.

    On the ellipsoid ``g0 = ge (1 + k sin²φ) / sqrt(1 - e² sin²φ)`` (Somigliana's closed form); at
    height h above it ``g = g0 (1 - 2 (1 + f + m - 2 f sin²φ) h / a + 3 h² / a²)``.

    The gravity of a place differs from it by its anomaly, mostly below 1e-3 m/s² (100 mGal).

    Parameters
    ----------
    latitude : float, rad
        Geodetic.
    height : float, m
        Above the ellipsoid; up to some 10 km, where the series is good to 1e-6 m/s².

    Raises
    ------
    ValueError
        If `latitude` is not within ±π/2 or `height` is not within -1 km (mines) and 20 km.

    References
    ----------
    .. [1] NGA.STND.0036, Department of Defense World Geodetic System 1984, version 1.0.0, 2014,
       eqs. (4-1) and (4-3).
    .. [2] W. A. Heiskanen, H. Moritz, Physical Geodesy, 1967, eqs. (2-78) and (2-123).
    """
    if not abs(latitude) <= np.pi / 2:
        raise ValueError(f"`latitude` must be within ±π/2 rad (±90°), got {latitude}")
    if not -1000.0 <= height <= 20000.0:
        raise ValueError(f"`height` must be in metres, within -1000 and 20000, got {height}")
    square = np.sin(latitude) ** 2
    surface = (
        GRAVITY_EQUATOR * (1 + SOMIGLIANA * square) / np.sqrt(1 - ECCENTRICITY_SQUARED * square)
    )
    h = height / SEMI_MAJOR_AXIS
    return float(
        surface * (1 - 2 * (1 + FLATTENING + RATE_RATIO - 2 * FLATTENING * square) * h + 3 * h**2)
    )
