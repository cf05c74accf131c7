"""A theory of a structure, fitted to a few known loads: a gain a sensor, and by how much the theory misses the loads.

The theory says what each sensor shows per newton but for a factor. How far it is off is judged at loads that were left
out, place by place. It has a part that grows with what the sensor shows, and one that does not. Neither is chosen: all
combinations of a grid count by the probability of what was missed, so that a few loads do not pretend to know them.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.interpolate import PchipInterpolator

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.design.physics.characteristic_fit import SEEN, Characteristic
from beamtouch_models.design.physics.smoothness import Smoothness
from beamtouch_models.errors import SceneError
from beamtouch_models.places import positions_of

MISSES = np.geomspace(0.002, 1.0, 28)
"""Standard deviations by which a theory may miss, over what a sensor shows, and over its mean square."""
CURVED_LOADS, CURVED_PLACES = 6, 3
"""Loads and their places that a sensor must show for its characteristic to be fitted."""
SMOOTH = Smoothness(kernel=1, scatter=0.0, additive=0.0, lengths=(0.3,))
"""Of the departures from a theory that are simulated, over the span of the places."""
FEWEST_PLACES = 3
"""Places of loads without which nothing tells by how much a theory misses."""
ENOUGH, SURELY, WRONG = 8, 8.0, 0.1
"""A load contradicts so many others or more, if it is so many deviations and this part of the influence off."""
NO_THEORY = 0.3
"""Part of what a sensor shows beyond which a theory is of another structure."""
USUAL = 0.1
"""Part of what a sensor shows by which a theory is taken to miss, until the loads have told it."""
ROUNDING = 1e-9
"""Added to the variances of a smooth function, so that its covariance has a factor."""


@dataclass(frozen=True, eq=False)
class Theory:
    """What each sensor shows per newton by theory, but for a factor; between the places of its table, monotone."""

    position_mm: Floats
    """(places,), ascending."""
    influence: Floats
    """(places, sensors)"""

    @classmethod
    def of(cls, position_mm: Floats, influence: Floats) -> Self:
        """Take a table in any order; places that it has twice count as their mean."""
        places, place_of = np.unique(position_mm, return_inverse=True)
        at = np.eye(len(places))[place_of]
        return cls(places, (at.T @ influence) / at.sum(axis=0)[:, None])

    def at(self, position_mm: Floats) -> Floats:
        """Return what sensors show (places, sensors) under loads within the table; at its ends beyond them."""
        within = np.clip(position_mm, self.position_mm[0], self.position_mm[-1])
        shown: Floats = PchipInterpolator(self.position_mm, self.influence)(within)
        return shown


@dataclass(frozen=True, eq=False)
class KnownLoads:
    """Known loads, what sensors show under them, and what a theory says per newton."""

    position_mm: Floats
    """(loads,)"""
    force_n: Floats
    """(loads,)"""
    shown_mm: Floats
    """(loads, sensors)"""
    by_theory: Floats
    """(loads, sensors) per newton."""

    def where(self, chosen: Bools) -> Self:
        """Return the loads (loads,) that are chosen."""
        return type(self)(self.position_mm[chosen], self.force_n[chosen], self.shown_mm[chosen], self.by_theory[chosen])

    def check_curved(self, names: tuple[str, ...], noise_mm: float) -> None:
        """Raise SceneError unless the loads tell the characteristic of each sensor."""
        for name, shown, theory in zip(names, self.shown_mm.T, self.by_theory.T, strict=True):
            counts = (theory > 0) & (shown > SEEN * noise_mm)
            levels, places = (len(np.unique(one[counts])) for one in (shown, self.position_mm))
            if levels < CURVED_LOADS or places < CURVED_PLACES:
                raise SceneError(
                    f"measured.curved: {name} shows more than its noise under {levels} loads at {places} places, and "
                    f"its characteristic needs {CURVED_LOADS} at {CURVED_PLACES}; measure with more forces, or leave "
                    "curved out"
                )


@dataclass(frozen=True, eq=False)
class Gains:
    """A gain a sensor on a theory, with the characteristics of curved sensors."""

    gain: Floats
    """(sensors,)"""
    characteristics: tuple[Characteristic, ...]
    """None of straight sensors."""

    @classmethod
    def fit(cls, loads: KnownLoads, noise_mm: float, *, curved: bool) -> Self:
        """Fit characteristics, and gains by least squares."""
        theory, sensors = loads.by_theory, zip(loads.by_theory.T, loads.shown_mm.T, strict=True)
        characteristics = tuple(
            Characteristic.fit_to_known(loads.force_n * shape, shown, noise_mm) for shape, shown in sensors if curved
        )
        value, noise = cls(np.ones(theory.shape[1]), characteristics).read(loads, noise_mm)
        largest = np.sqrt(np.mean(theory**2, axis=0))
        roughly = np.nansum(value * theory, axis=0) / np.sum(theory**2, axis=0)
        variance = noise**2 + (USUAL * roughly * np.hypot(theory, largest)) ** 2
        weight = np.where(np.isfinite(value), 1 / variance, 0.0)
        gain = np.nansum(weight * value * theory, axis=0) / np.sum(weight * theory**2, axis=0)
        return cls(gain, characteristics)

    def read(self, loads: KnownLoads, noise_mm: float) -> tuple[Floats, Floats]:
        """Return what sensors read per newton (loads, sensors), over their gain, and its noise.

        What is beyond a characteristic is NaN.
        """
        per_newton = 1 / (loads.force_n[:, None] * self.gain)
        if not self.characteristics:
            return loads.shown_mm * per_newton, noise_mm * np.abs(per_newton)
        sensors = list(zip(self.characteristics, loads.shown_mm.T, strict=True))
        straight_mm = np.column_stack([curved.straighten(shown) for curved, shown in sensors])
        slope = np.column_stack([curved.slope(shown) for curved, shown in sensors])
        return straight_mm * per_newton, noise_mm * slope * np.abs(per_newton)

    def show(self, loads: KnownLoads) -> Floats:
        """Return what sensors show (loads, sensors) under loads by theory."""
        straight_mm: Floats = loads.force_n[:, None] * self.gain * loads.by_theory
        if not self.characteristics:
            return straight_mm
        return np.column_stack(
            [curved.show(mm) for curved, mm in zip(self.characteristics, straight_mm.T, strict=True)]
        )


@dataclass(frozen=True, eq=False)
class TheoryFit:
    """A theory that was fitted to known loads. It stands for a `SmoothFit` where there are too few loads for one."""

    theory: Theory
    gains: Gains
    share: Floats
    """(sensors,) part of what a sensor shows by which the theory misses it, as a standard deviation."""
    constant: Floats
    """(sensors,) the part that does not grow with it, per newton and over the gain."""
    missed: Floats
    """(loads, sensors) by how much each load is missed if its place is left out, over the deviation of that."""

    @classmethod
    def of(cls, theory: Theory, loads: KnownLoads, noise_mm: float, *, curved: bool) -> Self:
        """Fit a theory to loads at three places or more, whose noise is that of what a sensor shows."""
        whole = Gains.fit(loads, noise_mm, curved=curved)
        off, noise = np.empty((2, *loads.by_theory.shape))
        for place in np.unique(loads.position_mm):
            there = loads.position_mm == place
            others = Gains.fit(loads.where(~there), noise_mm, curved=curved)
            value, noise[there] = others.read(loads.where(there), noise_mm)
            off[there] = value - loads.by_theory[there]
        largest = np.sqrt(np.mean(loads.by_theory**2, axis=0))
        columns = zip(off.T, noise.T, loads.by_theory.T, largest, strict=True)
        share, constant = np.transpose([_misses(*column) for column in columns])
        fit = cls(theory, whole, share, constant * largest, off)
        return replace(fit, missed=off / fit._deviation(loads.by_theory, noise))

    def at(self, place_mm: Floats) -> tuple[Floats, Floats]:
        """Return the influence and its standard deviation (places, sensors) at places (places, 1)."""
        shape, gain = self.theory.at(positions_of(place_mm)), self.gains.gain
        return gain * shape, np.abs(gain) * self._deviation(shape, 0.0)

    def draw(self, place_mm: Floats, rng: np.random.Generator) -> Floats:
        """Draw an influence that departs from the theory smoothly; returns it (places, sensors) at places (places, 1).

        By how much it departs follows from the loads, how smoothly does not: they are too few.
        """
        mean, deviation = self.at(place_mm)
        scaled = place_mm / np.ptp(place_mm)
        factor = np.linalg.cholesky(SMOOTH.covariance(scaled, scaled) + ROUNDING * np.eye(len(scaled)))
        drawn: Floats = mean + deviation * (factor @ rng.normal(size=mean.shape))
        return drawn

    @property
    def repeatability(self) -> Floats:
        """(sensors,) zeros: how loads repeat is part of what the theory misses."""
        return np.zeros_like(self.constant)

    def check(self, loads: KnownLoads, noise_mm: float, names: tuple[str, ...], unit: str) -> None:
        """Raise SceneError if one of the loads contradicts the others, or if the theory is none of this structure."""
        if other := [name for name, gain in zip(names, self.gains.gain, strict=True) if gain <= 0]:
            raise SceneError(
                f"measured.theory: {other[0]} shows the opposite of what it says; change the sign of its column in one "
                "of the tables"
            )
        if message := self._contradiction(loads, noise_mm, names, unit):
            raise SceneError(f"measured.influence: {message}")
        _, deviation = self.at(loads.position_mm[:, None])
        part = np.sqrt(np.mean((deviation / self.gains.gain) ** 2, axis=0) / np.mean(loads.by_theory**2, axis=0))
        worst = int(part.argmax())
        if part[worst] > NO_THEORY:
            raise SceneError(
                f"measured.theory: it misses what {names[worst]} shows by {digits(100 * part[worst], 2)} %; check its "
                "sensors, supports and places, state curved = true if heavy loads show less or more per newton "
                "than light ones, or leave theory out and measure more loads"
            )

    def _contradiction(self, loads: KnownLoads, noise_mm: float, names: tuple[str, ...], unit: str) -> str:
        """Say which load contradicts the others; empty if none does, or if they are too few to tell."""
        suspect = np.arange(len(loads.force_n)) == np.nanmax(np.abs(self.missed), axis=1).argmax()
        others, alone = loads.where(~suspect), loads.where(suspect)
        if len(others.force_n) < ENOUGH or len(np.unique(others.position_mm)) < FEWEST_PLACES:
            return ""
        without = TheoryFit.of(self.theory, others, noise_mm, curved=bool(self.gains.characteristics))
        value, noise = without.gains.read(alone, noise_mm)
        off = np.abs(value - alone.by_theory)
        surely = SURELY * without._deviation(alone.by_theory, noise)
        largest = np.sqrt(np.mean(loads.by_theory**2, axis=0))
        worst = int(np.nanargmax(off / surely))
        if not off[0, worst] > max(surely[0, worst], WRONG * largest[worst]):
            return ""
        said = without.gains.show(alone)[0, worst]
        return (
            f"under the load at {alone.position_mm[0]:g} mm with {alone.force_n[0]:g} N, {names[worst]} shows "
            f"{digits(float(alone.shown_mm[0, worst]), 3)} {unit}, but by the theory and the others it should show "
            f"{digits(float(said), 3)}; measure it again, or take it out"
        )

    def _deviation(self, by_theory: Floats, noise: Floats | float) -> Floats:
        """Return by how much the theory misses loads (loads, sensors) with this noise, over the gain."""
        deviation: Floats = np.sqrt(noise**2 + (self.share * by_theory) ** 2 + self.constant**2)
        return deviation


def _misses(off: Floats, noise: Floats, theory: Floats, largest: np.float64) -> list[float]:
    """Return by which part of itself, and of the largest, a theory misses loads (loads,) beyond their noise."""
    is_known = np.isfinite(off)
    share, constant = (one.ravel()[:, None] ** 2 for one in np.meshgrid(MISSES, MISSES))
    variance = noise[is_known] ** 2 + share * theory[is_known] ** 2 + constant * largest**2
    log_probability = -0.5 * (off[is_known] ** 2 / variance + np.log(variance)).sum(axis=1)
    probability = np.exp(log_probability - log_probability.max())[:, None]
    return [float(np.sqrt((probability * square).sum() / probability.sum())) for square in (share, constant)]
