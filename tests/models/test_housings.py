"""Housings of sensors: what layouts leave room for, and what is refused because it leaves none."""

import json
from itertools import pairwise
from pathlib import Path

import pytest

from support.programs.in_process import Command
from support.surfaces.example_scenes import PAPER

PRODUCT = ("--criterion", "eigenvalue-product")
CLAMPED = """
[beam]
length_mm = 300
material = "steel"
width_mm = 20
thickness_mm = 3
supports = [{ at_mm = 300, kind = "fixed" }]

[contact]
force_n = [0.5, 4]
position_mm = [5, 280]

[sensors]
count = 3
noise_mm = 0.005
range_mm = [1, 20]
"""


@pytest.mark.promise(
    "docs/how-to/design.md",
    (
        "Housings do not overlap each other, a support or a stretch of `keep_out_mm`, and do not reach beyond an end "
        "of the beam, not even a free one"
    ),
)
@pytest.mark.promise(
    "docs/reference/scene.md",
    "Stretches of the beam that no housing may reach into; it may touch their ends.",
)
@pytest.mark.parametrize(
    ("rules", "arguments", "said"),
    [
        ("fixed_mm = [4, 12]", PRODUCT, None),
        ("fixed_mm = [100, 180, 260]", ("--criterion", "position-error"), None),
        (
            "fixed_mm = [3.9]",
            PRODUCT,
            "where a housing of size_mm = 8 reaches beyond the end at 0 mm",
        ),
        ("fixed_mm = [0, 290]\nsize_mm = 0", PRODUCT, None),
        ("fixed_mm = [300]\nsize_mm = 0", PRODUCT, "a housing of size_mm = 0 stands on the support at 300 mm"),
        ("fixed_mm = [100, 107]\nsize_mm = 7", PRODUCT, None),
        ("fixed_mm = [100, 107]\nsize_mm = 7\nmin_distance_mm = 9", PRODUCT, "less than min_distance_mm = 9; move one"),
        ("fixed_mm = [100]\nkeep_out_mm = [[104, 120]]", PRODUCT, None),
        ("size_mm = 300", PRODUCT, "sensors.size_mm = 300 must be less than beam.length_mm = 300"),
        ("size_mm = 110", PRODUCT, "no layout of 3 sensors keeps the rules of sensors (size_mm, "),
        ("grid_mm = 50", ("--components", 4), "3 sensors have 3 components, not 4"),
    ],
)
def test_a_housing_keeps_off_ends_supports_keep_outs_and_other_housings(
    design_sensors_roughly: Command, tmp_path: Path, rules: str, arguments: tuple[object, ...], said: str | None
) -> None:
    scene, grid = tmp_path / "scene.toml", "" if "grid" in rules else "grid_mm = 4\n"
    scene.write_text(f"{CLAMPED}{rules}\n{grid}")
    done = design_sensors_roughly("place", scene, *arguments, "--json")
    assert done.returncode == (0 if said is None else 2), done.stderr
    assert (said or "") in done.stderr
    assert done.stderr.count("\n") == (0 if said is None else 1)
    if said is None:
        fixed = rules.partition("[")[2].partition("]")[0].split(",")
        assert {float(place) for place in fixed} <= set(json.loads(done.stdout)["positions_mm"])


@pytest.mark.parametrize("arguments", [(), ("--failed-percent", 100)])
def test_layouts_of_the_least_error_leave_room_for_the_housings(
    design_sensors_roughly: Command, tmp_path: Path, arguments: tuple[object, ...]
) -> None:
    """On two spans with a keep-out; as points, two of the sensors would stand side by side."""
    rules = "size_mm = 34\nkeep_out_mm = [[90, 116]]\nfixed_mm = [133]\ngrid_mm = 6\ncount = 4"
    supports = "[beam]\nsupports = [{ at_mm = 0 }, { at_mm = 180 }, { at_mm = 400 }]"
    scene = tmp_path / "scene.toml"
    scene.write_text(PAPER.replace("count = 2", rules).replace("[beam]", supports))
    done = design_sensors_roughly("place", scene, *arguments, "--json")
    assert done.returncode == 0, done.stderr
    places = json.loads(done.stdout)["positions_mm"]
    assert 133 in places
    assert {at % 6 for at in places if at != 133} == {0}
    taken = sorted([(-17, 0), (180, 180), (400, 417), (90, 116), *((at - 17, at + 17) for at in places)])
    assert all(end <= start for (_, end), (start, _) in pairwise(taken))
