"""`design-sensors explain`: the price of each physical effect in a scene, and the time that modelling it costs."""

import argparse
import json
import sys
import time
from dataclasses import asdict
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from beamtouch_common.digits import digits
from beamtouch_models.building.placed import placed
from beamtouch_models.building.remarks import remarks
from beamtouch_models.physics.beam import load_positions_mm, max_deflection_mm, scene_influence
from beamtouch_models.physics.mesh import mesh_of
from beamtouch_models.pricing.effect import NEGLIGIBLE, Effect
from beamtouch_models.pricing.effects import effects_of
from beamtouch_models.pricing.noise import choose_filter, noise_of
from beamtouch_models.pricing.ringing import ringing_of, told
from beamtouch_models.scene import Scene, load_scene

REPEATS = 5
WIDTH_WITHOUT_TERMINAL = 120
SENSORS = 101
"""Sensors in the influence matrix whose computation is timed."""


def run(options: argparse.Namespace) -> None:
    """Price the effects, measure the time that each costs, and print both."""
    scene, _ = load_scene(options.scene)
    for remark in remarks(scene):
        print(f"note:    {remark}", file=sys.stderr)
    chosen = choose_filter(scene)
    placed(scene, chosen)  # refuses what `build` refuses
    noise = noise_of(scene, chosen)
    effects = [(effect, _cost_us(effect)) for effect in effects_of(scene, chosen)]
    ringing = ringing_of(scene, chosen)
    if not options.json:
        _print_table(effects, noise.sample_mm)
        print("\n".join(told(ringing) if ringing else []))
        return
    explained = {
        "effects": [_as_json(effect, cost) for effect, cost in effects],
        "noise_mm": noise.sample_mm,
        "reading_noise_mm": noise.reading_mm,
        "ringing": ringing and asdict(ringing),
        "max_deflection_mm": max_deflection_mm(scene),
        "negligible": NEGLIGIBLE,
    }
    print(json.dumps(explained))


def _cost_us(effect: Effect) -> tuple[float, float] | None:
    """Return the time of an influence matrix with and without the effect, in us; None if the effect changes nothing."""
    if effect.having is None or effect.lacking is None:
        return None
    return _matrix_us(effect.having), _matrix_us(effect.lacking)


def _matrix_us(scene: Scene) -> float:
    sensors, loads = np.linspace(0.0, scene.beam.length_mm, SENSORS), load_positions_mm(scene)
    least = float("inf")
    for _ in range(REPEATS):
        mesh_of.cache_clear()  # the time includes the assembly
        start = time.perf_counter()
        scene_influence(scene, sensors, loads)
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


def _print_table(effects: list[tuple[Effect, tuple[float, float] | None]], noise_mm: float) -> None:
    table = Table(box=None, pad_edge=False)
    table.add_column("effect")
    table.add_column("price", justify="right")
    table.add_column("")
    table.add_column("with/without", justify="right")
    table.add_column("remark", overflow="fold")  # an ellipsis would hide the name of a key
    for effect, cost in effects:
        price = "-" if effect.price is None else digits(effect.price, 3)
        timed = "-" if cost is None else f"{cost[0]:.0f}/{cost[1]:.0f} us"
        table.add_row(effect.name, price, effect.verdict, timed, effect.reason)
    console = Console(highlight=False, width=None if sys.stdout.isatty() else WIDTH_WITHOUT_TERMINAL)
    console.print(table)
    unit = f"a sample's noise, {digits(noise_mm, 3)} mm"
    console.print(f"price: in units of {unit}; effects below {NEGLIGIBLE:g} are left out")
    console.print(f"with/without: measured time to compute an influence matrix of {SENSORS} sensors")
