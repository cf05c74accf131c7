"""Models of the shipped scenes for benchmarks."""

import re
from pathlib import Path

from beamtouch_models import modelfile
from beamtouch_models.building.build import build_model
from beamtouch_models.building.daemon_config import daemon_config
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.progress import silent
from beamtouch_models.scene import parse_scene
from example_scenes import SCENES


def build(folder: Path, name: str = "bench", rate_hz: int | None = None) -> ModelFile:
    """Build a shipped scene, at its own rate or at another one.

    Writes `NAME.toml`, the scene, `NAME.onnx` and `generated.toml`, the configuration of a daemon, into the folder.
    """
    text = (SCENES / f"{name}.toml").read_text()
    if rate_hz is not None:
        text = re.sub(r"rate_hz = \S+", f"rate_hz = {rate_hz}", text)
    path = folder / f"{name}.onnx"
    path.write_bytes(build_model(parse_scene(text, name), text, name, count=None, seed=0, progress=silent).content)
    (folder / f"{name}.toml").write_text(text)
    model = modelfile.load(path)
    (folder / "generated.toml").write_text(daemon_config(model.metadata))
    return model
