"""Error and coverage of the position since touch and under moving loads, beside the fixed filter.

`python tests/benchmarks/since_touch.py [--draws 300] [--scenes bench conveyor]`. Readings of simulated contacts
go through the daemon's filters, the model and the decision, as in `design-sensors challenge`. The simulation knows
nothing of the filters. Gains are perfect, or as far off as the scene of the model states.
"""

import argparse
import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np
from load_courses import FOLLOWED, courses, followed

from beamtouch_models.arrays import Floats
from beamtouch_models.building.build import build_model
from beamtouch_models.challenge.judge import Judged, Said, judge
from beamtouch_models.challenge.play import drawn
from beamtouch_models.challenge.surface import SimulatedSurface
from beamtouch_models.modelfile import ModelFile, load
from beamtouch_models.pricing.noise import window_filter
from beamtouch_models.progress import silent
from beamtouch_models.scene import parse_scene
from example_scenes import SCENES

SINCE_MS = (0, 5, 10, 20, 45, 95, 195, 495, 995)
GAINS_PERCENT = (0.0, 0.3, 1.0)


def made(scene: str, gain_percent: float, folder: Path, *, perfect_zeros: bool) -> ModelFile:
    """Return the model of a scene whose gains are as far off; its zeros are perfect, or drift as the scene states."""
    text = (SCENES / f"{scene}.toml").read_text()
    text = re.sub(r"gain_error_percent = \S+", f"gain_error_percent = {gain_percent}", text)
    if perfect_zeros:
        text = re.sub(r"zero_drift_mm = \S+", "zero_drift_mm = 0.0", text)
    path = folder / f"{scene}-{gain_percent}-{perfect_zeros}.onnx"
    if not path.exists():
        path.write_bytes(
            build_model(parse_scene(text, scene), text, scene, count=None, seed=0, progress=silent).content
        )
    return load(path)


def surfaces_of(model: ModelFile) -> dict[str, SimulatedSurface]:
    """Return the surface of a model behind its own filter, and behind the fixed one of the same latency."""
    surface = SimulatedSurface.of(model.metadata)
    fixed = window_filter(surface.scene, model.metadata.filter.window, model.metadata.noise.reading_mm)
    return {
        "growing": surface,
        "fixed": replace(surface, metadata=model.metadata.model_copy(update={"filter": fixed})),
    }


def since_touch(model: ModelFile, draws: int, seed: int, filters: list[str]) -> Iterator[dict[str, object]]:
    """Return error and coverage by the time since the first loaded reading."""
    for name, surface in surfaces_of(model).items():
        if name not in filters:
            continue
        rng = np.random.default_rng([seed, 1])
        rate_hz = model.metadata.sensor.rate_hz
        position, force = drawn(surface, draws, rng)
        before = 50
        at = {ms: before + round(ms * 1e-3 * rate_hz - 1e-9) for ms in SINCE_MS}
        there = np.arange(max(at.values()) + 1) >= before
        deflection = surface.under(position, force)[:, None] * there[:, None]
        readings = surface.readings(deflection, surface.honest(draws, rng), rng)
        said = judge(surface, model.run, readings)
        for ms, reading in at.items():
            part = said.at([reading])
            yield {"filter": name, "ms": ms, **figures(surface, part, position)}


def figures(surface: SimulatedSurface, said: Judged, truth_mm: Floats) -> dict[str, float]:
    """Return what is said of samples (samples,) against the truth, NaN where there is no contact."""
    contact = said.said == Said.CONTACT
    single = contact & ~np.isnan(truth_mm)
    inside = (said.low_mm <= truth_mm) & (truth_mm <= said.high_mm)
    plain = contact & ~said.unsteady & ~said.other_note
    half = np.where(truth_mm > said.position_mm, said.high_mm - said.position_mm, said.position_mm - said.low_mm)
    misleads = plain & ~(np.abs(said.position_mm - truth_mm) <= 2 * half)
    error = np.abs(said.position_mm - truth_mm)
    return {
        "error %": 100 / surface.beam.length_mm * float(error[single].mean()) if single.any() else np.nan,
        "held": float(inside[single].mean()) if single.any() else np.nan,
        "held plain": float(inside[single & plain].mean()) if (single & plain).any() else np.nan,
        "held unsteady": float(inside[single & ~plain].mean()) if (single & ~plain).any() else np.nan,
        "unsteady": float((contact & said.unsteady).mean()),
        "contact": float(contact.mean()),
        "misleading": float(misleads.mean()),
        "interval %": 100 / surface.beam.length_mm * float(np.median((said.high_mm - said.low_mm)[contact]))
        if contact.any()
        else np.nan,
    }


def moving(model: ModelFile, draws: int, seed: int, only: str = "") -> Iterator[dict[str, object]]:
    """Return error and coverage under loads that move."""
    for number, (course, make) in enumerate(courses().items()):
        if only not in course:
            continue
        for name, surface in surfaces_of(model).items():
            rng = np.random.default_rng([seed, 2, number])
            path, force, judged = make(surface, draws, rng)
            if course.startswith(FOLLOWED):
                deflection = followed(surface, path, force)
            else:
                deflection = surface.under(np.nan_to_num(path, nan=sum(surface.metadata.ranges.position_mm) / 2), force)
            readings = surface.readings(deflection, surface.honest(draws, rng), rng)
            said = judge(surface, model.run, readings).at(np.flatnonzero(judged).tolist())
            yield {"course": course, "filter": name, **figures(surface, said, path[:, judged].ravel())}


def said_of(row: dict[str, object]) -> str:
    """Return a row as text."""
    return "  ".join(f"{key} {value:.3g}" if isinstance(value, float) else f"{value}" for key, value in row.items())


def main() -> int:
    """Print a row per time and per course; returns 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=300, metavar="N", help="contacts per row (300)")
    parser.add_argument("--scenes", nargs="+", default=["bench", "conveyor"], metavar="SCENE")
    parser.add_argument("--gains", nargs="+", type=float, default=GAINS_PERCENT, metavar="PERCENT")
    parser.add_argument("--models", type=Path, default=Path(), metavar="FOLDER", help="where models are kept")
    parser.add_argument("--perfect-zeros", action="store_true", help="zeros without drift; always with perfect gains")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--part", choices=("touch", "moving"), help="only this part")
    parser.add_argument("--only", default="", metavar="TEXT", help="only courses with this in their name")
    parser.add_argument("--filters", nargs="+", default=["growing", "fixed"], choices=("growing", "fixed"))
    options = parser.parse_args()
    for scene in options.scenes:
        for gain in options.gains:
            perfect = options.perfect_zeros or gain == 0
            model = made(scene, gain, options.models, perfect_zeros=perfect)
            if options.part != "moving":
                for row in since_touch(model, options.draws, options.seed, options.filters):
                    print(said_of({"scene": scene, "gains": gain} | row), flush=True)
            if options.part != "touch" and gain in (0.3,):
                for row in moving(model, options.draws // 4, options.seed, options.only):
                    print(said_of({"scene": scene, "gains": gain} | row), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
