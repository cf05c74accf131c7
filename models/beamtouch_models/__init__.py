"""The interface for scripts: from a scene to influence lines, layouts, limits and models, and the virtual rig.

The names in `__all__` stay as they are between minor versions. All other names of the package may change at any time.
Each is imported when it is first used, because the service needs only `modelfile`, and the daemon only the filters.
"""

import os
from importlib import import_module

TYPE_CHECKING = False  # as in `typing`, whose import takes a fifth of the time of `--help`
if TYPE_CHECKING:
    from beamtouch_models.accuracy.evaluation import Errors, Evaluation
    from beamtouch_models.accuracy.statistics import Measurement
    from beamtouch_models.building.accuracy import Limit, accuracy_limit, error_along_mm, evaluate
    from beamtouch_models.building.products import build
    from beamtouch_models.building.sensors import place
    from beamtouch_models.loading import ModelFile, estimate, load_model
    from beamtouch_models.physics.beam import influence_matrix, interpolate_influence
    from beamtouch_models.physics.influence import InfluenceFunction
    from beamtouch_models.physics.motion import frequency_hz
    from beamtouch_models.pricing.ringing import ringing_mm
    from beamtouch_models.scene import Scene, change_scene, format_scene, make_scene, read_scene

__all__ = [
    "Errors", "Evaluation", "InfluenceFunction", "Limit", "Measurement", "ModelFile", "Scene", "accuracy_limit",
    "build", "change_scene", "error_along_mm", "estimate", "evaluate", "format_scene", "frequency_hz",
    "influence_matrix", "interpolate_influence", "load_model", "make_scene", "place", "read_scene", "ringing_mm",
]  # fmt: skip

_HOMES = {
    "accuracy.evaluation": ("Errors", "Evaluation"),
    "accuracy.statistics": ("Measurement",),
    "building.accuracy": ("Limit", "accuracy_limit", "error_along_mm", "evaluate"),
    "building.products": ("build",),
    "building.sensors": ("place",),
    "loading": ("ModelFile", "estimate", "load_model"),
    "physics.beam": ("influence_matrix", "interpolate_influence"),
    "physics.motion": ("frequency_hz",),
    "physics.influence": ("InfluenceFunction",),
    "pricing.ringing": ("ringing_mm",),
    "scene": ("Scene", "change_scene", "format_scene", "make_scene", "read_scene"),
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
