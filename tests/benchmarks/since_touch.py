"""Error and coverage of the position since touch and under moving loads, beside the fixed filter.

`python tests/benchmarks/since_touch.py [--draws 300] [--scenes bench conveyor]`. Readings of simulated contacts
go through the daemon's filters, the model and the decision, as in `design-sensors challenge`. The simulation knows
nothing of the filters. Gains are perfect, or as far off as the scene of the model states.
"""

import argparse
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.building.build import build
from beamtouch_models.challenge.honest import _inertia_mm
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
SPEEDS_MM_PER_S = (3, 10, 30, 100, 300, 1000)
LYING_S = 0.4
"""Time that a load lies still before it moves."""
MOVES_S = 0.6
STEPS = 8
"""Steps per reading in which the inertia of the beam is followed."""
Course = Callable[[SimulatedSurface, int, np.random.Generator], tuple[Floats, Floats, Bools]]
"""Position and force at each reading of each draw, NaN without a contact, and which readings are judged."""


def made(scene: str, gain_percent: float, folder: Path, *, perfect_zeros: bool) -> ModelFile:
    """Return the model of a scene whose gains are as far off; its zeros are perfect, or drift as the scene states."""
    text = (SCENES / f"{scene}.toml").read_text()
    text = re.sub(r"gain_error_percent = \S+", f"gain_error_percent = {gain_percent}", text)
    if perfect_zeros:
        text = re.sub(r"zero_drift_mm = \S+", "zero_drift_mm = 0.0", text)
    path = folder / f"{scene}-{gain_percent}-{perfect_zeros}.onnx"
    if not path.exists():
        path.write_bytes(build(parse_scene(text, scene), text, scene, count=None, seed=0, progress=silent).content)
    return load(path)


def surfaces_of(model: ModelFile) -> dict[str, SimulatedSurface]:
    """Return the surface of a model behind its own filter, and behind the fixed one of the same latency."""
    surface = SimulatedSurface.of(model.metadata)
    fixed = window_filter(surface.scene, model.metadata.filter.window)
    return {
        "growing": surface,
        "fixed": replace(surface, metadata=model.metadata.model_copy(update={"filter": fixed})),
    }


def since_touch(model: ModelFile, draws: int, seed: int) -> Iterator[dict[str, object]]:
    """Return error and coverage by the time since the first loaded reading."""
    for name, surface in surfaces_of(model).items():
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


def courses() -> dict[str, Course]:
    """Return the courses of moving loads."""
    found: dict[str, Course] = {f"moves at {speed} mm/s": partial(slides, speed=speed) for speed in SPEEDS_MM_PER_S}
    found |= {"slide and stop": partial(slides, speed=100, stops=True), "swings": swings, "steps of force": force_steps}
    return found | {"chatters": chatters, "rests after a period": rests}


def slides(
    surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, speed: float, stops: bool = False
) -> tuple[Floats, Floats, Bools]:
    """Return loads that lie still, move, and stop."""
    low, high = surface.metadata.ranges.position_mm
    rate_hz = surface.metadata.sensor.rate_hz
    lying = round(LYING_S * rate_hz)
    moving = max(2, round(min(MOVES_S / (2 if stops else 1), 0.5 * (high - low) / speed) * rate_hz))
    after = round(MOVES_S * rate_hz) if stops else 0
    way = np.clip(np.arange(lying + moving + after) - lying + 1, 0, moving) * speed / rate_hz
    path = rng.uniform(low, high - way[-1], size=draws)[:, None] + way
    path = np.where(rng.random((draws, 1)) < 0.5, path, low + high - path)
    force = np.repeat(drawn(surface, draws, rng)[1][:, None], len(way), axis=1)
    judged = np.arange(len(way)) >= (lying + moving if stops else lying)
    return path, force, judged


def swings(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> tuple[Floats, Floats, Bools]:
    """Return loads that swing to and fro."""
    low, high = surface.metadata.ranges.position_mm
    rate_hz, amplitude = surface.metadata.sensor.rate_hz, 0.025 * (high - low)
    time = np.arange(round(1.4 * rate_hz)) / rate_hz
    phase = 2 * np.pi * (time * rng.uniform(0.5, 2, size=(draws, 1)) + rng.uniform(size=(draws, 1)))
    path = rng.uniform(low + amplitude, high - amplitude, size=(draws, 1)) + amplitude * np.sin(phase)
    return path, np.repeat(drawn(surface, draws, rng)[1][:, None], len(time), axis=1), time >= LYING_S


def force_steps(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> tuple[Floats, Floats, Bools]:
    """Return loads at one place whose force changes every 0.1 s."""
    rate_hz = surface.metadata.sensor.rate_hz
    each, count = round(0.1 * rate_hz), 12
    path = np.repeat(drawn(surface, draws, rng)[0][:, None], each * count, axis=1)
    force = np.repeat(rng.uniform(*surface.metadata.ranges.force_n, size=(draws, count)), each, axis=1)
    return path, force, np.arange(each * count) >= 2 * each


def chatters(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> tuple[Floats, Floats, Bools]:
    """Return loads that come and go, for 20 to 120 ms each."""
    rate_hz = surface.metadata.sensor.rate_hz
    readings = round(1.4 * rate_hz)
    lasting = rng.uniform(0.02, 0.12, size=(draws, 100)).cumsum(axis=1)
    time = np.arange(readings) / rate_hz
    there = np.array([np.searchsorted(one, time) % 2 == 1 for one in lasting])
    position, force = drawn(surface, draws, rng)
    return np.where(there, position[:, None], np.nan), np.where(there, force[:, None], 0.0), time >= LYING_S


def rests(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> tuple[Floats, Floats, Bools]:
    """Return loads that have rested for the slowest period of the beam."""
    position, force = drawn(surface, draws, rng)
    rate_hz = surface.metadata.sensor.rate_hz
    readings, begin = round(1.2 * rate_hz), 20
    there = np.arange(readings) >= begin
    judged = np.arange(readings) >= begin + max(surface.slowest_period, 10)
    return np.where(there, position[:, None], np.nan), there * force[:, None], judged


def moving(model: ModelFile, draws: int, seed: int, only: str = "") -> Iterator[dict[str, object]]:
    """Return error and coverage under loads that move."""
    for number, (course, make) in enumerate(courses().items()):
        if only not in course:
            continue
        for name, surface in surfaces_of(model).items():
            rng = np.random.default_rng([seed, 2, number])
            path, force, judged = make(surface, draws, rng)
            if "moves" in course or "slide" in course or "swings" in course:
                deflection = followed(surface, path, force)
            else:
                deflection = surface.under(np.nan_to_num(path, nan=sum(surface.metadata.ranges.position_mm) / 2), force)
            readings = surface.readings(deflection, surface.honest(draws, rng), rng)
            said = judge(surface, model.run, readings).at(np.flatnonzero(judged).tolist())
            yield {"course": course, "filter": name, **figures(surface, said, path[:, judged].ravel())}


def followed(surface: SimulatedSurface, path: Floats, force: Floats) -> Floats:
    """Return deflections of the beam that follows a load with its inertia."""
    deflection = surface.under(path, force)
    if surface.modes is None or surface.mode_shapes is None:
        return deflection
    readings = np.arange(path.shape[1])
    fine = np.linspace(0, path.shape[1] - 1, (path.shape[1] - 1) * STEPS + 1)
    fine_path = np.array([np.interp(fine, readings, one) for one in path])
    target = surface.mode_shapes(fine_path) * force[:, :1, None]
    step_s = 1 / surface.metadata.sensor.rate_hz / STEPS
    inertia: Floats = _inertia_mm(surface.modes, surface.sensor_mm, target, step_s)
    deflection[:, -inertia.shape[1] :] += inertia
    return deflection


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
    options = parser.parse_args()
    for scene in options.scenes:
        for gain in options.gains:
            perfect = options.perfect_zeros or gain == 0
            model = made(scene, gain, options.models, perfect_zeros=perfect)
            if options.part != "moving":
                for row in since_touch(model, options.draws, options.seed):
                    print(said_of({"scene": scene, "gains": gain} | row), flush=True)
            if options.part != "touch" and gain in (0.3,):
                for row in moving(model, options.draws // 4, options.seed, options.only):
                    print(said_of({"scene": scene, "gains": gain} | row), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
