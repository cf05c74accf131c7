"""`design-sensors explain`: the price of each physical effect in a scene, and whether the model includes it.

With `--zones`, also what zones of the service would be worth: the width of the band at each edge that is `unsure`.
"""

import argparse
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_common.files import load_toml
from beamtouch_common.outline import BEAM_AXIS, Outline
from beamtouch_common.units import fine, fine_unit
from beamtouch_common.zones import MAX_ZONES, Zone, ZoneName, first_conflict
from beamtouch_models.design.building.remarks import remarks
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.placement.placing import DEFAULT_AIM
from beamtouch_models.design.pricing.effect import NEGLIGIBLE, VERDICTS, Effect
from beamtouch_models.design.pricing.ringing import describe_ringing
from beamtouch_models.design.printing import Block, Result, Table, Words, note
from beamtouch_models.design.scene import Scene, load_scene
from beamtouch_models.design.surface import Surface, resolve


def run(options: argparse.Namespace) -> Result:
    """Price the effects; the result is a row for each, and how long the beam rings."""
    effort, (scene, _) = Effort(options.effort), load_scene(options.scene)
    note(*remarks(scene))
    zones = _load_zones(options.zones, scene) if options.zones else {}
    surface = resolve(scene)
    surface.check()
    effects = [_as_json(effect) for effect in surface.effects]
    noise, ringing = surface.readings.behind(surface.filter), surface.ringing
    rings = describe_ringing(ringing, "beam" if scene.has_beam else "plate") if ringing else []
    fields = {
        "effects": effects,
        "noise_mm": noise.sample_mm,
        "reading_noise_mm": noise.reading_mm,
        "ringing": ringing and asdict(ringing),
        "max_deflection_mm": surface.travel.largest_mm,
        "negligible": NEGLIGIBLE,
    }
    unit, _ = fine_unit(scene.unit)
    head = ("effect", unit, "price", "model", "remark")
    prices = [_row(effect, noise.sample_mm, scene.unit) for effect in surface.effects]
    rows: list[Block] = [
        Table(head, prices, text=("model", "remark")),
        [
            (unit, "the most that the effect changes the deflection at a sensor, under the largest force"),
            ("price", f"the same over a sample's noise, {fine(noise.sample_mm, scene.unit)}"),
            *VERDICTS.values(),
            *(("" if place else "ringing", line) for place, line in enumerate(rings)),
        ],
    ]
    if (tolerance := scene.contact.assumed_tolerance_percent) is not None:
        weak, strong = scene.contact.force_range_n
        rows.append(
            f"force: {weak:g} to {strong:g} N, as contact.force_tolerance_percent is not stated and {tolerance:g} then"
        )
    if zones:
        edges = _bands_of(surface, zones, effort)
        fields["zones"] = [edge._asdict() for edge in edges]
        rows += _zone_rows(edges) if edges else []
    return Result(fields, rows)


def _as_json(effect: Effect) -> dict[str, Any]:
    return {
        "name": effect.name,
        "price": effect.price,
        "included": effect.verdict == "in",
        "verdict": effect.verdict,
        "reason": effect.reason,
    }


def _row(effect: Effect, noise_mm: float, unit: str) -> tuple[str, ...]:
    scales = noise_mm * fine_unit(unit)[1], 1.0
    size, price = ("-" if effect.price is None else digits(scale * effect.price, 2) for scale in scales)
    return effect.name, size, price, VERDICTS[effect.verdict][0], effect.reason


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


def _load_zones(path: Path, scene: Scene) -> dict[str, Zone]:
    """Read zones; InputError if the file is wrong, or a zone is none of the scene's surface."""
    zones = load_toml(_File, path).zones
    if len(scene.contact.ranges_mm) > 1:
        raise InputError("--zones: forecasts zones of beams only; leave it out for a structure of two axes")
    estimates_force = "force" in scene.requirements.descriptors
    if conflict := first_conflict(zones, Outline.of_beam(scene.length_mm), estimates_force=estimates_force):
        raise InputError(f"{path}: zones.{conflict}")
    least_n, most_n = scene.contact.force_range_n
    for name, zone in zones.items():
        low_n, high_n = _forces_n(zone, (least_n, most_n))
        if low_n > high_n:
            problem = f"no contact of the scene has such a force; its forces are {least_n:g} to {most_n:g} N"
            raise InputError(f"{path}: zones.{name}: {problem}")
    return zones


def _bands_of(surface: Surface, zones: dict[str, Zone], effort: Effort) -> list[Edge]:
    """Return the forecast for each edge within the beam, with the sensors where `place` puts them."""
    # Without zones, what places sensors is not needed, and takes a fifth of the command to import.
    from beamtouch_models.design.accuracy.zone_bands import band_at  # noqa: PLC0415
    from beamtouch_models.design.layout import place_sensors  # noqa: PLC0415

    placed = place_sensors(surface, seed=SEED, aim=replace(DEFAULT_AIM, effort=effort)).prior
    at_rest = placed.at_noise(surface.sampling.settled.noise_mm)
    edges = []
    for name, zone in zones.items():
        range_n = _forces_n(zone, at_rest.force_n)
        for edge_mm in zone.ranges_mm[BEAM_AXIS]:
            if 0 < edge_mm < placed.diagonal_mm:
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


def _zone_rows(edges: list[Edge]) -> list[Block]:
    """Return the table of the forecasts, and what it says."""
    head = ("zone", "edge mm", "unsure mm", "wrong %")
    rows = [(edge.zone, f"{edge.edge_mm:g}", digits(edge.unsure_mm, 3), f"{edge.wrong_percent:.2f}") for edge in edges]
    words = (
        "unsure: width of the band around an edge in which the answer is `unsure`, for loads that have come to rest, "
        "on average over the forces of the zone\n"
        "wrong: contacts in this band that are said to be on the wrong side of the edge"
    )
    return [Table(head, rows), Words(words)]
