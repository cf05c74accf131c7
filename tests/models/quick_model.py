"""A model whose surface is quickly simulated: single readings of three sensors, on a beam that does not ring.

Its scene gives no remark: away from the supports, every force is seen.
"""

from pathlib import Path

from beamtouch_models import read_scene, resolve
from support.surfaces.example_scenes import PAPER, ROUGH

SCENE = (
    PAPER.replace("count = 2", "count = 3")
    .replace("10.0", "[2.0, 20.0]")
    .replace("[1, 399]", "[20, 380]")
    .replace("max = 2", "max = 0.2")
)


def write_quick_model(folder: Path) -> None:
    """Write `quick.onnx` into a folder."""
    layout = resolve(read_scene(SCENE)).place(criterion="eigenvalue-product", effort=ROUGH)
    layout.build("quick").save(folder / "quick.onnx")
