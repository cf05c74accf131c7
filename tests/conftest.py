"""What several rooms need: the shipped scenes, and models built from them once per run."""

from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock

from beamtouch_models import modelfile
from beamtouch_models.build import build
from beamtouch_models.scene import load_scene
from example_scenes import SCENES


@pytest.fixture(scope="session")
def built_model(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A function from the name of a shipped scene to its model file; built once, whichever test process asks first."""
    shared = tmp_path_factory.getbasetemp().parent / "models"
    shared.mkdir(exist_ok=True)

    def model(name: str) -> Path:
        path = shared / f"{name}.onnx"
        with FileLock(shared / f"{name}.lock"):
            if not path.exists():
                scene, text = load_scene(SCENES / f"{name}.toml")
                built = build(scene, text, name, count=None, seed=0, progress=lambda _doing, _done: None)
                path.write_bytes(built.content)
        return path

    return model


@pytest.fixture(scope="session")
def bench_model(built_model: Callable[[str], Path]) -> Path:
    """The model file of `models/scenes/bench.toml`."""
    return built_model("bench")


@pytest.fixture(scope="session")
def bench(bench_model: Path) -> modelfile.ModelFile:
    """The same model, loaded."""
    return modelfile.load(bench_model)
