"""A recording of known loads, with all that may explain it: the surface, and what the recording itself adds.

Zeros drift while loads are recorded, so each load counts from another zero; the times of the loads show it. A weight
that nobody stated, such as a hanger, makes each load heavier by the same force. Positions that are not measured from
the left end of the beam shift each load by the same distance. A channel whose characteristic is wrong, as when a curved
sensor is described as straight, bends its deflections as no other channel does. All are fitted beside the departures of
the surface. Drift is usual; the others are mistakes, which are named.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.calibration.nominal_surface import GRID, MAX_DEPARTURE, OFFSET_NOISES, NominalSurface
from beamtouch_models.design.calibration.recordings import Loads
from beamtouch_models.design.physics.structure import size_of
from beamtouch_models.runtime.health.residuals import Residuals

DRIFTING, WEIGHT, SHIFT = "drift", "weight", "shift"
COMMON = (WEIGHT, SHIFT)
"""Kinds of mistakes that all loads share: their size is fitted, and a model is calibrated without it."""
WEIGHT_SHARE = 0.1
"""Standard deviation of a plausible weight that nobody stated, over the middle of the scene's forces."""
SHIFT_SHARE = 0.02
"""Standard deviation of a plausible shift of all loads, over the length along each axis."""
OWN_BEND = 0.2
"""Standard deviation of the relative bend of one channel at full travel, and of its change along the travel."""
SESSION_MIN = 10.0
"""Usual time in which loads are recorded."""
BENDS = 2
"""Terms of the bend of a channel: the square and the cube of its deflection."""


def bend_of(channel: int) -> str:
    """Return the kind that is the own bend of a channel."""
    return f"bend {channel}"


@dataclass(frozen=True)
class Session:
    """A recording, and the vector of what may explain it: the departures of the surface, then its own kinds."""

    nominal: NominalSurface
    loads: Loads

    @cached_property
    def kinds(self) -> dict[str, slice]:
        """All kinds with their places in the vector, which has units of their plausible sizes."""
        kinds, begin, channels = self.nominal.kinds.copy(), self.nominal.size, self.nominal.prior.channels
        for kind, size in (
            (DRIFTING, channels),
            (WEIGHT, 1),
            (SHIFT, self._axes),
            *((bend_of(channel), BENDS) for channel in range(channels)),
        ):
            kinds[kind] = slice(begin, begin + size)
            begin += size
        return kinds

    @property
    def usual_kinds(self) -> tuple[str, ...]:
        """The kinds that are no mistakes: all departures, and drift if the loads have times."""
        return (*self.nominal.kinds, *((DRIFTING,) if self.loads.minutes.any() else ()))

    @property
    def size(self) -> int:
        """Length of the vector."""
        return self.nominal.size + 1 + self._axes + (1 + BENDS) * self.nominal.prior.channels

    def places_of(self, kinds: tuple[str, ...]) -> Indices:
        """Return the places of some kinds in the vector."""
        places = np.arange(self.size)
        return np.concatenate([places[:0], *(places[self.kinds[kind]] for kind in kinds)])

    def about(self, sizes: Mapping[str, float]) -> Floats:
        """Return the standard deviation of the prior of each entry, from sizes by kind."""
        about = np.ones(self.size)
        for kind, size in sizes.items():
            about[self.kinds[kind]] = size
        return about

    def bounds_of(self, free: Indices) -> tuple[Floats, Floats]:
        """Return the smallest and the largest values of fitted entries."""
        low, high = self.nominal.bounds_of(np.arange(self.nominal.size))
        own = np.full(self.size - self.nominal.size, MAX_DEPARTURE)
        return np.concatenate([low, -own])[free], np.concatenate([high, own])[free]

    def drift_mm(self, vector: Floats) -> Floats:
        """Return how far the zero of each channel has drifted at each load, (loads, channels)."""
        drift: Floats = self._drift_unit_mm[:, None] * vector[self.kinds[DRIFTING]]
        return drift

    def as_of_surface(self, vector: Floats) -> Loads:
        """Return the loads without what the recording itself adds."""
        return replace(
            self.loads,
            measured_mm=self.loads.measured_mm - self.drift_mm(vector) - self.bends_mm(vector),
            force_n=self.loads.force_n + self.weight_n(vector),
            place_mm=self.loads.place_mm + self.shift_mm(vector),
        )

    def rates_um_per_min(self, vector: Floats) -> Floats:
        """Return the drift of each channel (channels,)."""
        rates: Floats = 1e3 * self._rate_mm_per_min * vector[self.kinds[DRIFTING]]
        return rates

    def weight_n(self, vector: Floats) -> float:
        """Return the force that each load has beyond what is stated."""
        return self._weight_unit_n * float(vector[self.kinds[WEIGHT]][0])

    def shift_mm(self, vector: Floats) -> Floats:
        """Return how far from what is stated each load stands along each axis, (axes,)."""
        shift_mm: Floats = self._shift_unit_mm * vector[self.kinds[SHIFT]]
        return shift_mm

    def bends_mm(self, vector: Floats) -> Floats:
        """Return what the own bends of the channels take off their deflections (loads, channels)."""
        return np.stack(
            [
                self._bend_units_mm[:, :, channel] @ vector[self.kinds[bend_of(channel)]]
                for channel in range(self._channels)
            ],
            axis=1,
        )

    def residuals(self, vector: Floats) -> Residuals:
        """Return the residuals of the loads."""
        loads, curve = self.as_of_surface(vector), self.nominal.curve(vector)
        deviation_mm = np.hypot(loads.deviation_mm, self._left_open_mm)
        return Residuals.of(curve, loads.place_mm, loads.force_n, loads.measured_mm, deviation_mm)

    def slopes(self, vector: Floats, kinds: tuple[str, ...]) -> Floats:
        """Return the change of what is expected of each deflection with each entry, (loads, channels, entries).

        It is 0 for the entries of other kinds than `kinds`, and without a measurement.
        """
        loads, of_theory = self.as_of_surface(vector), [kind for kind in kinds if kind in self.nominal.kinds]
        channels = np.arange(self._channels)
        slopes = np.zeros((*loads.measured_mm.shape, self.size))
        departing = self.nominal.slopes(vector[: self.nominal.size], loads.place_mm, loads.force_n, of_theory)
        slopes[..., : self.nominal.size] = departing
        if DRIFTING in kinds:
            slopes[:, channels, self.kinds[DRIFTING].start + channels] = self._drift_unit_mm[:, None]
        if WEIGHT in kinds or SHIFT in kinds:
            *by_place, by_force = self.nominal.curve(vector).moved_mm(loads.place_mm, loads.force_n)
            if WEIGHT in kinds:
                slopes[..., self.kinds[WEIGHT].start] = self._weight_unit_n * by_force / loads.force_n[:, None]
            if SHIFT in kinds:
                slopes[..., self.kinds[SHIFT]] = self._shift_unit_mm * np.stack(by_place, axis=-1)
        for channel in channels.tolist():
            if bend_of(channel) in kinds:
                slopes[:, channel, self.kinds[bend_of(channel)]] = self._bend_units_mm[:, :, channel]
        # The bend of a deflection that was not measured is not a number.
        there: Floats = np.where(np.isfinite(loads.measured_mm)[..., None], slopes, 0.0)
        return there

    @cached_property
    def _left_open_mm(self) -> Floats:
        """(loads, channels) what the table of a measured structure leaves open: the loads are as they are stated."""
        return self.nominal.left_open_mm(self.loads.place_mm, self.loads.force_n)

    @property
    def _channels(self) -> int:
        return self.nominal.prior.channels

    @property
    def _rate_mm_per_min(self) -> float:
        """A plausible drift: as stated, and at least one that shows in a usual session."""
        return max(self.nominal.drift_mm_per_min, OFFSET_NOISES * self.nominal.prior.errors.noise_mm / SESSION_MIN)

    @property
    def _drift_unit_mm(self) -> Floats:
        """(loads,) plausible drift from the first load to each."""
        return self._rate_mm_per_min * self.loads.minutes

    @property
    def _weight_unit_n(self) -> float:
        """A plausible weight that nobody stated. It is the same for some of the loads as for all."""
        return WEIGHT_SHARE * float(np.mean(self.nominal.prior.force_n))

    @property
    def _axes(self) -> int:
        return self.nominal.prior.extent.axes

    @property
    def _shift_unit_mm(self) -> Floats:
        """(axes,) plausible shift of all loads."""
        return SHIFT_SHARE * np.array(size_of(self.nominal.structure))

    @cached_property
    def _bend_units_mm(self) -> Floats:
        """(loads, terms, channels) deflection that the terms of a plausible bend add; they vanish at rest."""
        prior = self.nominal.prior
        shapes = prior.influence_at(prior.extent.grid(GRID[self._axes]))
        full_mm = prior.force_n[1] * np.abs(shapes).max(axis=0)
        share = self.loads.measured_mm[:, None] / full_mm
        units_mm: Floats = OWN_BEND * full_mm * share ** (2 + np.arange(BENDS))[:, None]
        return units_mm
