"""The paper's beam, loads, layouts and noise."""

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_models.arrays import Floats
from beamtouch_models.physics.beam import influence
from beamtouch_models.placement import layout
from beamtouch_models.scene import Scene
from beamtouch_models.scene.beam import Beam

TITLE = (
    "An approach to optimise the critical sensor locations in one-dimensional novel distributive tactile surface to "
    "maximise performance"
)
"""Title of the paper."""
SOURCE = "P. Tongpadungrod, T. D. L. Rhys, P. N. Brett, Sensors and Actuators A: Physical 105 (2003) 47-54"
LENGTH_MM = 400.0
FORCE_N = 10.0
"""Assumed, because the paper does not state its weight; it cancels from all results in percent."""
NOISE_PERCENT = 2.0
"""The lower noise of the paper's figure 4, in percent of the largest deflection."""
LOADS_MM = np.arange(1.0, 400.0)
"""399 load positions, one per mm along the beam, as in section 3."""
SCENE = Scene.model_validate(
    {
        # The paper states neither section nor modulus; 25 x 3 mm of steel stays within the sensors' 3 mm of travel.
        "beam": {"length_mm": LENGTH_MM, "youngs_modulus_gpa": 210.0, "width_mm": 25.0, "thickness_mm": 3.0},
        "contact": {"force_n": FORCE_N, "position_mm": (1.0, 399.0)},
        "sensors": {"count": 2, "noise_percent_of_max": NOISE_PERCENT, "range_mm": (1.0, 4.0), "size_mm": 0.0},
    }
)
_UNIT_BEAM = Beam(length_mm=1.0, flexural_rigidity_n_mm2=1.0)
MAX_DEFLECTION = 1 / 48
"""Deflection at a load in the middle, in units of W l^3/(EI)."""


def equal_pitch_mm(count: int) -> Floats:
    """Return the positions of sensors that divide the beam into equal parts; (count,) in mm."""
    return layout.equal_pitch_mm(LENGTH_MM, count)


def dimensionless(sensor_mm: ArrayLike) -> Floats:
    """Return the influence matrix of a layout, (399, sensors), with lengths in units of l and W/(EI) = 1."""
    return influence(_UNIT_BEAM, np.asarray(sensor_mm) / LENGTH_MM, LOADS_MM / LENGTH_MM)


def deflection_mm(sensor_mm: ArrayLike, load_mm: ArrayLike = LOADS_MM) -> Floats:
    """Return the deflection at each sensor under the paper's weight, (loads, sensors) in mm."""
    return FORCE_N * influence(SCENE.beam, sensor_mm, load_mm)
