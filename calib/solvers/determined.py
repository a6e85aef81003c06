"""Which directions of the parameter space the data determines, and which parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from calib.types import BoolArray, FloatArray

OPEN = 0.1
"""A parameter is not determined if, after the data, more than this part of its prior is open."""


@dataclass(frozen=True, eq=False)
class Determined:
    """The split of a parameter space by an information matrix.

    Parameters
    ----------
    basis : (p, r) array
        Directions that are determined, normalised so that ``basis @ basis.T`` is the covariance.
    null : (p, p - r) array
        Directions that are not, normalised so that ``null @ null.T`` is the prior's covariance.
    prior : (p,) array
        The prior's standard deviations.
    """

    basis: FloatArray
    null: FloatArray
    prior: FloatArray

    @property
    def undetermined(self) -> BoolArray:
        """Mask of the parameters of which the undetermined directions leave too much open."""
        mask: BoolArray = np.square(self.null).sum(axis=1) > (OPEN * self.prior) ** 2
        return mask

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the parameters, (p, p); NaN for those that are not determined."""
        total = self.basis @ self.basis.T + self.null @ self.null.T
        lost = self.undetermined
        total[lost] = np.nan
        total[:, lost] = np.nan
        return total


def split(
    information: FloatArray,
    spurious: FloatArray,
    prior: FloatArray,
    *,
    enough: float,
    rank: int | None = None,
) -> Determined:
    """Split the parameter space.

    Parameters
    ----------
    information : (p, p) array
    spurious : (p, p) array, positive definite
        The information that a direction would seem to have if the data held none: what the noise in
        the regressors fakes, and as much as makes a direction worth the name.
    prior : (p,) array
        Standard deviations of the parameters before any data.
    enough : float
        Information that determines a direction, as a multiple of the spurious.
    rank : int, optional
        How many directions are determined, where that was decided before. Of what holds no
        information at all none is.
    """
    values, vectors = eigh(information, spurious)  # ascending
    lost = int((values < enough).sum()) if rank is None else len(values) - rank
    lost = max(lost, int((values <= 0.0).sum()))
    null, _ = np.linalg.qr(vectors[:, :lost] / prior[:, None])
    return Determined(vectors[:, lost:] / np.sqrt(values[lost:]), null * prior[:, None], prior)
