"""A model whose surface is quickly simulated: single readings of three sensors, on a beam that does not ring.

Its scene gives no remark: away from the supports, every force is seen.
"""

from pathlib import Path

from beamtouch_models.building.build import Choices, build_model
from beamtouch_models.placement.placing import Aim
from beamtouch_models.scene import parse_scene
from beamtouch_models.sweeps import silent
from example_scenes import PAPER
from few_draws import short_work

SCENE = (
    PAPER.replace("count = 2", "count = 3")
    .replace("10.0", "[2.0, 20.0]")
    .replace("[1, 399]", "[20, 380]")
    .replace("max = 2", "max = 0.2")
)
CHOICES = Choices(aim=Aim("eigenvalue-product"))


def write_quick_model(folder: Path) -> None:
    """Write `quick.onnx` into a folder."""
    with short_work():
        built = build_model(
            parse_scene(SCENE, "quick.toml"), SCENE, "quick", count=None, seed=0, progress=silent, choices=CHOICES
        )
    (folder / "quick.onnx").write_bytes(built.content)
