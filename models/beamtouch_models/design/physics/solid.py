"""What theory computes the influence of: a beam or a plate. The same questions to both."""

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics import beam, plate
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.design.scene.plate import Plate

Solid = Beam | Plate


def influence(solid: Solid, sensor_mm: Floats, load_mm: Floats, width_mm: float = 0.0) -> Floats:
    """Return the deflection (loads, sensors) in mm/N.

    Arguments as `physics.beam.influence`, with positions (n,), or as `physics.plate.influence`, with places (n, 2).
    """
    return (
        beam.influence(solid, sensor_mm, load_mm, width_mm)
        if isinstance(solid, Beam)
        else plate.influence(solid, sensor_mm, load_mm, width_mm)
    )


def loads_of(scene: Scene) -> Floats:
    """Return the load positions (n,) of the influence matrix of a scene's beam, or the places (n, 2) of its plate."""
    return beam.load_positions_mm(scene) if scene.plate is None else plate.load_places_mm(scene, scene.plate)
