"""`design-sensors explain --zones`: the file of the zones, their forecast, and its table."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_common.files import load_toml
from beamtouch_common.zones import MAX_ZONES, Zone, ZoneName
from beamtouch_models.accuracy.zone_bands import band_at
from beamtouch_models.building.sensors import place_sensors
from beamtouch_models.commands.printing import Block, Table

if TYPE_CHECKING:
    from pathlib import Path

    from beamtouch_models.scene import Scene
    from beamtouch_models.surface import Surface

SEED = 0


class _File(BaseModel):
    """The file of `--zones`."""

    model_config = ConfigDict(extra="forbid", strict=True)

    zones: Annotated[dict[ZoneName, Zone], Field(min_length=1, max_length=MAX_ZONES)]


class Edge(NamedTuple):
    """The forecast for one edge of a zone."""

    zone: str
    edge_mm: float
    unsure_mm: float
    """Width of the band at the stated latency."""
    wrong_percent: float
    """Of the contacts in that band."""
    unsure_at_rest_mm: float
    """Width of the band once the mean of a load at rest no longer grows."""
    wrong_at_rest_percent: float


def load_zones(path: Path, scene: Scene) -> dict[str, Zone]:
    """Read zones; InputError if the file is wrong, or a zone is none of the scene's surface."""
    zones = load_toml(_File, path).zones
    estimates_force = "force" in scene.requirements.descriptors
    for name, zone in zones.items():
        if misfit := zone.misfit(scene.beam.length_mm, estimates_force=estimates_force):
            message = f"{path}: zones.{name}: {misfit}"
            raise InputError(message)
    return zones


def bands_of(surface: Surface, zones: dict[str, Zone]) -> list[Edge]:
    """Return the forecast for each edge within the beam, with the sensors where `place` puts them."""
    soon = place_sensors(surface, seed=SEED).prior
    at_rest = replace(soon, noise_mm=surface.errors.min_noise_mm or soon.noise_mm)
    edges = []
    for name, zone in zones.items():
        for edge_mm in (zone.from_mm, zone.to_mm):
            if 0 < edge_mm < soon.length_mm:
                first, last = (band_at(prior, edge_mm, SEED) for prior in (soon, at_rest))
                rates = 100 * first.wrong, 100 * last.wrong
                edges.append(Edge(name, edge_mm, first.width_mm, rates[0], last.width_mm, rates[1]))
    return edges


def zone_rows(edges: list[Edge], latency_ms: float | None) -> list[Block]:
    """Return the table of the forecasts, and what it says."""
    soon = f"within {latency_ms:g} ms" if latency_ms else "one reading"
    head = ("zone", "edge mm", f"unsure mm, {soon}", "wrong %", "unsure mm, at rest", "wrong %")
    rows = [
        (
            edge.zone,
            f"{edge.edge_mm:g}",
            digits(edge.unsure_mm, 3),
            f"{edge.wrong_percent:.2f}",
            digits(edge.unsure_at_rest_mm, 3),
            f"{edge.wrong_at_rest_percent:.2f}",
        )
        for edge in edges
    ]
    words = (
        "unsure: width of the band around an edge in which the answer is `unsure`, on average over the forces of the "
        "scene\nwrong: contacts in this band that are said to be on the wrong side of the edge"
    )
    return [Table(head, rows), words]
