"""The virtual surface: a world that is touched now, from the load on it to the counts that a device would send. No I/O.

Its imperfections are the departures of the surface from its scene, which calibration finds, and its damping. One key is
stated otherwise than in `Departures`: the offset is one of the gap.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from beamtouch_common.files import load_toml
from beamtouch_common.outline import axes_of
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
from beamtouch_models.places import Extent, as_stated, in_rows
from beamtouch_models.runtime.departures import Departures
from beamtouch_models.runtime.metadata import Metadata

PER_CHANNEL = ("position_offset_mm", "x_offset_mm", "y_offset_mm", "gain", "offset_mm", "drift_um_per_min")
"""Keys with an entry per channel."""
OF_PLATES = ("x_offset_mm", "y_offset_mm", "spring_stiffness")
"""Keys of plates alone."""
TRUTH = 1
"""Beside the seed of the readings: that of what a table leaves open."""


class Imperfections(Strict):
    """The keys of the imperfections file; by default the surface is as the scene and the model state."""

    position_offset_mm: Annotated[tuple[Finite, ...], Field(strict=False)] = ()
    """True position of each sensor under a beam minus its position in the layout."""
    x_offset_mm: Annotated[tuple[Finite, ...], Field(strict=False)] = ()
    """The same under a plate, along x."""
    y_offset_mm: Annotated[tuple[Finite, ...], Field(strict=False)] = ()
    """The same under a plate, along y."""
    gain: Annotated[tuple[PositiveFinite, ...], Field(strict=False)] = ()
    """Measured over true deflection, per channel."""
    offset_mm: Annotated[tuple[Finite, ...], Field(strict=False)] = ()
    """Added to each gap, or value of a sensor that shows no gap; a tare removes it."""
    drift_um_per_min: Annotated[tuple[Finite, ...], Field(strict=False)] = ()
    """Drift of each zero, from the start on, in the direction of the load."""
    curve_per_mm: Finite = 0.0
    """Curvature of the characteristic: a deflection w is measured as y, where y + curve y^2 = gain w."""
    fixity: Annotated[tuple[Fixity, Fixity], Field(strict=False)] = (0.0, 0.0)
    """Fixity of the leftmost and the rightmost support of a beam."""
    rigidity: PositiveFinite = 1.0
    """Factor on E I; of a plate, on it and all its springs."""
    spring_stiffness: Annotated[tuple[PositiveFinite, ...], Field(strict=False)] = ()
    """Factor on the spring in each support of a plate, in the order of the scene; 1 for a rigid support."""
    damping_ratio: Annotated[float, Field(gt=0, lt=1)] | None = None
    """Damping ratio of all modes. Default: that of the scene, `damping_ratio` of the beam or the plate."""

    def departures(self, channels: int, towards: float = direction_of(MM), *, of_plate: bool = False) -> Departures:
        """Return the departures of a surface; its sensors' values change by `towards` times their deflections.

        Raises
        ------
        SceneError
            A list is neither empty nor has one entry per channel, or a key is not for this kind of structure.
        """
        for name in ("position_offset_mm",) if of_plate else OF_PLATES:
            if getattr(self, name):
                raise SceneError(f"{name} is for a {'beam' if of_plate else 'plate'}; leave it out")
        given = {name: list(getattr(self, name)) for name in PER_CHANNEL}
        for name, values in given.items():
            if len(values) not in (0, channels):
                raise SceneError(f"{name} has {len(values)} entries for {channels} channels")
        fields = {"fixity": self.fixity, "rigidity": self.rigidity, "curve_per_mm": self.curve_per_mm}
        fields |= {name: given[name] for name in ("position_offset_mm", "gain") if given[name]}
        if self.offset_mm:  # a larger gap is a smaller deflection
            fields["offset_mm"] = [towards * value for value in self.offset_mm]
        if of_plate:
            along, across = (given[name] or [0.0] * channels for name in ("x_offset_mm", "y_offset_mm"))
            fields |= {"position_offset_mm": along, "across_offset_mm": across}
        if self.spring_stiffness:
            fields["spring_stiffness"] = list(self.spring_stiffness)
        return Departures.none(channels).model_copy(update=fields)


PERFECT = Imperfections()


def load_imperfections(path: Path) -> Imperfections:
    """Read an imperfections file; raises InputError with the reason if it is wrong."""
    return load_toml(Imperfections, path)


class VirtualSurface:
    """A beam or a plate with its sensors, their characteristic and noise, and an ADC.

    It rings after a sudden change of its load if it `rings` and the scene states its mass. SceneError if its parts do
    not fit together.
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
        self.axes, of_plate = axes_of(len(scene.size_mm)), scene.plate is not None
        departures = imperfections.departures(self.channels, direction_of(scene.unit), of_plate=of_plate)
        if scene.measured is None:
            true_mm = in_rows(model.layout_mm + departures.offsets_mm, len(self.axes))
            if not np.all((true_mm >= 0) & (true_mm <= scene.size_mm)):
                key, what = ("x_offset_mm or y_offset_mm", "plate") if of_plate else ("position_offset_mm", "beam")
                raise SceneError(f"{key} moves a sensor off the {what}")
        elif any(departures.position_offset_mm):
            raise SceneError("position_offset_mm is for a beam; the sensors of a measured structure stay; leave it out")
        if imperfections.damping_ratio is not None:
            if not scene.is_computed:
                raise SceneError(
                    "damping_ratio is for a beam; a table does not tell how a measured structure rings; leave it out"
                )
            damped = scene.solid.model_copy(update={"damping_ratio": imperfections.damping_ratio})
            scene = scene.model_copy(update={"plate" if of_plate else "stated_beam": damped})
        noise_mm = ReadingErrors.of(scene, travel_of(influence_of(scene)).largest_mm).sensor_mm
        everywhere = Extent(tuple((0.0, length_mm) for length_mm in scene.size_mm))
        self._world = World.of(scene, self.sensor, model.layout_mm, noise_mm, departures, everywhere)
        # What the table of a measured structure leaves open is as unknown to the model as it is in reality.
        self._world = self._world.draw(np.random.default_rng([seed, TRUTH]))
        if imperfections.damping_ratio is not None and self._world.modes is None:
            needed = "beam.density_kg_m3 or beam.material, beam.width_mm and beam.thickness_mm"
            if of_plate:
                needed = "plate.density_kg_m3 or plate.material"
            raise SceneError(f"damping_ratio needs {needed} in the scene")
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
        # Without a load, its force is 0.
        place_mm = as_stated(np.zeros(len(self.axes))) if load.place_mm is None else np.array(load.place_mm)
        deflection = self._motion.at(seconds, place_mm, load.force_n) + self._drift_mm_per_s * seconds
        for channel, curved in enumerate(self._characteristics):
            deflection[channel] = curved.show(deflection[channel])
        outputs = self._world.outputs(deflection[None, None], self._exact, self._rng)[0, 0]
        return self._faults.change(outputs, seconds)
