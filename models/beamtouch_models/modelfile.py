"""The door of this package for the service: model files, their metadata, and the decision on their answers.

The service imports this module and no other of the package. It needs onnxruntime, numpy and pydantic only.
"""

from beamtouch_models.decision import (
    LOG_ODDS,
    MISFIT,
    Decider,
    Evidence,
    Hypotheses,
    Judgement,
    LeftOut,
    Memory,
    State,
    Suspects,
    Verdict,
    Weighed,
    evidence,
    is_odd,
    is_overload,
    is_unchecked,
    memories_after,
)
from beamtouch_models.decision.decider import PERSISTENCE
from beamtouch_models.errors import ModelFileError
from beamtouch_models.health import BestSample, ChannelChange, Health
from beamtouch_models.loading import ModelFile, load, load_bytes, read
from beamtouch_models.metadata import (
    FORCE_OUTPUTS,
    INPUTS,
    METADATA_PREFIX,
    POSITION_OUTPUTS,
    SCHEMA_VERSION,
    Accuracy,
    Calibration,
    Channel,
    Departures,
    Drawn,
    FilterChoice,
    Floor,
    Golden,
    Influence,
    Metadata,
    Noise,
    Ranges,
    Sensor,
    SmallestForce,
    Thresholds,
)
from beamtouch_models.session import Answers, session_options
from beamtouch_models.whitening import whitening

__all__ = [
    "FORCE_OUTPUTS", "INPUTS", "LOG_ODDS", "METADATA_PREFIX", "MISFIT", "PERSISTENCE", "POSITION_OUTPUTS",
    "SCHEMA_VERSION", "Accuracy", "Answers", "BestSample", "Calibration", "Channel", "ChannelChange", "Decider",
    "Departures", "Drawn", "Evidence", "FilterChoice", "Floor", "Golden", "Health", "Hypotheses", "Influence",
    "Judgement", "LeftOut", "Memory", "Metadata", "ModelFile", "ModelFileError", "Noise", "Ranges", "Sensor",
    "SmallestForce", "State", "Suspects", "Thresholds", "Verdict", "Weighed", "evidence", "is_odd", "is_overload",
    "is_unchecked", "load", "load_bytes", "memories_after", "read", "session_options", "whitening",
]  # fmt: skip
