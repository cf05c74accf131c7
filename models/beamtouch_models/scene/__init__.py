"""The scene of a surface: what the user states before it is built.

`scene` has the whole and reads it. `beam` (of `beam_parts` and `materials`), `contact`, `sensors` and `environment`
have its tables; `fields`, their types. `identity` names a beam with its layout. `misplaced` and `other_units` find
obvious mistakes: places off the beam, numbers in other units.
"""

from beamtouch_models.scene.identity import identity_of
from beamtouch_models.scene.scene import Requirements, Scene, load_scene, parse_scene

__all__ = ["Requirements", "Scene", "identity_of", "load_scene", "parse_scene"]
