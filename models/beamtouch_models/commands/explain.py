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
from beamtouch_models.commands.options import add_json
from beamtouch_models.printing import Block, Result, Table, note, show

if TYPE_CHECKING:
    from beamtouch_models.pricing.prices import Effect
    from beamtouch_models.scene import Scene

REPEATS = 5
SENSORS = 101
"""Sensors in the influence matrix whose computation is timed."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    words = "also forecast the answers for zones: a TOML file with tables [zones.NAME], with the keys of the service"
    parser.add_argument("--zones", type=Path, metavar="FILE", help=words)
    add_json(parser)


def run(options: argparse.Namespace) -> None:
    """Price the effects, measure the time that each costs, and print both."""
    from beamtouch_models.building.remarks import remarks
    from beamtouch_models.commands.explain_zones import bands_of, load_zones, zone_rows
    from beamtouch_models.pricing.prices import NEGLIGIBLE
    from beamtouch_models.pricing.ringing import told
    from beamtouch_models.scene import load_scene
    from beamtouch_models.surface import Surface

    scene, _ = load_scene(options.scene)
    note(*remarks(scene))
    zones = load_zones(options.zones, scene) if options.zones else {}
    surface = Surface.of(scene)
    surface.check()
    effects = [(effect, _cost_us(effect)) for effect in surface.effects]
    noise, ringing = surface.readings.behind(surface.filter), surface.ringing
    fields = {
        "effects": [_as_json(effect, cost) for effect, cost in effects],
        "noise_mm": noise.sample_mm,
        "reading_noise_mm": noise.reading_mm,
        "ringing": ringing and asdict(ringing),
        "max_deflection_mm": surface.travel.largest_mm,
        "negligible": NEGLIGIBLE,
    }
    edges = bands_of(surface, zones) if zones else []
    if options.zones:
        fields["zones"] = [edge._asdict() for edge in edges]
    rows: list[Block] = [
        _table(effects),
        f"price: in units of a sample's noise, {digits(noise.sample_mm, 3)} mm; effects below {NEGLIGIBLE:g} are left "
        f"out\nwith/without: measured time to compute an influence matrix of {SENSORS} sensors",
        *(told(ringing) if ringing else []),
        *(zone_rows(edges) if edges else []),
    ]
    show(Result(fields, rows), as_json=options.json)


def _table(effects: list[tuple[Effect, tuple[float, float] | None]]) -> Table:
    rows = []
    for effect, cost in effects:
        price = "-" if effect.price is None else digits(effect.price, 3)
        timed = "-" if cost is None else f"{cost[0]:.0f}/{cost[1]:.0f} us"
        rows.append((effect.name, price, effect.verdict, timed, effect.reason))
    return Table(("effect", "price", "", "with/without", "remark"), rows, text=("", "remark"))


def _cost_us(effect: Effect) -> tuple[float, float] | None:
    """Return the time of an influence matrix with and without the effect, in us; None if the effect changes nothing."""
    if effect.having is None or effect.lacking is None:
        return None
    return _matrix_us(effect.having), _matrix_us(effect.lacking)


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


def _as_json(effect: Effect, cost: tuple[float, float] | None) -> dict[str, Any]:
    return {
        "name": effect.name,
        "price": effect.price,
        "included": effect.verdict == "in",
        "verdict": effect.verdict,
        "cost_us": None if cost is None else cost[0] - cost[1],
        "with_us": None if cost is None else cost[0],
        "without_us": None if cost is None else cost[1],
        "reason": effect.reason,
    }
