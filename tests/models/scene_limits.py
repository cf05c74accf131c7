"""Scenes of a beam and of a plate, with other values of some keys, and how they are refused."""

from typing import Any

import pytest

from beamtouch_models import make_scene
from beamtouch_models.design.scene import Scene
from beamtouch_models.errors import InputError

Tables = dict[str, dict[str, Any]]
MOVE = "move that sensor, or correct size_mm"

BEAM: Tables = {
    "beam": {"length_mm": 400, "youngs_modulus_gpa": 210, "width_mm": 25, "thickness_mm": 3, "supports": "cantilever"},
    "contact": {"force_n": [2, 20], "position_mm": [20, 370]},
    "sensors": {"noise_mm": 0.01, "size_mm": 12, "count": 3, "range_mm": [2, 7]},
}
PLATE: Tables = {
    "plate": {
        "length_x_mm": 400, "length_y_mm": 300, "thickness_mm": 3, "material": "steel",
        "support_stiffness_n_per_mm": 15,
    },
    "contact": {"force_n": [2, 20], "x_mm": [10, 390], "y_mm": [20, 280]},
    "sensors": {"noise_mm": 0.01, "size_mm": 12, "count": 4, "range_mm": [2, 7]},
}  # fmt: skip


def with_all(*parts: Tables) -> Tables:
    """Return the keys of all parts, the last of each key."""
    tables: Tables = {}
    for part in parts:
        for name, keys in part.items():
            tables[name] = tables.get(name, {}) | keys
    return tables


def made(*parts: Tables) -> Scene:
    return make_scene(**with_all(*parts))


def refusal(*parts: Tables) -> str:
    """Return the message with which a scene is refused."""
    with pytest.raises(InputError) as refused:
        made(*parts)
    message = str(refused.value)
    assert message.startswith("the scene: ")
    return message.removeprefix("the scene: ")


def beam(**keys: object) -> Tables:
    return {"beam": keys}


def sensors(**keys: object) -> Tables:
    return {"sensors": keys}


def contact(**keys: object) -> Tables:
    return {"contact": keys}


def plate(**keys: object) -> Tables:
    return {"plate": keys}


def points(*places: tuple[float, float]) -> list[dict[str, float]]:
    return [{"x_mm": x, "y_mm": y} for x, y in places]
