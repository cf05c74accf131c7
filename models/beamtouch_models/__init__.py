"""The interface for scripts: scene -> surface -> layout -> model, each made of the one before.

`resolve(scene)` is a surface, `surface.place(4)` a layout, `layout.build()` a model.

>>> from beamtouch_models import make_scene, resolve
>>> scene = make_scene(
...     beam={"length_mm": 400, "material": "steel", "width_mm": 25, "thickness_mm": 3},
...     contact={"force_n": [2, 20], "position_mm": [10, 390]},
...     sensors={"noise_mm": 0.002, "rate_hz": 100},
...     requirements={"latency_ms": 50},
... )
>>> surface = resolve(scene)
>>> layout = surface.place(2, effort=0.01)
>>> print(layout.limit(draws=500))
2.83 +- 0.03
>>> model = layout.build("strip")
>>> model.estimate(layout.simulate([60, 200], 10, seed=1))
contact at 60.9 mm (55.1 to 66.4); 2 channels hardly tell it from other loads
contact at 198.1 mm (194.9 to 201.7); 2 channels hardly tell it from other loads
>>> model.save("strip.onnx")

Examples of the other names go on from here. Lengths are in mm from the left end of the beam, forces in N.

The names in `__all__` stay as they are between minor versions. All other names of the package may change at any time.
Each is imported when it is first used, because the service needs only `runtime`, and the daemon only the filters.
"""

import os
from importlib import import_module

TYPE_CHECKING = False  # as in `typing`, whose import takes a fifth of the time of `--help`
if TYPE_CHECKING:
    from beamtouch_models.design.accuracy.evaluation import Evaluation, PositionErrors
    from beamtouch_models.design.accuracy.statistics import Measurement
    from beamtouch_models.design.building.daemon_config import daemon_config
    from beamtouch_models.design.layout import ErrorAlong, Layout
    from beamtouch_models.design.model import Estimates, Model, load_model
    from beamtouch_models.design.physics.beam import influence_matrix
    from beamtouch_models.design.physics.influence_function import InfluenceFunction
    from beamtouch_models.design.physics.interpolation import interpolate_influence
    from beamtouch_models.design.physics.motion import frequency_hz
    from beamtouch_models.design.pricing.ringing import ringing_mm
    from beamtouch_models.design.scene import Scene, change_scene, format_scene, make_scene, read_scene
    from beamtouch_models.design.surface import Surface, resolve
    from beamtouch_models.errors import InputError, ModelFileError, NotGoodEnoughError, SceneError

__all__ = [
    "ErrorAlong", "Estimates", "Evaluation", "InfluenceFunction", "InputError", "Layout", "Measurement", "Model",
    "ModelFileError", "NotGoodEnoughError", "PositionErrors", "Scene", "SceneError", "Surface", "change_scene",
    "daemon_config", "format_scene", "frequency_hz", "influence_matrix", "interpolate_influence", "load_model",
    "make_scene", "read_scene", "resolve", "ringing_mm",
]  # fmt: skip

_HOMES = {
    "design.accuracy.evaluation": ("Evaluation", "PositionErrors"),
    "design.accuracy.statistics": ("Measurement",),
    "design.building.daemon_config": ("daemon_config",),
    "design.layout": ("ErrorAlong", "Layout"),
    "design.model": ("Estimates", "Model", "load_model"),
    "design.physics.beam": ("influence_matrix",),
    "design.physics.interpolation": ("interpolate_influence",),
    "design.physics.motion": ("frequency_hz",),
    "design.physics.influence_function": ("InfluenceFunction",),
    "design.pricing.ringing": ("ringing_mm",),
    "design.scene": ("Scene", "change_scene", "format_scene", "make_scene", "read_scene"),
    "design.surface": ("Surface", "resolve"),
    "errors": ("InputError", "ModelFileError", "NotGoodEnoughError", "SceneError"),
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


def __dir__() -> list[str]:
    """Return the public names, for completion in a notebook."""
    return __all__
