"""The interface for scripts: from a scene to influence lines, layouts, limits and models.

Everything here stays as it is between minor versions. Other modules of the package may change at any time. It needs the
extra `design`.
"""

from beamtouch_models.api.beams import frequency_hz, influence_matrix, read_scene, ringing_mm
from beamtouch_models.api.layouts import Limit, accuracy_limit, error_along_mm, place
from beamtouch_models.api.models import build, estimate, load_model
from beamtouch_models.loading import ModelFile
from beamtouch_models.scene import Scene

__all__ = [
    "Limit", "ModelFile", "Scene", "accuracy_limit", "build", "error_along_mm", "estimate", "frequency_hz",
    "influence_matrix", "load_model", "place", "read_scene", "ringing_mm",
]  # fmt: skip
