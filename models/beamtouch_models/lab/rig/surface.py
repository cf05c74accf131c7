"""The virtual surface: a world that is touched now, from the load on it to the counts that a device would send. No I/O.

Its imperfections are the departures of the surface from its scene, which calibration finds, and its damping. One key is
stated otherwise than in `Departures`: the offset is one of the gap.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from beamtouch_common.files import load_toml
from beamtouch_common.units import MM, direction_of
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.influence_function import travel_of
from beamtouch_models.design.physics.structure import characteristics_of, influence_of
from beamtouch_models.design.pricing.noise import ReadingErrors
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.tables import Finite, Fixity, PositiveFinite, Strict
from beamtouch_models.design.world import Motion, SensorErrors, World, counts_of_output
from beamtouch_models.errors import SceneError
from beamtouch_models.lab.rig.faults import Faults
from beamtouch_models.lab.rig.loads import Load
from beamtouch_models.places import Extent
from beamtouch_models.runtime.metadata import Departures, Metadata

PER_CHANNEL = ("position_offset_mm", "gain", "offset_mm")
"""Departures with an entry per channel."""
TRUTH = 1
"""Beside the seed of the readings: that of what a table leaves open."""


class Imperfections(Strict):
    """The keys of the imperfections file; by default the surface is as the scene and the model state."""

    position_offset_mm: Annotated[tuple[Finite, ...], Field(strict=False)] = ()
    """True position of each sensor minus its position in the layout."""
    gain: Annotated[tuple[PositiveFinite, ...], Field(strict=False)] = ()
    """Measured over true deflection, per channel."""
    offset_mm: Annotated[tuple[Finite, ...], Field(strict=False)] = ()
    """Added to each gap, or value of a sensor that shows no gap; a tare removes it."""
    drift_um_per_min: Annotated[tuple[Finite, ...], Field(strict=False)] = ()
    """Drift of each zero, from the start on, in the direction of the load."""
    curve_per_mm: Finite = 0.0
    """Curvature of the characteristic: a deflection w is measured as y, where y + curve y^2 = gain w."""
    fixity: Annotated[tuple[Fixity, Fixity], Field(strict=False)] = (0.0, 0.0)
    """Fixity of the leftmost and the rightmost support."""
    rigidity: PositiveFinite = 1.0
    """Factor on E I."""
    damping_ratio: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Damping ratio of all modes. Default: the scene's `beam.damping_ratio`."""

    def departures(self, channels: int, towards: float = direction_of(MM)) -> Departures:
        """Return the departures of a surface; its sensors' values change by `towards` times their deflections.

        Raises
        ------
        SceneError
            A list is neither empty nor has one entry per channel.
        """
        given = {name: list(getattr(self, name)) for name in (*PER_CHANNEL, "drift_um_per_min")}
        for name, values in given.items():
            if len(values) not in (0, channels):
                raise SceneError(f"{name} has {len(values)} entries for {channels} channels")
        per_channel = {name: values for name, values in given.items() if values and name in PER_CHANNEL}
        if self.offset_mm:  # a larger gap is a smaller deflection
            per_channel["offset_mm"] = [towards * value for value in self.offset_mm]
        shared = {"fixity": self.fixity, "rigidity": self.rigidity, "curve_per_mm": self.curve_per_mm}
        return Departures.none(channels).model_copy(update=per_channel | shared)


PERFECT = Imperfections()


def load_imperfections(path: Path) -> Imperfections:
    """Read an imperfections file; raises InputError with the reason if it is wrong."""
    return load_toml(Imperfections, path)


class VirtualSurface:
    """A beam with its sensors, their characteristic and noise, and an ADC; SceneError if they do not fit together.

    The beam rings after a sudden change of its load if it `rings` and the scene states its mass.
    """

    def __init__(
        self,
        scene: Scene,
        model: Metadata,
        seed: int,
        imperfections: Imperfections = PERFECT,
        *,
        faults: Faults | None = None,
        rings: bool = True,
    ) -> None:
        self.sensor, self.channels = model.sensor, len(model.layout)
        departures, length_mm = imperfections.departures(self.channels, direction_of(scene.unit)), scene.length_mm
        if not all(0 <= mm <= length_mm for mm in model.layout_mm + np.array(departures.position_offset_mm)):
            raise SceneError("position_offset_mm moves a sensor off the beam")
        if scene.measured is not None and any(departures.position_offset_mm):
            raise SceneError("position_offset_mm is for a beam; the sensors of a measured structure stay; leave it out")
        if imperfections.damping_ratio is not None:
            if not scene.has_beam:
                raise SceneError(
                    "damping_ratio is for a beam; a table does not tell how a measured structure rings; leave it out"
                )
            damped = scene.beam.model_copy(update={"damping_ratio": imperfections.damping_ratio})
            scene = scene.model_copy(update={"stated_beam": damped})
        noise_mm = ReadingErrors.of(scene, travel_of(influence_of(scene)).largest_mm).sensor_mm
        self._world = World.of(scene, self.sensor, model.layout_mm, noise_mm, departures, Extent(((0.0, length_mm),)))
        # What the table of a measured structure leaves open is as unknown to the model as it is in reality.
        self._world = self._world.draw(np.random.default_rng([seed, TRUTH]))
        if imperfections.damping_ratio is not None and self._world.modes is None:
            message = (
                "damping_ratio needs beam.density_kg_m3 or beam.material, beam.width_mm and beam.thickness_mm in the "
                "scene"
            )
            raise SceneError(message)
        self._characteristics = characteristics_of(scene, model.layout_mm)
        self._motion, self._exact = Motion(self._world, rings=rings), SensorErrors.none(1, self.channels)
        self._drift_mm_per_s = np.array(imperfections.drift_um_per_min or 0.0) / 60e3
        self._rng = np.random.default_rng(seed)
        self._faults = faults or Faults([channel.name for channel in model.layout])

    def counts(self, load: Load, seconds: float) -> list[int]:
        """Convert all channels once under a load and return their counts (channels,).

        `seconds` must not lie before the previous conversion.
        """
        counts: list[int] = counts_of_output(self.sensor, self._outputs(load, seconds)).tolist()
        return counts

    def outputs(self, load: Load, seconds: float) -> list[float]:
        """Return the sensor outputs (channels,) under a load, 0 to 1 of the ADC's scale; arguments as `counts`."""
        outputs: list[float] = self._outputs(load, seconds).tolist()
        return outputs

    def _outputs(self, load: Load, seconds: float) -> Floats:
        place_mm = 0.0 if load.position_mm is None else load.position_mm  # without a load, its force is 0
        deflection = self._motion.at(seconds, place_mm, load.force_n) + self._drift_mm_per_s * seconds
        for channel, curved in enumerate(self._characteristics):
            deflection[channel] = curved.show(deflection[channel])
        outputs = self._world.outputs(deflection[None, None], self._exact, self._rng)[0, 0]
        return self._faults.change(outputs, seconds)
