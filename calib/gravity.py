"""Normal gravity by latitude and height, and its standard error."""

from __future__ import annotations

import numpy as np

STANDARD_GRAVITY = 9.80665
"""m/s², by definition (3rd General Conference on Weights and Measures, 1901)."""

EARTH = (9.7, 9.9)
"""m/s²; the least and the most that gravity is on Earth, with room: 9.764 on the highest mountains
of the tropics, 9.834 at sea level in the Arctic."""

ANOMALY = 3e-4
"""m/s²: what local gravity differs from the normal formula by, root mean square over the Earth: a
free-air anomaly of about 30 mGal."""


def normal_gravity(latitude: float, height: float) -> float:
    """Return normal gravity on WGS 84, m/s².

    Somigliana's closed formula on the ellipsoid, with its second-order expansion in height [1]_::

        gamma_0 = gamma_e (1 + k sin² φ) / sqrt(1 - e² sin² φ)
        gamma_h = gamma_0 (1 - 2/a (1 + f + m - 2 f sin² φ) h + 3/a² h²)

    Parameters
    ----------
    latitude : float, rad
        Geodetic.
    height : float, m
        Above the ellipsoid; above sea level is good to 3e-4 m/s².

    Raises
    ------
    ValueError
        If the latitude is beyond a pole, or the height beyond -1 to 20 km, where the expansion is
        good to 1e-6 m/s².

    References
    ----------
    .. [1] NIMA TR8350.2, "Department of Defense World Geodetic System 1984", 3rd ed., 2000, eqs.
       (4-1) and (4-3), tables 3.3 and 3.4.
    """
    if not abs(latitude) <= np.pi / 2:
        raise ValueError(f"`latitude` must be within ±90°, got {np.degrees(latitude):g}°")
    if not -1e3 <= height <= 20e3:
        raise ValueError(f"`height` must be between -1000 and 20000 m, got {height:g}")
    equator, k, e2 = 9.7803253359, 0.00193185265241, 0.00669437999014
    axis, flattening, m = 6378137.0, 1 / 298.257223563, 0.00344978650684
    sin2 = float(np.sin(latitude)) ** 2
    surface = equator * (1 + k * sin2) / float(np.sqrt(1 - e2 * sin2))
    slope = 2 / axis * (1 + flattening + m - 2 * flattening * sin2)
    return surface * (1 - slope * height + 3 * height**2 / axis**2)
