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
from beamtouch_models.printing import Block, Table

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
    """Width of the band once the mean of a load at rest no longer grows. Before that, it is wider."""
    wrong_percent: float
    """Of the contacts in that band."""


def load_zones(path: Path, scene: Scene) -> dict[str, Zone]:
    """Read zones; InputError if the file is wrong, or a zone is none of the scene's surface."""
    zones = load_toml(_File, path).zones
    estimates_force = "force" in scene.requirements.descriptors
    for name, zone in zones.items():
        misfit = zone.misfit(scene.beam.length_mm, estimates_force=estimates_force)
        low_n, high_n = _forces_n(zone, scene.contact.force_range_n)
        if not misfit and low_n > high_n:
            least_n, most_n = scene.contact.force_range_n
            misfit = f"no contact of the scene has such a force; its forces are {least_n:g} to {most_n:g} N"
        if misfit:
            raise InputError(f"{path}: zones.{name}: {misfit}")
    return zones


def bands_of(surface: Surface, zones: dict[str, Zone]) -> list[Edge]:
    """Return the forecast for each edge within the beam, with the sensors where `place` puts them."""
    placed = place_sensors(surface, seed=SEED).prior
    at_rest = replace(placed, noise_mm=surface.errors.min_noise_mm or placed.noise_mm)
    edges = []
    for name, zone in zones.items():
        range_n = _forces_n(zone, at_rest.force_n)
        for edge_mm in (zone.from_mm, zone.to_mm):
            if 0 < edge_mm < placed.length_mm:
                band = band_at(at_rest, edge_mm, SEED, range_n)
                edges.append(Edge(name, edge_mm, band.width_mm, 100 * band.wrong))
    return edges


def _forces_n(zone: Zone, range_n: tuple[float, float]) -> tuple[float, float]:
    """Return the part of a range of forces [N] that a zone takes; if it is none, the ends are the wrong way round."""
    least_n, largest_n = zone.least_force_n, zone.largest_force_n
    return (
        range_n[0] if least_n is None else max(range_n[0], least_n),
        range_n[1] if largest_n is None else min(range_n[1], largest_n),
    )


def zone_rows(edges: list[Edge]) -> list[Block]:
    """Return the table of the forecasts, and what it says."""
    head = ("zone", "edge mm", "unsure mm", "wrong %")
    rows = [(edge.zone, f"{edge.edge_mm:g}", digits(edge.unsure_mm, 3), f"{edge.wrong_percent:.2f}") for edge in edges]
    words = (
        "unsure: width of the band around an edge in which the answer is `unsure`, for loads that have come to rest, "
        "on average over the forces of the zone\n"
        "wrong: contacts in this band that are said to be on the wrong side of the edge"
    )
    return [Table(head, rows), words]
