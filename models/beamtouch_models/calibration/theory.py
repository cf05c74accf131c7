"""The surface as its scene and its model describe it, and how its deflections change with departures and loads."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats
from beamtouch_models.building.model_prior import departed, measured_by
from beamtouch_models.calibration.errors import Deflections
from beamtouch_models.calibration.loads import Loads
from beamtouch_models.metadata import Departures, Metadata
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.pricing.effects import Physics
from beamtouch_models.scene.beam import Beam

GAIN, POSITION_MM, FIXITY, RIGIDITY, BEND, OFFSET_NOISES = 0.04, 1.5, 0.1, 0.1, 0.03, 3.0
"""Standard deviations of plausible departures: relative gain, sensor position, fixity, relative rigidity, relative bend
of the characteristic at full travel, and offset in units of the noise of a sample."""
MAX_FIXITY = 0.9
MAX_INFLUENCES = 64
"""Number of influence matrices that are kept; it bounds their memory."""
PER_CHANNEL = ("gain", "position", "offset")
"""Kinds of departures of which each changes only the deflections of its own channel."""
STEP = 1e-4
"""Step of numerical derivatives: in units of the vector, over the length of the beam, and of the force."""


@dataclass(frozen=True)
class Theory:
    """The surface that a calibration departs from."""

    beam: Beam
    """The beam, which is solved again for another rigidity and fixity."""
    width_mm: float
    """Width of a contact."""
    sensor_mm: Floats
    prior: Prior
    max_deflection_mm: float
    influences: dict[tuple[float, ...], Floats] = field(default_factory=dict, repr=False, compare=False)
    """Influence matrices that were computed recently."""

    @classmethod
    def of(cls, physics: Physics, metadata: Metadata) -> "Theory":
        """Return the theory of a model."""
        scene = physics.scene
        sensor_mm = np.array([channel.position_mm for channel in metadata.layout])
        prior = Prior.of(influence_of(scene), sensor_mm, metadata.noise.sample_mm)
        return cls(scene.beam, scene.contact.width_mm, sensor_mm, prior, metadata.max_deflection_mm)

    @cached_property
    def kinds(self) -> dict[str, slice]:
        """Kinds of departures with their places in the vector of all, which has units of their plausible sizes."""
        channels = len(self.sensor_mm)
        sizes = {"rigidity": 1, "gain": channels, "position": channels, "curve": 1, "fixity": 2, "offset": channels}
        starts = np.cumsum([0, *sizes.values()]).tolist()
        kinds = {name: slice(start, start + size) for (name, size), start in zip(sizes.items(), starts, strict=False)}
        if not any(self.hinged):
            del kinds["fixity"]
        return kinds

    @cached_property
    def hinged(self) -> tuple[bool, bool]:
        """Whether the first and the last support can have a fixity."""
        supports = self.beam.support_list
        if not supports:
            return False, False
        return supports[0].kind == "simple", len(supports) > 1 and supports[-1].kind == "simple"

    @property
    def size(self) -> int:
        """Length of the vector of all departures."""
        return 4 + 3 * len(self.sensor_mm)

    def departures(self, vector: Floats) -> Departures:
        """Return the departures that a vector encodes."""
        channels = len(self.sensor_mm)
        rigidity, gain, position, curve, fixity, offset = np.split(
            vector, np.cumsum([1, channels, channels, 1, 2]).tolist()
        )
        left, right = (
            float(np.clip(FIXITY * value, 0.0, MAX_FIXITY)) if hinged else 0.0
            for value, hinged in zip(fixity, self.hinged, strict=True)
        )
        return Departures(
            position_offset_mm=(POSITION_MM * position).tolist(),
            gain=np.exp(GAIN * gain).tolist(),
            offset_mm=(OFFSET_NOISES * self.prior.noise_mm * offset).tolist(),
            curve_per_mm=float(BEND / self.max_deflection_mm * curve[0]),
            fixity=(left, right),
            rigidity=float(np.exp(RIGIDITY * rigidity[0])),
        )

    def vector_of(self, departures: Departures) -> Floats:
        """Return the vector that encodes departures."""
        return np.concatenate(
            [
                [np.log(departures.rigidity) / RIGIDITY],
                np.log(departures.gain) / GAIN,
                np.array(departures.position_offset_mm) / POSITION_MM,
                [departures.curve_per_mm * self.max_deflection_mm / BEND],
                np.array(departures.fixity) / FIXITY,
                np.array(departures.offset_mm) / (OFFSET_NOISES * self.prior.noise_mm),
            ]
        )

    def standard_errors(self, vector: Floats, spread: Floats) -> dict[str, Floats]:
        """Return standard errors by kind, in the units of the departures, from those of the vector."""
        near, at = self.departures(vector + STEP), self.departures(vector)
        units = {
            "rigidity": np.array([near.rigidity - at.rigidity]),
            "gain": np.array(near.gain) - at.gain,
            "position": np.array(near.position_offset_mm) - at.position_offset_mm,
            "curve": np.array([near.curve_per_mm - at.curve_per_mm]),
            "fixity": np.array(near.fixity) - at.fixity,
            "offset": np.array(near.offset_mm) - at.offset_mm,
        }
        return {kind: np.abs(units[kind]) / STEP * spread[part] for kind, part in self.kinds.items()}

    def prior_with(self, departures: Departures) -> Prior:
        """Return the prior of the surface with departures."""
        return departed(self.prior, self.beam, self.width_mm, self.sensor_mm, departures)

    def measured_mm(self, vector: Floats, loads: Loads) -> Floats:
        """Return the deflections that its sensors measure under loads, (loads, channels)."""
        departures = self.departures(vector)
        influence = self._influence(departures, loads.position_mm)
        return measured_by(departures, loads.force_n[:, None] * np.array(departures.gain) * influence)

    def slopes(self, vector: Floats, loads: Loads, kinds: Sequence[str]) -> Floats:
        """Return the change of `measured_mm` with each entry of the vector, (loads, channels, departures).

        It is 0 for the entries of other kinds than `kinds`.
        """
        at = self.measured_mm(vector, loads)
        slopes = np.zeros((*at.shape, self.size))
        for kind in kinds:
            part = np.arange(self.size)[self.kinds[kind]]
            # One step of all channels together shows the slope of each, which spares solving the beam for each.
            for moved in [part] if kind in PER_CHANNEL else part[:, None]:
                step = np.zeros(self.size)
                step[moved] = np.where(vector[moved] > 1, -STEP, STEP)  # away from the bound of a fixity
                slope = (self.measured_mm(vector + step, loads) - at) / step[moved]
                slopes[:, np.arange(at.shape[1]), moved] = slope
        return slopes

    def deflections(self, vector: Floats, loads: Loads) -> Deflections:
        """Return what moves the deflections of loads about `measured_mm`."""
        step_mm = STEP * self.prior.length_mm
        low, high = (
            replace(loads, position_mm=np.clip(loads.position_mm + way * step_mm, 0.0, self.prior.length_mm))
            for way in (-1, 1)
        )
        apart_mm = (high.position_mm - low.position_mm)[:, None]
        along = (self.measured_mm(vector, high) - self.measured_mm(vector, low)) / apart_mm
        heavier = self.measured_mm(vector, replace(loads, force_n=(1 + STEP) * loads.force_n))
        harder = (heavier - self.measured_mm(vector, loads)) / STEP
        is_measured = np.isfinite(loads.measured_mm)
        return Deflections(is_measured, loads.deviation_mm, np.stack([along, harder]) * is_measured)

    @cached_property
    def _scales(self) -> bool:
        """Whether deflections are exactly inverse to the rigidity: nothing but bending carries the load."""
        return self.beam.shear_modulus_gpa is None and self.beam.foundation_n_mm2 is None

    def _influence(self, departures: Departures, load_mm: Floats) -> Floats:
        """Return the influence matrix (loads, channels) of the departed beam, without gains."""
        # Gains, offsets and the curve do not change the beam, so its influence matrix can often be reused.
        factor = departures.rigidity if self._scales else 1.0
        solved = departures.model_copy(
            update={"gain": [1.0] * len(departures.gain), "rigidity": departures.rigidity / factor}
        )
        parts = (solved.rigidity, *solved.fixity, *solved.position_offset_mm, *load_mm.tolist())
        if parts not in self.influences:
            if len(self.influences) >= MAX_INFLUENCES:
                self.influences.clear()
            self.influences[parts] = self.prior_with(solved).influence_at(load_mm)
        return self.influences[parts] / factor
