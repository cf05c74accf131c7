"""What tests of the models share: commands without processes of their own, and a simulated surface."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from beamtouch_models import cli, format_scene
from beamtouch_models.design.scene import Scene
from beamtouch_models.lab.challenge.play import SimulatedSurface
from beamtouch_models.lab.rig import cli as rig_cli
from beamtouch_models.runtime import ModelFile
from models.quick_model import write_quick_model
from support.programs.in_process import Command, Refusal, command_of
from support.programs.toolchain import made_once
from support.surfaces.example_scenes import ROUGH

Explain = Callable[[Scene], dict[str, Any]]


@pytest.fixture(scope="session")
def surface(bench: ModelFile) -> SimulatedSurface:
    """The surface of the bench, as `challenge` simulates it."""
    return SimulatedSurface.of(bench.metadata)


@pytest.fixture(scope="session")
def quick_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model file whose challenge and evaluation take a second, for tests of how such work is spread."""
    return made_once(tmp_path_factory, "quick-model", write_quick_model) / "quick.onnx"


@pytest.fixture
def design_sensors_here(capsys: pytest.CaptureFixture[str]) -> Command:
    """`design-sensors` in this process, without workers, which would take longer to start than the tests' work."""
    return command_of(lambda arguments: cli.main(_without_workers(arguments)), capsys)


def _without_workers(arguments: list[str]) -> list[str]:
    sweeps = bool(arguments) and arguments[0] in {"trade", "evaluate", "challenge"}
    return [*arguments, "--workers", "1"] if sweeps else arguments


@pytest.fixture
def design_sensors_roughly(capsys: pytest.CaptureFixture[str]) -> Command:
    """The same with little effort, for tests that do not ask for figures."""

    def main(arguments: list[str]) -> int:
        takes_effort = bool(arguments) and arguments[0] in {"build", "calibrate", "explain", "place", "trade"}
        effort = ["--effort", str(ROUGH)] if takes_effort else []
        return cli.main([*_without_workers(arguments), *effort])

    return command_of(main, capsys)


@pytest.fixture
def explain(design_sensors_here: Command, tmp_path: Path) -> Explain:
    """A function from a scene to what `design-sensors explain --json` says of it, with its effects by name."""

    def run(scene: Scene) -> dict[str, Any]:
        path = tmp_path / "explained.toml"
        path.write_text(format_scene(scene))
        done = design_sensors_here("explain", path, "--json")
        assert done.returncode == 0, done.stderr
        told: dict[str, Any] = json.loads(done.stdout)
        return told | {"effects": {one["name"]: one for one in told["effects"]}}

    return run


@pytest.fixture
def refused(design_sensors_roughly: Command) -> Refusal:
    """`design-sensors` in this process with what it refuses in one line, as wrong input; returns that line."""

    def line(*arguments: object) -> str:
        done = design_sensors_roughly(*arguments)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
        return done.stderr

    return line


@pytest.fixture
def rig_here(capsys: pytest.CaptureFixture[str]) -> Command:
    """`beamtouch-rig` in this process, for input that it refuses."""
    return command_of(rig_cli.main, capsys)
