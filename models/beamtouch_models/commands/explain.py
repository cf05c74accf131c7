"""`design-sensors explain`: the price of each physical effect in a scene, and the time that modelling it costs.

With `--zones`, also what zones of the service would be worth: the width of the band at each edge that is `unsure`.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamtouch_common.digits import digits
from beamtouch_models.commands.options import add_shared
from beamtouch_models.printing import Block, Result, Table, note

if TYPE_CHECKING:
    from beamtouch_models.pricing.effect import Effect
    from beamtouch_models.scene import Scene

REPEATS = 5
SENSORS = 101
"""Sensors in the influence matrix whose computation is timed."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_shared(parser, "scene")
    words = "also forecast the answers for zones: a TOML file with tables [zones.NAME], with the keys of the service"
    parser.add_argument("--zones", type=Path, metavar="FILE", help=words)
    add_shared(parser, "--json")


def run(options: argparse.Namespace) -> Result:
    """Price the effects, and measure the time that each costs."""
    from beamtouch_models.building.remarks import remarks
    from beamtouch_models.commands.explain_zones import bands_of, load_zones, zone_rows
    from beamtouch_models.pricing.effect import NEGLIGIBLE
    from beamtouch_models.pricing.ringing import told
    from beamtouch_models.scene import load_scene
    from beamtouch_models.surface import Surface

    scene, _ = load_scene(options.scene)
    note(*remarks(scene))
    zones = load_zones(options.zones, scene) if options.zones else {}
    surface = Surface.of(scene)
    surface.check()
    effects = [_as_json(effect) for effect in surface.effects]
    noise, ringing = surface.readings.behind(surface.filter), surface.ringing
    fields = {
        "effects": effects,
        "noise_mm": noise.sample_mm,
        "reading_noise_mm": noise.reading_mm,
        "ringing": ringing and asdict(ringing),
        "max_deflection_mm": surface.travel.largest_mm,
        "negligible": NEGLIGIBLE,
    }
    rows: list[Block] = [
        Table(("effect", "price", "", "with/without", "remark"), [*map(_row, effects)], text=("", "remark")),
        f"price: in units of a sample's noise, {digits(noise.sample_mm, 3)} mm; effects below {NEGLIGIBLE:g} are left "
        f"out\nwith/without: measured time to compute an influence matrix of {SENSORS} sensors",
        *(told(ringing) if ringing else []),
    ]
    if zones:
        edges = bands_of(surface, zones)
        fields["zones"] = [edge._asdict() for edge in edges]
        rows += zone_rows(edges) if edges else []
    return Result(fields, rows)


def _as_json(effect: Effect) -> dict[str, Any]:
    """Return an effect with the time of an influence matrix with and without it, in us; None if it changes nothing."""
    with_us = without_us = cost_us = None
    if effect.having is not None and effect.lacking is not None:
        with_us, without_us = _matrix_us(effect.having), _matrix_us(effect.lacking)
        cost_us = with_us - without_us
    return {
        "name": effect.name,
        "price": effect.price,
        "included": effect.verdict == "in",
        "verdict": effect.verdict,
        "cost_us": cost_us,
        "with_us": with_us,
        "without_us": without_us,
        "reason": effect.reason,
    }


def _row(effect: dict[str, Any]) -> tuple[str, ...]:
    price = "-" if effect["price"] is None else digits(effect["price"], 3)
    timed = "-" if effect["cost_us"] is None else f"{effect['with_us']:.0f}/{effect['without_us']:.0f} us"
    return effect["name"], price, effect["verdict"], timed, effect["reason"]


def _matrix_us(scene: Scene) -> float:
    import numpy as np

    from beamtouch_models.physics.beam import influence_matrix, load_positions_mm
    from beamtouch_models.physics.mesh import mesh_of

    sensors, loads = np.linspace(0.0, scene.beam.length_mm, SENSORS), load_positions_mm(scene)
    least = float("inf")
    for _ in range(REPEATS):
        mesh_of.cache_clear()  # the time includes the assembly
        start = time.perf_counter()
        influence_matrix(scene, sensors, loads)
        least = min(least, time.perf_counter() - start)
    return 1e6 * least
