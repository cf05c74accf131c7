"""What tests of the page on the beam of the bench share: its loads as samples, and a service for them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from beamtouch_models.physics.beam import influence
from beamtouch_models.scene import load_scene
from example_scenes import SCENES
from service.conftest import batch_of

if TYPE_CHECKING:
    from pathlib import Path

    from beamtouch_models.arrays import Floats
    from beamtouch_models.modelfile import ModelFile
    from service.process.conftest import Service, StartService

LONG_MS = 60_000
"""A sample that was sent by hand stays fresh for the length of a test."""
WEDGE_MM = 0.5
COUNT = 30
"""Samples of one kind in a row: enough for states that take persistence."""


class Bench:
    """The surface press-7 with a bench model, on a service that is sent samples by hand."""

    def __init__(self, service: Service, model: ModelFile) -> None:
        self.service = service
        self.model = model
        self.sequence = 1

    def deflection_mm(self, *loads: tuple[float, float]) -> list[float]:
        """Return what the sensors measure under loads, each a position [mm] and a force [N]."""
        at_mm = [channel.position_mm for channel in self.model.metadata.layout]
        return sum((force * bench_shape(at_mm, load) for load, force in loads), bench_shape(at_mm, 0.0)).tolist()

    def send(self, deflection_mm: list[float | None], **members: Any) -> None:
        """Post samples that all measure this; `members` go into the batch."""
        rows = [deflection_mm] * COUNT
        quality = ["missing" if one is None else "good" for one in deflection_mm]
        names = self.model.channels
        batch = batch_of(*rows, sequence=self.sequence, channels=names, quality=quality) | members
        self.sequence += COUNT
        answer = self.service.post(batch)
        assert answer.status_code == 200, answer.text

    def load(self, *loads: tuple[float, float], **members: Any) -> None:
        """Post samples of these loads; none: of the beam at rest."""
        self.send(list(self.deflection_mm(*loads)), **members)

    def wedge(self, channel: int) -> None:
        """Post samples of a beam at rest with one sensor wrong."""
        wedged: list[float | None] = [0.0] * len(self.model.channels)
        wedged[channel] = WEDGE_MM
        self.send(wedged)


def bench_shape(at_mm: list[float], load_mm: float) -> Floats:
    """Return the deflection per newton [mm/N] at positions of the beam of the bench under a load."""
    scene, _ = load_scene(SCENES / "bench.toml")
    shape: Floats = influence(scene.beam, at_mm, [load_mm])[0]
    return shape


def start_bench(start: StartService, model: Path, token_file: Path, folder: Path, *options: str | Path) -> Service:
    """Start a service of press-7 with this model."""
    (folder / "service.toml").write_text(f'[surfaces.press-7]\nmodel = "{model}"\nstale_ms = {LONG_MS}\n')
    return start("--config", "service.toml", "--write-token-file", token_file, *options)
