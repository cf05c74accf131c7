"""The metadata of a model file: everything that is needed to run its graph.

`metadata` has the whole, `fields` the types of its fields, and every other module some of its parts.
"""

from beamtouch_models.metadata.accuracy import Accuracy, Golden, SinceTouch
from beamtouch_models.metadata.calibration import Calibration, Departures
from beamtouch_models.metadata.drawn import Drawn, DrawnSupport
from beamtouch_models.metadata.metadata import METADATA_PREFIX, SCHEMA_VERSION, THIS_FILE, Metadata
from beamtouch_models.metadata.placed import LayoutErrors
from beamtouch_models.metadata.signature import FORCE_OUTPUTS, INPUTS, POSITION_OUTPUTS
from beamtouch_models.metadata.surface import Channel, FilterChoice, Floor, Influence, Noise, Ranges, Sensor
from beamtouch_models.metadata.thresholds import (
    MAX_FALSE,
    SECONDS_PER_DAY,
    SmallestForce,
    Thresholds,
    max_false_per_day,
)

__all__ = [
    "FORCE_OUTPUTS",
    "INPUTS",
    "MAX_FALSE",
    "METADATA_PREFIX",
    "POSITION_OUTPUTS",
    "SCHEMA_VERSION",
    "SECONDS_PER_DAY",
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
    "max_false_per_day",
]  # fmt: skip
