"""Models of the shipped scenes for benchmarks."""

import re
from pathlib import Path

import beamtouch_models
from beamtouch_models.runtime import ModelFile
from support.surfaces.example_scenes import SCENES


def build(folder: Path, name: str = "bench", rate_hz: int | None = None) -> ModelFile:
    """Build a shipped scene, at its own rate or at another one.

    Writes `NAME.toml`, the scene, `NAME.onnx` and `generated.toml`, the configuration of a daemon, into the folder.
    """
    text = (SCENES / f"{name}.toml").read_text()
    if rate_hz is not None:
        text = re.sub(r"rate_hz = \S+", f"rate_hz = {rate_hz}", text)
    path, scene = folder / f"{name}.onnx", folder / f"{name}.toml"
    scene.write_text(text)
    model = beamtouch_models.resolve(beamtouch_models.read_scene(scene)).place().build(name)
    model.save(path)
    (folder / "generated.toml").write_text(beamtouch_models.daemon_config(model.metadata))
    return model
