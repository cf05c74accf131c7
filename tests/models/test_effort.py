"""`--effort`: less of it takes fewer layouts and contacts, which the figures say."""

import json
from pathlib import Path

import pytest

import beamtouch_models as models
from beamtouch_common.errors import InputError
from support.programs.in_process import Command
from support.surfaces.example_scenes import PAPER


def test_less_effort_scores_fewer_layouts_and_states_larger_errors(
    design_sensors_here: Command, tmp_path: Path
) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(PAPER.replace("count = 2", "count = 3"))
    more, less = (
        json.loads(design_sensors_here("place", path, "--effort", effort, "--json").stdout) for effort in (0.2, 0.01)
    )
    assert less["evaluations"] < more["evaluations"] / 2
    assert less["standard_error"] > 2 * more["standard_error"]


@pytest.mark.parametrize("effort", [0.0, 0.009, 101.0])
def test_an_effort_that_none_can_mean_is_refused(effort: float) -> None:
    surface = models.resolve(models.read_scene(PAPER))
    for refuse in (surface.place, surface.layout([100.0, 300.0]).build):
        with pytest.raises(InputError, match=f"^effort = {effort:g} is not from 0.01 to 100$"):
            refuse(effort=effort)
