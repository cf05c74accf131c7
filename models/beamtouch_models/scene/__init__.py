"""The scene of a surface: what the user states before it is built.

`scene` has the whole and reads it; `beam`, `contact`, `sensors` and `environment` have its tables, and `places` and
`plausible` find what cannot be meant.
"""

from beamtouch_models.scene.scene import Requirements, Scene, load_scene, parse_scene

__all__ = ["Requirements", "Scene", "load_scene", "parse_scene"]
