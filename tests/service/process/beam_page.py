"""What tests of the page on the beam of the bench share: its loads as samples, and what is drawn."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from beamtouch_models import influence_matrix
from beamtouch_models.design.scene import load_scene
from service.bench import START_US, batch_of
from support.surfaces.example_scenes import SCENES

if TYPE_CHECKING:
    from beamtouch_models.arrays import Floats
    from beamtouch_models.runtime import ModelFile
    from service.process.conftest import Service
    from support.pages.browser import Watched

WEDGE_MM = 0.5
COUNT = 50
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
        total = sum((force * bench_shape(at_mm, load) for load, force in loads), bench_shape(at_mm, 0.0))
        return [float(one) for one in total]

    def send(
        self, deflection_mm: list[float | None], covariance_mm2: list[float] | None = None, **members: object
    ) -> None:
        """Post samples, 5 ms apart, that all measure this with this covariance; `members` go into the batch."""
        rows = [deflection_mm] * COUNT
        quality = ["missing" if one is None else "good" for one in deflection_mm]
        names = self.model.channels
        begin_us = START_US + 5000 * self.sequence
        batch = batch_of(*rows, sequence=self.sequence, channels=names, quality=quality, begin_us=begin_us) | members
        self.sequence += COUNT
        for sample in batch["samples"] if covariance_mm2 else []:
            sample |= {"readings": 4, "covariance_mm2": covariance_mm2}
        answer = self.service.post(batch)
        assert answer.status_code == 200, answer.text

    def load(self, *loads: tuple[float, float], **members: object) -> None:
        """Post samples of these loads; none: of the beam at rest."""
        self.send(list(self.deflection_mm(*loads)), None, **members)

    def moving(self, load: tuple[float, float]) -> None:
        """Post samples of a load that comes and goes: their scatter lies along its deflection."""
        shape = self.deflection_mm(load)
        triangle = [0.01 * one * other for row, one in enumerate(shape) for other in shape[: row + 1]]
        self.send(list(shape), triangle)

    def wedge(self, channel: int) -> None:
        """Post samples of a beam at rest with one sensor wrong."""
        wedged: list[float | None] = [0.0] * len(self.model.channels)
        wedged[channel] = WEDGE_MM
        self.send(wedged)


StartBench = Callable[..., Bench]


def drawn(seen: Watched, name: str) -> list[tuple[float, float]]:
    """Return the points [px] of the line of this class in the drawing of the beam; none if there is no such line."""
    script = "lines => lines.flatMap(line => [...line.points].map(({x, y}) => [x, y]))"
    return [(x, y) for x, y in seen.page.eval_on_selector_all(f"#beam polyline.{name}", script)]


def circles(seen: Watched) -> list[tuple[float, float]]:
    """Return the middles [px] of the circles at what the sensors measured."""
    script = "all => all.map(one => [Number(one.getAttribute('cx')), Number(one.getAttribute('cy'))])"
    return [(x, y) for x, y in seen.page.eval_on_selector_all("#beam circle.seen", script)]


def bench_shape(at_mm: list[float], load_mm: float) -> Floats:
    """Return the deflection per newton [mm/N] at positions of the beam of the bench under a load."""
    scene, _ = load_scene(SCENES / "bench.toml")
    shape: Floats = influence_matrix(scene, at_mm, [load_mm])[0]
    return shape
