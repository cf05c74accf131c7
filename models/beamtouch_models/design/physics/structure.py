"""The structure of a scene, a beam, a plate or a measured one: its influence, and how it changes with departures."""

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics import beam, plate, solid
from beamtouch_models.design.physics.characteristic_fit import Characteristic
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.physics.measured_structure import (
    MeasuredStructure,
    measured_influence_of,
    measured_structure_of,
)
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.beam import Beam, changed_beam
from beamtouch_models.design.scene.plate import Plate, stiffened_plate
from beamtouch_models.errors import SceneError
from beamtouch_models.places import Extent, in_rows
from beamtouch_models.runtime.departures import Departures

Structure = Beam | Plate | MeasuredStructure
PARTS = 33
"""Points that stand for a load spread over a part of a measured structure."""


def structure_of(scene: Scene) -> Structure:
    """Return the structure of a scene; SceneError if it states none."""
    return scene.solid if scene.measured is None else measured_structure_of(scene)


def influence_of(scene: Scene) -> InfluenceFunction:
    """Return the influence function of the structure of a scene; SceneError if it states none."""
    if scene.measured is not None:
        return measured_influence_of(scene)
    return beam.influence_of(scene) if scene.plate is None else plate.influence_of(scene, scene.plate)


def characteristics_of(scene: Scene, sensor_mm: Floats) -> tuple[Characteristic, ...]:
    """Return the characteristics of curved sensors at places (channels, axes), or positions; none of straight ones."""
    if scene.measured is None or not scene.measured.curved:
        return ()
    structure = measured_structure_of(scene)
    return tuple(structure.characteristics[index] for index in structure.nearest(sensor_mm))


def influence(structure: Structure, sensor_mm: ArrayLike, load_mm: ArrayLike, width_mm: float = 0.0) -> Floats:
    """Return the deflection (loads, sensors) in mm/N; arguments as `physics.solid.influence`.

    A measured structure was loaded over the width of its loads. What is spread further is the mean of such loads.
    """
    if isinstance(structure, Beam | Plate):
        return solid.influence(structure, np.asarray(sensor_mm), np.asarray(load_mm), width_mm)
    if not width_mm:
        return structure.influence(sensor_mm, load_mm)
    axes = structure.axes
    parts = Extent(((-width_mm / 2, width_mm / 2),) * axes).grid(PARTS)
    spread = np.clip(in_rows(load_mm, axes) + parts[:, None], 0.0, structure.size_mm)
    mean: Floats = np.mean([structure.influence(sensor_mm, loads) for loads in spread], axis=0)
    return mean


def size_of(structure: Structure) -> tuple[float, ...]:
    """Return the length of a structure along each axis, in mm."""
    return (structure.length_mm,) if isinstance(structure, Beam) else structure.size_mm


def yields_alike(structure: Structure) -> bool:
    """Return whether `changed` with a rigidity divides all influence by it: nothing beside a beam's bending has a part.

    A foundation and the shear of a beam stay what they are.
    """
    if not isinstance(structure, Beam):
        return True
    return structure.foundation_n_mm2 is None and structure.shear_modulus_gpa is None


def changed(structure: Structure, departures: Departures) -> Structure:
    """Return a structure with the rigidity, the fixity of its first and last support, and the springs of departures.

    With the rigidity, the springs of a plate are as much stiffer as the plate: all deflections change alike.

    Raises
    ------
    SceneError
        A support that gets a fixity is missing or already fixed, springs are not one a support, or the rigidity cannot
        be computed with.
    """
    rigidity, fixity = departures.rigidity, departures.fixity
    if departures.spring_stiffness is not None and not isinstance(structure, Plate):
        raise SceneError("spring_stiffness is for a plate; leave it out")
    if isinstance(structure, Beam):
        return changed_beam(structure, rigidity, fixity)
    if isinstance(structure, Plate):
        if any(fixity):
            raise SceneError("fixity: the supports of a plate are free to rotate; give 0 for both")
        return stiffened_plate(structure, rigidity, departures.spring_stiffness)
    if any(fixity):
        raise SceneError("fixity: the supports of a measured structure are not known; give 0 for both")
    return structure.scaled(1 / rigidity)
