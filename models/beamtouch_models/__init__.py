"""The interface for scripts: from a scene to influence lines, layouts, limits and models.

The names in `__all__` stay as they are between minor versions. All other names of the package may change at any time.
Each is imported when it is first used, because the service needs only `runtime`, and the daemon only the filters.
"""

import os
from importlib import import_module

TYPE_CHECKING = False  # as in `typing`, whose import takes a fifth of the time of `--help`
if TYPE_CHECKING:
    from beamtouch_models.design.accuracy.evaluation import Errors, Evaluation
    from beamtouch_models.design.accuracy.statistics import Measurement
    from beamtouch_models.design.building.accuracy import Limit, accuracy_limit, error_along_mm, evaluate
    from beamtouch_models.design.building.products import build
    from beamtouch_models.design.building.sensors import place
    from beamtouch_models.design.physics.beam import influence_matrix, interpolate_influence
    from beamtouch_models.design.physics.influence import InfluenceFunction
    from beamtouch_models.design.physics.motion import frequency_hz
    from beamtouch_models.design.pricing.ringing import ringing_mm
    from beamtouch_models.design.scene import Scene, change_scene, format_scene, make_scene, read_scene
    from beamtouch_models.runtime.loading import ModelFile, estimate, load_model

__all__ = [
    "Errors", "Evaluation", "InfluenceFunction", "Limit", "Measurement", "ModelFile", "Scene", "accuracy_limit",
    "build", "change_scene", "error_along_mm", "estimate", "evaluate", "format_scene", "frequency_hz",
    "influence_matrix", "interpolate_influence", "load_model", "make_scene", "place", "read_scene", "ringing_mm",
]  # fmt: skip

_HOMES = {
    "design.accuracy.evaluation": ("Errors", "Evaluation"),
    "design.accuracy.statistics": ("Measurement",),
    "design.building.accuracy": ("Limit", "accuracy_limit", "error_along_mm", "evaluate"),
    "design.building.products": ("build",),
    "design.building.sensors": ("place",),
    "runtime.loading": ("ModelFile", "estimate", "load_model"),
    "design.physics.beam": ("influence_matrix", "interpolate_influence"),
    "design.physics.motion": ("frequency_hz",),
    "design.physics.influence": ("InfluenceFunction",),
    "design.pricing.ringing": ("ringing_mm",),
    "design.scene": ("Scene", "change_scene", "format_scene", "make_scene", "read_scene"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

# Unless told otherwise before it is imported, onnxruntime writes an identifier into the home folder and reports its use
# to its maker over the network. Whoever wants that sets the variable to 0.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")


def __getattr__(name: str) -> object:
    """Return a public name from the module that it lives in."""
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
