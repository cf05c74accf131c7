"""The likelihood of places under any covariance of a sample, with the force integrated out exactly.

For a given place the likelihood is Gaussian in the force, so its integral over an even piece of the prior of the force
is a difference of normal distribution functions. That takes the errors of the gains from the sample, which holds as far
as a scene may state them (`MAX_GAIN_PERCENT`). Places may have any number of axes: only the influence there counts.
"""

from functools import reduce

import numpy as np
from scipy.special import log_ndtr

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Forces, Piece

NEGLIGIBLE = 40.0
"""Difference to the largest log density beyond which a place is not part of a posterior."""


def log_density(
    forces: Forces,
    whitening: Floats,
    sample: Floats,
    influence: Floats,
    variance: Floats | None = None,
    shared: Floats | None = None,
    negligible: float = NEGLIGIBLE,
) -> Floats:
    """Return log densities (draws, grid) of places, up to a constant per draw, with the force integrated out.

    Parameters
    ----------
    forces : the prior of the force
    whitening : (draws, channels, channels) in 1/mm, or (draws, channels) its diagonal, where errors are independent
    sample : (draws, channels), whitened
    influence : (draws or 1, grid, channels) in mm/N at the places of a grid
    variance : of the influence by mounting or interpolation, in the same shape; None: it is exact
    shared : (channels, sources) loadings of that variance, as of `Prior`
    negligible : difference to the largest log density beyond which it need not be exact
    """
    shapes, samples = _weighed(whitening, influence), sample[:, :, None]
    if variance is None:
        return _fitted(forces, shapes, samples, 0.0, negligible)
    # The likeliest force at a place says how much the mounting adds to each channel's variance there. Of W D W',
    # with the mounting's own variances D, only the diagonal is taken: exact where the errors of channels are
    # independent.
    force = _likeliest(forces, shapes, samples)[:, None, :]
    own = variance if shared is None else variance * (1 - (shared**2).sum(axis=1))
    wider = np.sqrt(1 + force**2 * _weighed(whitening**2, own))
    shapes, samples, log_volume = shapes / wider, samples / wider, np.log(wider).sum(axis=1)
    loadings = [] if shared is None else list(shared.T)
    sources = [force * _weighed(whitening, np.sqrt(variance) * loading) / wider for loading in loadings]
    while sources:
        source, *others = sources
        square = (source**2).sum(axis=1, keepdims=True)
        shapes, samples, *sources = (_without_source(vectors, source, square) for vectors in (shapes, samples, *others))
        log_volume = log_volume + np.log1p(square[:, 0]) / 2
    return _fitted(forces, shapes, samples, log_volume, negligible)


def _without_source(vectors: Floats, source: Floats, square: Floats) -> Floats:
    """Return vectors (draws, channels, grid) in deviations to which a source of errors has been added.

    It is (I + c c')^-1/2 of each, with the source c, in its shape, and the square of its length (draws, 1, grid).
    """
    root = np.sqrt(1 + square)
    along = (source * vectors).sum(axis=1, keepdims=True)
    left: Floats = vectors - source * (along / (root * (1 + root)))
    return left


def _weighed(weights: Floats, values: Floats) -> Floats:
    """Return values (draws or 1, grid, channels), weighed by a matrix or a number for each channel, channels first."""
    along: Floats = values.transpose(0, 2, 1)
    return weights[:, :, None] * along if weights.ndim == 2 else np.matmul(weights, along)


def _likeliest(forces: Forces, shapes: Floats, sample: Floats) -> Floats:
    """Return the likeliest force at each position, (draws, grid)."""
    square = np.einsum("dsg,dsg->dg", shapes, shapes)
    likeliest = (shapes * sample).sum(axis=1) / np.where(square > 0, square, 1.0)
    force: Floats = np.clip(likeliest, forces[0].low_n, forces[-1].high_n)
    return force


def _fitted(forces: Forces, shapes: Floats, sample: Floats, log_volume: Floats | float, negligible: float) -> Floats:
    """Return log densities (draws, grid) of shapes per newton and samples in their deviations.

    Shapes are (draws, channels, grid), samples (draws, channels, grid or 1). `log_volume` (draws, grid) is that of the
    product of their deviations.
    """
    size = np.sqrt(np.einsum("dsg,dsg->dg", shapes, shapes))
    unit = shapes / np.where(size > 0, size, 1.0)[:, None]
    projection = np.einsum("dsg,dsg->dg", unit, np.broadcast_to(sample, unit.shape))
    # Compute the residual directly: with little noise a difference of squares would cancel.
    residual = np.multiply(projection[:, None], unit, out=unit)
    np.subtract(sample, residual, out=residual)
    fit = np.einsum("dsg,dsg->dg", residual, residual) / -2 - log_volume
    # Integrate over the force where the posterior is not negligible. The largest integrand bounds the integral.
    nearest = np.clip(projection, forces[0].low_n * size, forces[-1].high_n * size)
    density: Floats = fit - (projection - nearest) ** 2 / 2
    rows, best = np.arange(len(density)), density.argmax(axis=1)
    least = log_likelihood(forces, size[rows, best], projection[rows, best], fit[rows, best]) - negligible
    likely = density >= least[:, None]
    density[likely] = log_likelihood(forces, size[likely], projection[likely], fit[likely])
    return density


def possible_rise(density: Floats, axis: int) -> Floats:
    """Return by how much log densities may rise between the nodes of a grid along an axis, in their shape.

    Where a grid is much wider than a posterior, its nodes miss the peak. A parabola through three nodes rises above the
    middle one by at most an eighth of its drop to the lower neighbour; half of the drop is allowed for.
    """
    along = np.moveaxis(density, axis, -1)
    beside = np.pad(along, [(0, 0)] * (along.ndim - 1) + [(1, 1)], mode="edge")
    lower, higher = np.minimum(beside[..., :-2], beside[..., 2:]), np.maximum(beside[..., :-2], beside[..., 2:])
    return np.moveaxis(np.where(along >= higher, (along - lower) / 2, 0.0), -1, axis)


def log_likelihood(forces: Forces, size: Floats, projection: Floats, fit: Floats) -> Floats:
    """Return the log likelihood of samples at the places of a grid, in units of the noise; (..., grid).

    Parameters
    ----------
    forces : the prior of the force
    size : (grid,) or in the shape of the others, length of the vector of deflections per newton
    projection : (..., grid), of the sample on the direction of that vector
    fit : (..., grid), minus half the squared residual

    Terms that depend on neither the place nor the force are left out.
    """
    first, *others = (np.log(piece.share) + _log_mean(piece, size, projection) for piece in forces)
    likelihood: Floats = fit + reduce(np.logaddexp, others, first)
    return likelihood


def _log_mean(piece: Piece, size: Floats, projection: Floats) -> Floats:
    """Return the log of the mean over a piece of forces of exp(-(projection - force size)^2 / 2)."""
    low, high = piece.low_n, piece.high_n
    middle: Floats = -((projection - (low + high) / 2 * size) ** 2) / 2
    if low == high:
        return middle
    # Where the force hardly matters, as next to a support, use the midpoint rule.
    flat = size * (high - low) < 1e-4
    length = np.where(flat, 1.0, size)
    span = _log_normal_interval(low * length - projection, high * length - projection) - np.log(length)
    mean: Floats = np.where(flat, middle, span + np.log(np.sqrt(2 * np.pi) / (high - low)))
    return mean


def _log_normal_interval(low: Floats, high: Floats) -> Floats:
    """Return log(Phi(high) - Phi(low)) for low < high, without cancellation in either tail."""
    flip = low + high > 0
    upper, lower = np.where(flip, -low, high), np.where(flip, -high, low)
    log_upper = log_ndtr(upper)
    difference: Floats = log_upper + np.log(-np.expm1(np.minimum(log_ndtr(lower) - log_upper, -1e-300)))
    return difference
