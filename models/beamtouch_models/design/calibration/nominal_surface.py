"""The surface as its scene and its model describe it, and how its deflections change with departures and loads."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.calibrated import depart
from beamtouch_models.design.physics.influence_function import Interpolation
from beamtouch_models.design.physics.structure import Structure, yields_alike
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.design.surface import resolve_model
from beamtouch_models.places import grid_of, in_rows, on_axis
from beamtouch_models.runtime.curve import InfluenceCurve
from beamtouch_models.runtime.departures import Departures
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.health.residuals import LoadErrors
from beamtouch_models.runtime.metadata import Metadata

GAIN, POSITION_MM, FIXITY, RIGIDITY, BEND, OFFSET_NOISES, SPRING = 0.04, 1.5, 0.1, 0.1, 0.03, 3.0, 0.1
"""Standard deviations of plausible departures: relative gain, sensor position, fixity, relative rigidity, relative bend
of the characteristic at full travel, offset in units of the noise of a sample, and relative stiffness of one spring of
a plate beside all of them."""
MAX_FIXITY = 0.9
ANY_FORCE = 3.0
"""Error of the force of a contact, relative to the force of the fit: as good as unknown."""
MAX_DEPARTURE = 8.0
"""Largest other departure, in units of plausible ones."""
GRID = {1: 129, 2: 33**2}
"""Places of the influence over the range of contacts by the number of axes; it is interpolated between them."""
MAX_INFLUENCES = 64
"""Number of influence matrices that are kept; it bounds their memory."""
PER_CHANNEL = ("gain", "position", "x", "y", "offset")
"""Kinds of departures of which each changes only the deflections of its own channel."""
FIELDS = {
    "rigidity": "rigidity",
    "gain": "gain",
    "position": "position_offset_mm",
    "curve": "curve_per_mm",
    "fixity": "fixity",
    "offset": "offset_mm",
}
"""Kinds of departures, in the order of the vector, with their fields."""
FIELDS_OF_PLATES = {
    "rigidity": "rigidity",
    "gain": "gain",
    "x": "position_offset_mm",
    "y": "across_offset_mm",
    "curve": "curve_per_mm",
    "springs": "spring_stiffness",
    "offset": "offset_mm",
}
"""The same of plates: places of sensors along both axes, and a spring in each support that is not rigid."""
FACTORS = ("rigidity", "gain", "springs")
"""Kinds that enter the vector by their logarithm."""
MAX_STEP = 2.0
"""Bound of a step of a fit, in units of plausible departures: far off, the slopes are those of another surface."""
STEP = 1e-4
"""Step of numerical derivatives, in units of the vector."""


@dataclass(frozen=True)
class NominalSurface:
    """The surface that a calibration departs from."""

    structure: Structure
    """The beam or plate, which is solved again for other supports and another rigidity, or the measured structure."""
    width_mm: float
    """Width of a contact."""
    sensor_mm: Floats
    prior: Prior
    max_deflection_mm: float
    drift_mm_per_min: float
    """Standard deviation of the drift of a zero."""
    unit: str
    """Unit of the deflections."""
    table: Interpolation | None
    """What the table of a measured structure leaves open; None for a beam."""
    mounting_mm: float = POSITION_MM
    """Standard deviation of a plausible position of a sensor from that of the layout."""
    _influences: dict[tuple[float, ...], Floats] = field(default_factory=dict, repr=False, compare=False)
    """Influence matrices that were computed recently."""

    @classmethod
    def of(cls, metadata: Metadata) -> "NominalSurface":
        """Return the nominal surface of a model; raises SceneError if its scene cannot be computed."""
        surface, sensor_mm = resolve_model(metadata), metadata.layout_mm
        sensors = in_rows(sensor_mm, len(metadata.axes))
        prior = Prior.of(surface.influence, sensors, Errors(metadata.noise.sample_mm))
        return cls(
            surface.structure,
            surface.contact_width_mm,
            sensor_mm,
            prior,
            metadata.max_deflection_mm,
            metadata.floor.drift_mm_per_min,
            metadata.unit,
            surface.influence.interpolation,
        )

    @cached_property
    def kinds(self) -> dict[str, slice]:
        """Kinds of departures with their places in the vector of all, which has units of their plausible sizes."""
        places = self._places.copy()
        if isinstance(self.structure, Plate):
            return places if self.sprung.any() else {kind: places[kind] for kind in places if kind != "springs"}
        if not any(self.hinged):
            del places["fixity"]
        if not isinstance(self.structure, Beam):  # what its sensors show was measured where they stand
            del places["position"]
        return places

    @cached_property
    def sprung(self) -> Bools:
        """(supports,), which supports of a plate have a spring; none of another structure."""
        supports = self.structure.support_list if isinstance(self.structure, Plate) else ()
        return np.array([support.stiffness_n_per_mm is not None for support in supports], dtype=np.bool_)

    @property
    def fields(self) -> dict[str, str]:
        """Kinds of departures of such a structure, in the order of the vector, with their fields."""
        return FIELDS_OF_PLATES if isinstance(self.structure, Plate) else FIELDS

    @cached_property
    def hinged(self) -> tuple[bool, bool]:
        """True if the first and the last support can have a fixity."""
        supports = self.structure.support_list if isinstance(self.structure, Beam) else ()
        if not supports:
            return False, False
        return supports[0].kind == "simple", len(supports) > 1 and supports[-1].kind == "simple"

    @property
    def size(self) -> int:
        """Length of the vector of all departures."""
        return max(int(part.stop) for part in self._places.values())

    def departures(self, vector: Floats) -> Departures:
        """Return the departures that a vector encodes."""
        fields: dict[str, Any] = {}
        for kind, part in self._places.items():
            values = self._units[kind] * vector[part]
            values = np.exp(values) if kind in FACTORS else values
            if kind == "fixity":
                values = np.where(self.hinged, np.clip(values, 0.0, MAX_FIXITY), 0.0)
            if kind == "springs":
                every = np.ones(len(self.sprung))
                every[self.sprung] = values
                values = every
            is_list = kind in (*PER_CHANNEL, "fixity", "springs")
            fields[self.fields[kind]] = values.tolist() if is_list else float(values[0])
        return Departures(**fields)

    def vector_of(self, departures: Departures) -> Floats:
        """Return the vector that encodes departures."""
        values = {kind: self._values(departures, kind) for kind in self._places}
        return np.concatenate(
            [(np.log(entries) if kind in FACTORS else entries) / self._units[kind] for kind, entries in values.items()]
        )

    def standard_errors(self, vector: Floats, spread: Floats) -> dict[str, Floats]:
        """Return standard errors by kind, in the units of the departures, from those of the vector."""
        near, departures = self.departures(vector + STEP), self.departures(vector)
        return {
            kind: np.abs(self._values(near, kind) - self._values(departures, kind)) / STEP * spread[part]
            for kind, part in self.kinds.items()
        }

    def _values(self, departures: Departures, kind: str) -> Floats:
        """Return the values of a kind of departures, one or more."""
        stated = getattr(departures, self.fields[kind])
        if stated is None:  # the model of a plate was never calibrated
            stated = [1.0] * len(self.sprung) if kind == "springs" else [0.0] * len(self.sensor_mm)
        values = np.atleast_1d(np.asarray(stated, dtype=np.float64))
        return values[self.sprung] if kind == "springs" else values

    @cached_property
    def _places(self) -> dict[str, slice]:
        """Places of every kind in the vector, whether the beam can have it or not."""
        own = dict.fromkeys(PER_CHANNEL, len(self.sensor_mm)) | {"fixity": 2, "springs": int(self.sprung.sum())}
        sizes = [own.get(kind, 1) for kind in self.fields]
        ends = np.cumsum(sizes).tolist()
        return {kind: slice(end - size, end) for kind, size, end in zip(self.fields, sizes, ends, strict=True)}

    @cached_property
    def _units(self) -> dict[str, float]:
        """The plausible size of each kind: one in the vector."""
        return {
            "rigidity": RIGIDITY,
            "gain": GAIN,
            **dict.fromkeys(("position", "x", "y"), self.mounting_mm),
            "curve": BEND / self.max_deflection_mm,
            "fixity": FIXITY,
            "springs": SPRING,
            "offset": OFFSET_NOISES * self.prior.errors.noise_mm,
        }

    def prior_with(self, departures: Departures) -> Prior:
        """Return the prior of the surface with departures."""
        return depart(self.prior, self.structure, self.width_mm, self.sensor_mm, departures)

    def curve(self, vector: Floats) -> InfluenceCurve:
        """Return the influence of the surface with the departures that a vector encodes, over the range of contacts."""
        departures = self.departures(vector)
        # Gains, offsets and the curve do not change the beam, so its influence can often be used again; nor does the
        # rigidity, if it divides all of it.
        rigidity = 1.0 if yields_alike(self.structure) else departures.rigidity
        beam = departures.model_copy(update={"gain": [1.0] * len(departures.gain), "rigidity": rigidity})
        of_plate = (*(beam.across_offset_mm or ()), *(beam.spring_stiffness or ()))
        parts = (beam.rigidity, *beam.fixity, *beam.position_offset_mm, *of_plate)
        ticks = self.prior.extent.ticks(GRID[self.prior.extent.axes])
        if parts not in self._influences:
            if len(self._influences) >= MAX_INFLUENCES:
                self._influences.clear()
            self._influences[parts] = self.prior_with(beam).influence_at(grid_of(ticks))
        influence = np.array(departures.gain) * self._influences[parts] * (rigidity / departures.rigidity)
        return InfluenceCurve(tuple(ticks), influence, departures)

    def slopes(self, vector: Floats, place_mm: Floats, force_n: Floats, kinds: Sequence[str]) -> Floats:
        """Return the change of measured deflections with each entry of the vector, (loads, channels, departures).

        It is 0 for the entries of other kinds than `kinds`.
        """
        expected_mm = self.curve(vector).measured_mm(place_mm, force_n)
        slopes = np.zeros((*expected_mm.shape, self.size))
        for kind in kinds:
            part = np.arange(self.size)[self.kinds[kind]]
            # One step of all channels together shows the slope of each, which spares solving the beam for each.
            for moved in [part] if kind in PER_CHANNEL else part[:, None]:
                step = np.zeros(self.size)
                step[moved] = np.where(vector[moved] > 1, -STEP, STEP)  # away from the bound of a fixity
                moved_mm = self.curve(vector + step).measured_mm(place_mm, force_n) - expected_mm
                slopes[:, np.arange(self.prior.channels), moved] = moved_mm / step[moved]
        return slopes

    def left_open_mm(self, place_mm: Floats, force_n: Floats) -> Floats:
        """Return the standard deviation of the deflections (loads, channels) that a measured table leaves open."""
        if self.table is None:
            return np.zeros((len(force_n), self.prior.channels))
        places = on_axis(self.sensor_mm), place_mm
        per_newton = self.table.deviation_at(*places)
        if self.table.repeats is not None:
            per_newton = np.hypot(per_newton, self.table.repeats(*places))
        deviation: Floats = force_n[:, None] * per_newton
        return deviation

    @property
    def degrees(self) -> int:
        """Degrees of freedom of the residual of a contact: channels beyond its place and, if open, its force."""
        return self.prior.channels - self.prior.extent.axes - int(self.prior.force_range.is_open)

    @property
    def contact_errors(self) -> LoadErrors:
        """Errors of a contact of which nothing is known but what the scene states: as wide as the ranges."""
        widest_mm = float(self.prior.extent.size_mm.max())
        return LoadErrors(placing_mm=widest_mm, force=min(ANY_FORCE, self.prior.force_range.relative_error))

    def covariance_of(self, kinds: Sequence[str], fitted: Floats) -> Floats:
        """Return the covariance of the whole vector from that of the fitted departures; 0 for the others."""
        free, covariance = self.free_of(kinds), np.zeros((self.size, self.size))
        covariance[np.ix_(free, free)] = fitted
        return covariance

    def free_of(self, kinds: Sequence[str]) -> Indices:
        """Return the places of some kinds in the vector of all departures."""
        places = np.arange(self.size)
        return np.concatenate([places[:0], *(places[self.kinds[kind]] for kind in kinds)])

    def bounds_of(self, free: Indices) -> tuple[Floats, Floats]:
        """Return the smallest and the largest values of fitted departures, in the units of the vector."""
        low, high = np.full(self.size, -MAX_DEPARTURE), np.full(self.size, MAX_DEPARTURE)
        if "fixity" in self.kinds:
            low[self.kinds["fixity"]], high[self.kinds["fixity"]] = 0.0, MAX_FIXITY / FIXITY
        return low[free], high[free]


def best_step(
    weighed: Floats, left: Floats, off: Floats, about: Floats | float, bounds: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Return the best step (departures,) of a fit from where it is, and the covariance of the departures.

    Parameters
    ----------
    weighed, left : whitened slopes (loads, channels, departures), and whitened residuals (loads, channels)
    off, about : how far the departures are from their prior means, and the standard deviations of their priors
    bounds : smallest and largest step; it is at most MAX_STEP
    """
    precision = np.einsum("lcv,lcw->vw", weighed, weighed) + np.diag(np.ones(len(off)) / about**2)
    pull, root = np.einsum("lcv,lc->v", weighed, left) - off / about**2, np.linalg.cholesky(precision)
    low, high = np.clip(bounds[0], -MAX_STEP, -1e-9), np.clip(bounds[1], 1e-9, MAX_STEP)
    step: Floats = lsq_linear(root.T, np.linalg.solve(root, pull), (low, high), method="bvls").x
    return step, np.linalg.inv(precision)


@dataclass(frozen=True)
class Fitted:
    """Departures of some kinds that were fitted to a surface."""

    nominal: NominalSurface
    kinds: tuple[str, ...]
    vector: Floats
    covariance: Floats
    """(departures, departures) of the vector, in its units; 0 if not fitted."""

    @property
    def departures(self) -> Departures:
        """The fitted departures."""
        return self.nominal.departures(self.vector)

    @property
    def spread(self) -> Floats:
        """(departures,) standard errors, in the units of the vector; 0 if not fitted."""
        return np.sqrt(np.diag(self.covariance))
