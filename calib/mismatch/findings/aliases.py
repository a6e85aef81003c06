"""What a recording by itself cannot tell from a parameter of its twin, whatever else is in it.

A local gravity that is not the assumed one is a common scale factor of the accelerometers, a clock
that runs fast one of the gyroscopes. Neither leaves a residual. What can be said is how large such
an effect would be if it were the cause, and whether the axes are as alike as it would make them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtri

from calib.calibration import Quantity, parameter_unit
from calib.effects import effects
from calib.model import SensorModel
from calib.recording import AXES
from calib.types import FloatArray

CLEAR = 5.0
"""Standard errors from which a common scale factor is there, or axes would be seen to differ."""

FAR, NEARLY = 0.05, 0.25
"""Scale factor that no part leaves its factory with (data sheets allow 3 %), and how much of it the
axes may differ by, as parts of one sensor do, for it to be one that they share."""

DIFFERENT = float(chdtri(2, 0.01))
"""Chi-squared of the two differences of three axes that axes alike exceed in one of a hundred."""


@dataclass(frozen=True)
class Alias:
    """An effect that would look the same as parameters of the twin.

    Parameters
    ----------
    effect : str
    alias_of : str
        The group of parameters, of which all axes would be shifted alike.
    common : Quantity
        What they have in common.
    parameters : mapping
        Of the effect, if it were all of that.
    alike : bool
        Whether the axes are clearly off and differ by no more than their standard errors, as parts
        of one sensor seldom do, or are further off than any part, and differ by far less.
    needs : str
        What would tell.
    """

    effect: str
    alias_of: str
    common: Quantity
    parameters: Mapping[str, Quantity]
    alike: bool
    needs: str

    def to_json(self) -> dict[str, Any]:
        """Return it as JSON."""
        return {
            "effect": self.effect,
            "alias_of": self.alias_of,
            "common": vars(self.common),
            "parameters": {k: vars(q) for k, q in self.parameters.items()},
            "alike": self.alike,
            "needs": self.needs,
        }


def find_aliases(
    model: SensorModel,
    start: SensorModel,
    names: tuple[str, ...],
    covariance: FloatArray,
    *,
    gravity: float,
) -> tuple[Alias, ...]:
    """Return the effects that would look like common scale factors of a triad.

    Parameters
    ----------
    model, start : SensorModel
        As fitted, and as it was believed to be.
    names : tuple of str
        Parameters of the model that were fitted.
    covariance : (p, p) array
    gravity : float, m/s²
    """
    out = []
    for effect in effects().values():
        size = effect.size_if(1.0, gravity=gravity)
        if size is None:
            continue
        (group,), (parameter,) = effect.absorbed_by, effect.parameters
        own = [f"{group}.{a}" for a in AXES]
        if set(own) - set(names):
            continue
        triad = group.split(".")[0]
        now, before = (getattr(m, triad).scale_factor_error for m in (model, start))
        shift = (1.0 + now) / (1.0 + before) - 1.0
        index = [names.index(n) for n in own]
        weight = np.linalg.pinv(covariance[np.ix_(index, index)])
        variance = 1.0 / max(float(weight.sum()), 1e-300)
        common, sigma = float(variance * weight.sum(axis=0) @ shift), float(np.sqrt(variance))
        left = shift - common
        # What is clear of the worst axis is clear of all together.
        clear = abs(common) > CLEAR * np.sqrt(np.diag(covariance)[index].max())
        far = abs(common) > FAR and np.abs(left).max() < NEARLY * abs(common)
        alike = clear and (far or float(left @ weight @ left) < DIFFERENT)
        unit = parameter_unit(f"{effect.slug}.{parameter.name}")
        out.append(
            Alias(
                effect=effect.slug,
                alias_of=group,
                common=Quantity(common, sigma, "1"),
                parameters={parameter.name: Quantity(size * common, size * sigma, unit)},
                alike=bool(alike),
                needs=effect.needs,
            )
        )
    return tuple(out)
