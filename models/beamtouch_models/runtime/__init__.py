"""Model files and what they answer: their metadata, and the decision on their answers. The service's door.

The service imports this module and no other of `beamtouch_models`. It needs onnxruntime, numpy and pydantic only.
"""

from beamtouch_models.errors import ModelFileError
from beamtouch_models.runtime.curve import InfluenceCurve
from beamtouch_models.runtime.decision.decider import Hypotheses, Judgement, Memory, State, memories_after
from beamtouch_models.runtime.decision.evidence import (
    LOG_ODDS,
    MISFIT,
    Evidence,
    Weighed,
    evidence,
    is_odd,
    is_overload,
    is_unchecked,
)
from beamtouch_models.runtime.decision.wrong_channels import Suspects, Wirings
from beamtouch_models.runtime.departures import Calibration
from beamtouch_models.runtime.health.health import BestSample, ChannelChange, Health
from beamtouch_models.runtime.loading import ModelFile, load, load_bytes, read
from beamtouch_models.runtime.metadata import CORRELATION_OUTPUT as CORRELATION
from beamtouch_models.runtime.metadata import Metadata
from beamtouch_models.runtime.metadata_parts import Accuracy, BeamDrawing, Channel, Noise, Ranges, Thresholds
from beamtouch_models.runtime.session import Answers

__all__ = [
    "CORRELATION", "LOG_ODDS", "MISFIT", "Accuracy", "Answers", "BeamDrawing", "BestSample", "Calibration",
    "Channel", "ChannelChange", "Evidence", "Health", "Hypotheses", "InfluenceCurve", "Judgement", "Memory", "Metadata",
    "ModelFile", "ModelFileError", "Noise", "Ranges", "State", "Suspects", "Thresholds", "Weighed", "Wirings",
    "evidence", "is_odd", "is_overload", "is_unchecked", "load", "load_bytes", "memories_after", "read",
]  # fmt: skip
