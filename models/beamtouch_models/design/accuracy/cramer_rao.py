"""The Cramer-Rao bound: how well a place can be told near a contact, whatever the estimator.

The covariance of unbiased estimates of a place is at least the inverse of the Fisher information. For a sample of mean
F g(x) with independent Gaussian errors s per channel, let J be the change of F g / s along each axis (channels, axes).
Only the part of J orthogonal to g/s counts, as a change along g may as well come from the force. A force that is known
is one more channel, which reads the force and not the place: it adds a row to g/s, that of 1 over the deviation of the
force (`ForceRange.precision_per_n2`), and zeros to J. For an exact force, all of J counts. The errors are those of
noise, gains, zeros and mounting. Their size depends on the contact; the bound ignores that. Kay, Fundamentals of
Statistical Signal Processing: Estimation Theory, 1993, sec. 3.7 and 3.8.
"""

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.places import along_axis

PARTS, FORCES = 1001, 32
"""Points of the midpoint rule over the extent and over the range of forces."""


def cramer_rao_deviation_mm(prior: Prior, place_mm: Floats, force_n: Floats) -> Floats:
    """Return the Cramer-Rao bound on the deviation along each axis, (contacts, axes) in mm; may be infinite.

    Places are (contacts, axes), forces (contacts,). It holds for unbiased estimates. Where it exceeds the range, as at
    a support, an estimate that uses the range is better.
    """
    deviation = prior.tabled_deviation_mm(place_mm, force_n[:, None])
    change, shape = (
        prior.influence_table.slope(place_mm) / deviation[..., None],
        prior.influence_table(place_mm) / deviation,
    )
    # The force reads itself, as one more channel.
    shape = np.column_stack([shape, np.full(len(shape), prior.force_range.precision_per_n2**0.5)])
    change = np.concatenate([change, np.zeros_like(change[:, :1])], axis=1)
    size = (shape**2).sum(axis=1)[:, None]
    along = np.einsum("nca,nc->na", change, shape)
    along = np.divide(along, size, out=np.zeros_like(along), where=size > 0)
    change = change - shape[..., None] * along[:, None]
    # The information on one axis is the part of its change that the other does not explain (Schur complement of J'J).
    bound = np.empty(place_mm.shape)
    for axis in range(prior.extent.axes):
        own = change[..., axis]
        if prior.extent.axes > 1:
            other = change[..., 1 - axis]
            square = (other**2).sum(axis=1)
            share = np.divide((own * other).sum(axis=1), square, out=np.zeros(len(own)), where=square > 0)
            own = own - other * share[:, None]
        with np.errstate(divide="ignore"):
            bound[:, axis] = 1 / (force_n * np.linalg.norm(own, axis=1))
    return bound


def cramer_rao_error_mm(prior: Prior) -> float:
    """Return the mean |error| over the ranges of a Gaussian error with the bound's deviation, at most that of a guess.

    It approaches the accuracy limit as the noise goes to zero. At high noise it is a rough value and not a bound.
    """
    return float(cramer_rao_errors_mm(prior).mean())


def cramer_rao_errors_mm(prior: Prior) -> Floats:
    """Return the same over the forces alone, in the middle of each part of the extent; (parts of each axis).

    Of two axes it is the root of the sum of the squares of the mean errors along each: up to a tenth less than the
    mean distance.
    """
    extent = prior.extent
    parts = along_axis(PARTS, extent.axes)
    places, (weak, strong) = extent.middles(parts), prior.force_n
    forces = weak + (strong - weak) * (np.arange(FORCES) + 0.5) / FORCES if weak < strong else np.array([weak])
    contacts = np.repeat(places, len(forces), axis=0), np.tile(forces, len(places))
    gaussian = np.sqrt(2 / np.pi) * cramer_rao_deviation_mm(prior, *contacts)
    guess = ((contacts[0] - extent.low_mm) ** 2 + (extent.high_mm - contacts[0]) ** 2) / (2 * extent.size_mm)
    distances: Floats = np.hypot.reduce(np.minimum(gaussian, guess), axis=1)
    return np.asarray(distances.reshape(*[parts] * extent.axes, len(forces)).mean(axis=-1))
