"""The scene of a surface: what the user states before it is built.

`scene` has the whole and reads it. `beam` (with `materials`), `contact` (with the environment) and `sensors` have its
tables; `fields`, their types. `identity` names a beam with its layout. `plausible` finds obvious mistakes.
"""

from beamtouch_models.scene.identity import identity_of
from beamtouch_models.scene.scene import (
    Requirements,
    Scene,
    change_scene,
    format_scene,
    load_scene,
    make_scene,
    parse_scene,
    read_scene,
)

__all__ = [
    "Requirements",
    "Scene",
    "change_scene",
    "format_scene",
    "identity_of",
    "load_scene",
    "make_scene",
    "parse_scene",
    "read_scene",
]  # fmt: skip
