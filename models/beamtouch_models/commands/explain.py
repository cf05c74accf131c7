"""`design-sensors explain`: the price of each physical effect in a scene, and the time that modelling it costs."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamtouch_common.digits import digits
from beamtouch_models.commands.options import add_json
from beamtouch_models.commands.printing import Block, Table, show

if TYPE_CHECKING:
    from beamtouch_models.metadata import Noise
    from beamtouch_models.pricing.effect import Effect
    from beamtouch_models.pricing.ringing import Ringing
    from beamtouch_models.scene import Scene

REPEATS = 5
SENSORS = 101
"""Sensors in the influence matrix whose computation is timed."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    add_json(parser)


def run(options: argparse.Namespace) -> None:
    """Price the effects, measure the time that each costs, and print both."""
    from beamtouch_models.building.placed import placed
    from beamtouch_models.building.remarks import remarks
    from beamtouch_models.physics.beam import max_deflection_mm
    from beamtouch_models.pricing.effects import effects_of
    from beamtouch_models.pricing.noise import choose_filter, noise_of
    from beamtouch_models.pricing.ringing import ringing_of
    from beamtouch_models.scene import load_scene

    scene, _ = load_scene(options.scene)
    for remark in remarks(scene):
        print(f"note:    {remark}", file=sys.stderr)
    chosen = choose_filter(scene)
    placed(scene, chosen)  # refuses what `build` refuses
    effects = tuple((effect, _cost_us(effect)) for effect in effects_of(scene, chosen))
    explained = Explained(effects, noise_of(scene, chosen), ringing_of(scene, chosen), max_deflection_mm(scene))
    show(explained, as_json=options.json)


@dataclass(frozen=True)
class Explained:
    """The effects of a scene, each with the times of an influence matrix with and without it, in us."""

    effects: tuple[tuple[Effect, tuple[float, float] | None], ...]
    noise: Noise
    ringing: Ringing | None
    max_deflection_mm: float

    def rows(self) -> Iterator[Block]:
        """Return the table of prices, what they mean, and how long the beam rings."""
        from beamtouch_models.pricing.effect import NEGLIGIBLE
        from beamtouch_models.pricing.ringing import told

        rows = []
        for effect, cost in self.effects:
            price = "-" if effect.price is None else digits(effect.price, 3)
            timed = "-" if cost is None else f"{cost[0]:.0f}/{cost[1]:.0f} us"
            rows.append((effect.name, price, effect.verdict, timed, effect.reason))
        yield Table(("effect", "price", "", "with/without", "remark"), rows, text=("", "remark"))
        noise = f"a sample's noise, {digits(self.noise.sample_mm, 3)} mm"
        yield f"price: in units of {noise}; effects below {NEGLIGIBLE:g} are left out"
        yield f"with/without: measured time to compute an influence matrix of {SENSORS} sensors"
        yield from told(self.ringing) if self.ringing else []

    def to_json(self) -> dict[str, Any]:
        """Return prices, times and ringing."""
        from beamtouch_models.pricing.effect import NEGLIGIBLE

        return {
            "effects": [_as_json(effect, cost) for effect, cost in self.effects],
            "noise_mm": self.noise.sample_mm,
            "reading_noise_mm": self.noise.reading_mm,
            "ringing": self.ringing and asdict(self.ringing),
            "max_deflection_mm": self.max_deflection_mm,
            "negligible": NEGLIGIBLE,
        }


def _cost_us(effect: Effect) -> tuple[float, float] | None:
    """Return the time of an influence matrix with and without the effect, in us; None if the effect changes nothing."""
    if effect.having is None or effect.lacking is None:
        return None
    return _matrix_us(effect.having), _matrix_us(effect.lacking)


def _matrix_us(scene: Scene) -> float:
    import numpy as np

    from beamtouch_models.physics.beam import load_positions_mm, scene_influence
    from beamtouch_models.physics.mesh import mesh_of

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
