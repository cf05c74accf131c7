"""What the paper works with: its beam, its loads, its layouts, its noise."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamtouch_models.beam import influence
from beamtouch_models.scene import Scene
from beamtouch_models.structure import Beam

Array = NDArray[np.float64]

LENGTH_MM = 400.0
FORCE_N = 10.0
"""The paper states no weight; it is known, and cancels from everything that is in percent."""
NOISE_PERCENT = 2.0
"""Of the largest deflection: the lower noise of the paper's figure 4."""
LOADS_MM = np.arange(1.0, 400.0)
"""A load every mm along the beam, as in section 3: 399 of them."""
SCENE = Scene.model_validate(
    {
        # The paper gives neither section nor modulus; 25 x 3 mm of steel keeps within the sensors' 3 mm of travel.
        "beam": {"length_mm": LENGTH_MM, "youngs_modulus_gpa": 210.0, "width_mm": 25.0, "thickness_mm": 3.0},
        "contact": {"force_n": FORCE_N, "position_mm": (1.0, 399.0)},
        "sensors": {"count": 2, "noise_percent_of_max": NOISE_PERCENT, "range_mm": (1.0, 4.0)},
    }
)
_UNIT_BEAM = Beam(length_mm=1.0, flexural_rigidity_n_mm2=1.0)
MAX_DEFLECTION = 1 / 48
"""Of a load in the middle, in units of W l^3/(EI)."""


def equal_pitch_mm(count: int) -> Array:
    """Sensors that divide the beam in equal parts; (count,) in mm."""
    return LENGTH_MM * np.arange(1, count + 1) / (count + 1)


def dimensionless(sensor_mm: ArrayLike) -> Array:
    """Influence matrix of a layout, (399, sensors), lengths in units of l and W/(EI) = 1."""
    return influence(_UNIT_BEAM, np.asarray(sensor_mm) / LENGTH_MM, LOADS_MM / LENGTH_MM)


def deflection_mm(sensor_mm: ArrayLike, load_mm: ArrayLike = LOADS_MM) -> Array:
    """Deflection at each sensor under the paper's weight, (loads, sensors) in mm."""
    return FORCE_N * influence(SCENE.beam, sensor_mm, load_mm)
