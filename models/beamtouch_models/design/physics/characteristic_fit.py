"""The characteristic of each sensor, fitted from known loads: what it shows, as a deflection that grows with the force.

The influence is a product of force and place, so on a logarithmic scale it is a sum: log(force) + log(influence) is a
smooth function of log(shown). Its coefficients are a least-squares problem, whose scale is open: shown and straightened
deflections have the same largest value.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.interpolate import BSpline

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.errors import SceneError

KNOTS, DEGREE = 8, 3
"""Of the spline over the logarithm of what a sensor shows."""
STIFFNESS = 1.0
"""Weight of the second differences of its coefficients."""
PLACED = 0.05
"""Relative error of a load, as a standard deviation: it keeps a few loads from deciding all."""
SEEN = 2.0
"""What a sensor shows counts from so many noises on."""
POINTS = 24
"""Of the table of a characteristic, beside its beginning and the part below rest."""
BELOW = 0.2
"""How far a table reaches below rest, over its largest value."""
RISES = 1e-6
"""Least step of the logarithm from point to point, so that a characteristic always rises."""
LEVELS, PLACES = 2, 3
"""Forces at a place, and such places, that a characteristic needs at least."""


@dataclass(frozen=True, eq=False)
class _Spline:
    """The spline of a characteristic, over the logarithm of what a sensor shows."""

    knots: Floats
    smooth: Floats
    """(coefficients - 2, coefficients) rows that hold its second differences small."""

    @classmethod
    def over(cls, shown: Floats) -> Self:
        """Return the spline over what was shown (loads,), all positive."""
        logs = np.log(shown)
        knots = np.linspace(logs.min(), max(logs.max(), logs.min() + KNOTS * RISES), KNOTS)
        beyond = float(knots[1] - knots[0]) * np.arange(1, DEGREE + 1)
        smooth = np.sqrt(STIFFNESS) * np.diff(np.eye(KNOTS + DEGREE - 1), 2, axis=0)
        return cls(np.concatenate([knots[0] - beyond[::-1], knots, knots[-1] + beyond]), smooth)

    def design(self, shown: Floats) -> Floats:
        """Return the weight (loads, coefficients) of each coefficient under what is shown (loads,)."""
        logs = np.clip(np.log(shown), self.knots[DEGREE], self.knots[-DEGREE - 1])
        matrix: Floats = BSpline.design_matrix(logs, self.knots, DEGREE).toarray()
        return matrix


@dataclass(frozen=True, eq=False)
class Characteristic:
    """What a sensor shows, and the straight deflection behind it: a line from point to point, ascending."""

    shown_mm: Floats
    """(points,)"""
    straight_mm: Floats
    """(points,)"""

    @classmethod
    def fit(cls, name: str, place_mm: Floats, force_n: Floats, shown_mm: Floats, noise_mm: float) -> Self:
        """Fit the characteristic of a sensor to known loads (loads,), whose places are (loads, axes).

        Raises
        ------
        SceneError
            The loads do not tell it; the message says which are missing.
        """
        is_seen = shown_mm > SEEN * noise_mm
        places, place_of = np.unique(place_mm[is_seen], axis=0, return_inverse=True)
        levels = [len(np.unique(force_n[is_seen][place_of == index])) for index in range(len(places))]
        if sum(level >= LEVELS for level in levels) < PLACES:
            if (shown_mm < -SEEN * noise_mm).sum() > is_seen.sum():
                raise SceneError(
                    f"measured.curved: {name} shows less than at rest under most loads, and a characteristic grows "
                    "with the force; change the signs of its column, or leave curved out"
                )
            raise SceneError(
                f"measured.curved: {name} shows more than its noise with {LEVELS} forces at fewer than {PLACES} "
                "places; measure with several forces at each place, or leave curved out"
            )
        shown, force = shown_mm[is_seen], force_n[is_seen]
        spline = _Spline.over(shown)
        design, smooth = spline.design(shown), spline.smooth
        weight = 1 / np.hypot(noise_mm / shown, PLACED)
        rows = np.block(
            [
                [design * weight[:, None], -np.eye(len(places))[place_of] * weight[:, None]],
                [smooth, np.zeros((len(smooth), len(places)))],
                [np.zeros((1, design.shape[1])), np.ones((1, len(places)))],
            ]
        )
        wanted = np.concatenate([np.log(force) * weight, np.zeros(len(smooth) + 1)])
        coefficients: Floats = np.linalg.lstsq(rows, wanted, rcond=None)[0][: design.shape[1]]
        return cls._of(spline, coefficients, shown)

    @classmethod
    def fit_to_known(cls, straight_mm: Floats, shown_mm: Floats, noise_mm: float) -> Self:
        """Fit the characteristic of a sensor whose straight deflections (loads,) a theory knows, but for their scale.

        Loads without a deflection by the theory, or without one that is seen, do not count; some others must be left.
        """
        counts = (straight_mm > 0) & (shown_mm > SEEN * noise_mm)
        shown = shown_mm[counts]
        spline = _Spline.over(shown)
        weight = 1 / np.hypot(noise_mm / shown, PLACED)
        rows = np.vstack([spline.design(shown) * weight[:, None], spline.smooth])
        wanted = np.concatenate([np.log(straight_mm[counts]) * weight, np.zeros(len(spline.smooth))])
        coefficients: Floats = np.linalg.lstsq(rows, wanted, rcond=None)[0]
        return cls._of(spline, coefficients, shown)

    @classmethod
    def _of(cls, spline: "_Spline", coefficients: Floats, shown: Floats) -> Self:
        """Return the table of a spline over what was shown (loads,), whose scale is that of what was shown."""
        points = np.geomspace(shown.min(), shown.max(), POINTS)  # with the digits of both ends: nothing is beyond them
        rising = np.maximum.accumulate(spline.design(points) @ coefficients - RISES * np.arange(POINTS))
        straight = np.exp(rising + RISES * np.arange(POINTS))
        straight *= shown.max() / straight[-1]
        below = -BELOW * points[-1]
        return cls(
            np.concatenate([[below, 0.0], points]),
            np.concatenate([[below * straight[0] / points[0], 0.0], straight]),
        )

    @property
    def at_rest(self) -> float:
        """Change of the straight deflection with what is shown, at rest."""
        return float(self.straight_mm[2] / self.shown_mm[2])

    def straighten(self, shown_mm: Floats) -> Floats:
        """Return the straight deflections of what is shown; NaN beyond the ends of the table."""
        straight: Floats = np.interp(shown_mm, self.shown_mm, self.straight_mm, left=np.nan, right=np.nan)
        return straight

    def slope(self, shown_mm: Floats) -> Floats:
        """Return the change of `straighten` with what is shown, interpolated between the middles of the lines."""
        middles = (self.shown_mm[1:] + self.shown_mm[:-1]) / 2
        slopes: Floats = np.interp(shown_mm, middles, np.diff(self.straight_mm) / np.diff(self.shown_mm))
        return slopes

    def show(self, straight_mm: Floats) -> Floats:
        """Return what the sensor shows of straight deflections; at most what the table ends with."""
        shown: Floats = np.interp(straight_mm, self.straight_mm, self.shown_mm)
        return shown


def mean_at_places(
    place_mm: Floats,
    force_n: Floats,
    shown_mm: Floats,
    characteristics: Sequence[Characteristic],
    noise_mm: float,
) -> tuple[Floats, Floats, Floats]:
    """Return the straight deflection per newton at each place, as a mean of its loads, and their scatter.

    Parameters
    ----------
    place_mm, force_n, shown_mm : known loads, (loads, axes), (loads,) and (loads, sensors)
    characteristics, noise_mm : of the sensors, and how far what one shows may be off

    Returns
    -------
    Places (places, axes), means (places, sensors), NaN where a sensor shows only what is beyond its characteristic, and
    by what part of it each sensor (sensors,) differs from load to load beyond its noise.
    """
    straight = np.column_stack([one.straighten(shown) for one, shown in zip(characteristics, shown_mm.T, strict=True)])
    slope = np.column_stack([one.slope(shown) for one, shown in zip(characteristics, shown_mm.T, strict=True)])
    places, place_of = np.unique(place_mm, axis=0, return_inverse=True)
    there: Bools = np.isfinite(straight)
    value = np.where(there, straight, 0.0) / force_n[:, None]
    deviation = noise_mm * slope / force_n[:, None]
    weight = np.where(there, 1 / (deviation**2 + (PLACED * value) ** 2), 0.0)
    at = np.eye(len(places))[place_of]
    total = at.T @ weight
    mean = (at.T @ (weight * value)) / np.maximum(total, np.finfo(np.float64).tiny)
    off = value - mean[place_of]
    beyond_noise = (weight * (off**2 - deviation**2)).sum(axis=0) / (weight * value**2).sum(axis=0)
    return places, np.where(total > 0, mean, np.nan), np.sqrt(np.maximum(beyond_noise, 0.0))
