"""The metadata of a model file: everything that is needed to run its graph.

`metadata` has the whole, `fields` the types of its fields, and every other module some of its parts.
"""

from beamtouch_models.metadata.calibration import Calibration, Departures
from beamtouch_models.metadata.fields import FORCE_OUTPUTS, INPUTS, POSITION_OUTPUTS
from beamtouch_models.metadata.figures import (
    Accuracy,
    Golden,
    LayoutErrors,
    SinceTouch,
    SmallestForce,
    Thresholds,
)
from beamtouch_models.metadata.metadata import METADATA_PREFIX, SCHEMA_VERSION, THIS_FILE, Metadata
from beamtouch_models.metadata.surface import (
    Channel,
    Drawn,
    DrawnSupport,
    FilterChoice,
    Floor,
    Influence,
    Noise,
    Ranges,
    Sensor,
)

__all__ = [
    "FORCE_OUTPUTS",
    "INPUTS",
    "METADATA_PREFIX",
    "POSITION_OUTPUTS",
    "SCHEMA_VERSION",
    "THIS_FILE",
    "Accuracy",
    "Calibration",
    "Channel",
    "Departures",
    "Drawn",
    "DrawnSupport",
    "FilterChoice",
    "Floor",
    "Golden",
    "Influence",
    "LayoutErrors",
    "Metadata",
    "Noise",
    "Ranges",
    "Sensor",
    "SinceTouch",
    "SmallestForce",
    "Thresholds",
]  # fmt: skip
