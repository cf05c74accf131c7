"""The supports of a plate as the page draws it from above."""

from typing import Any

import pytest

from beamtouch_models import make_scene
from beamtouch_models.design.building.build import draw_beam

CORNERS = [(0, 0), (0, 300), (400, 0), (400, 300)]


def drawn(supports: object, **plate: object) -> list[dict[str, Any]]:
    scene = make_scene(
        plate={"length_x_mm": 400, "length_y_mm": 300, "thickness_mm": 3, "material": "steel", "supports": supports}
        | plate,
        contact={"force_n": [2, 20], "x_mm": [10, 390], "y_mm": [10, 290]},
        sensors={"noise_mm": 0.002},
    )
    drawing = draw_beam(scene)
    assert (drawing.at_mm, drawing.load_mm, drawing.deflection_mm_per_n) == ([0, 400], [10], [[0, 0]])
    return [support.model_dump() for support in drawing.supports]


@pytest.mark.parametrize(("stiffness", "kind"), [(None, "simple"), (15, "spring")])
def test_corners_are_points_rigid_or_springs(stiffness: float | None, kind: str) -> None:
    found = drawn("corners", support_stiffness_n_per_mm=stiffness)
    assert [(one["at_mm"], one["across_mm"]) for one in found] == CORNERS
    assert {(one["kind"], "end_mm" in one) for one in found} == {(kind, False)}


@pytest.mark.promise(
    "docs/how-to/plates.md",
    "With one of them it is a line across the whole plate.",
)
def test_edges_are_lines_across_the_whole_plate() -> None:
    found = drawn([{"x_mm": 20}, {"y_mm": 290, "stiffness_n_per_mm": 50}, {"x_mm": 380, "y_mm": 10}])
    ends = [(one["at_mm"], one["across_mm"], one.get("end_mm"), one["kind"]) for one in found]
    assert ends == [(0, 290, (400, 290), "spring"), (20, 0, (20, 300), "simple"), (380, 10, None, "simple")]
