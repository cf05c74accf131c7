"""A nominal surface that needs no model: the paper's beam on four sensors, and loads on one that departs from it."""

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.calibration.nominal_surface import NominalSurface
from beamtouch_models.design.calibration.recordings import Loads
from beamtouch_models.design.physics.structure import influence_of, structure_of
from beamtouch_models.design.scene import change_scene
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.error_model import Errors
from support.surfaces.example_scenes import paper_scene

SENSORS_MM = np.array([70.0, 190.0, 260.0, 345.0])
NOISE_MM, LARGEST_MM = 0.002, 2.2


def nominal_of(
    force_n: tuple[float, float] = (2.0, 20.0), drift_mm_per_min: float = 0.001, **beam: object
) -> NominalSurface:
    """Return the surface; contacts are at 1 to 399 mm."""
    scene = change_scene(paper_scene(), beam={"supports": "simply-supported"} | beam, contact={"force_n": force_n})
    prior = Prior.of(influence_of(scene), on_axis(SENSORS_MM), Errors(NOISE_MM))
    return NominalSurface(structure_of(scene), 0.0, SENSORS_MM, prior, LARGEST_MM, drift_mm_per_min, "mm", None)


def loads_on(nominal: NominalSurface, vector: Floats, seed: int = 0, count: int = 7) -> Loads:
    """Return loads on a surface with departures, recorded with noise; one deflection is missing."""
    rng = np.random.default_rng(seed)
    place_mm, force_n = on_axis(np.linspace(40, 370, count)), np.linspace(4.0, 17.0, count)
    measured_mm = nominal.curve(vector).measured_mm(place_mm, force_n)
    deviation_mm = NOISE_MM * rng.uniform(0.2, 0.5, measured_mm.shape)
    measured_mm += deviation_mm * rng.normal(size=measured_mm.shape)
    measured_mm[2, 1] = np.nan
    lines = np.column_stack([np.arange(count), np.arange(count)])
    return Loads(
        np.arange(1, count + 1), place_mm, force_n, measured_mm, deviation_mm, lines, np.linspace(0.0, 6.0, count)
    )
