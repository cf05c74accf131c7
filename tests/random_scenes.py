"""Random scenes from the plausible to the absurd, and commands on them: a model or one line, never a traceback.

`python tests/random_scenes.py --scenes 1000 explain place` and `... --scenes 200 build calibrate` run each scene of
the seeds from `--first` on in this process, with warnings as errors, and print those that broke the promise. With
OPENBLAS_NUM_THREADS=1 in the environment it takes half the time on a busy machine.
"""

import argparse
import contextlib
import io
import json
import math
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from beamtouch_models import cli
from beamtouch_models.errors import SceneError
from beamtouch_models.loading import load
from beamtouch_models.physics.beam import travel_of
from beamtouch_models.rig.surface import Imperfections
from beamtouch_models.scene import Scene, parse_scene
from few_draws import short_work
from imperfect_surface import true_prior, write_readings

COMMANDS = ("explain", "place", "build", "calibrate")
SUPPORTS = ("simply-supported", "cantilever", "fixed-fixed", "propped")
Table = dict[str, Any]


def random_scene(seed: int) -> str:
    """Return the TOML text of a scene."""
    rng = np.random.default_rng(seed)
    length = _log(rng, 20, 5000)
    beam = _beam(rng, length)
    contact, sensors = _contact(rng, length, beam), _sensors(rng, length, beam)
    tables = {
        "beam": beam,
        "contact": contact,
        "sensors": sensors,
        "requirements": _requirements(rng, sensors["rate_hz"]),
    }
    if "drift_um_per_k" in tables["sensors"] or rng.random() < 0.1:
        tables["environment"] = {"temperature_range_k": [-_log(rng, 0.1, 60), _log(rng, 0.1, 60)]}
    tables["contact"]["force_n"] = _force(rng, tables)
    return tomli_w.dumps(tables)


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(f"{math.exp(rng.uniform(math.log(low), math.log(high))):.4g}")


def _beam(rng: np.random.Generator, length: float) -> Table:
    beam: Table = {"length_mm": length, "supports": _supports(rng, length)}
    thickness = _log(rng, length / 1000, length / 20)
    if rng.random() < 0.8:
        beam |= {"youngs_modulus_gpa": _log(rng, 1, 250), "width_mm": _log(rng, 5, 200), "thickness_mm": thickness}
        if rng.random() < 0.7:
            beam["density_kg_m3"] = _log(rng, 100, 20000)
        if rng.random() < 0.3:
            beam["shear_modulus_gpa"] = float(f"{beam['youngs_modulus_gpa'] * rng.uniform(0.1, 0.5):.4g}")
        if rng.random() < 0.3:
            edges = np.unique(np.round(rng.uniform(0.05, 0.95, rng.integers(1, 4)) * length, 2)).tolist()
            scales = (1.0, 0.5, 2.0, _log(rng, 0.1, 10))
            beam["segments"] = [
                {"to_mm": edge, "thickness_mm": float(f"{thickness * rng.choice(scales):.4g}")}
                for edge in [*edges, length]
            ]
    else:
        beam["flexural_rigidity_n_mm2"] = _log(rng, 1e2, 1e12)
    if rng.random() < 0.2 or beam["supports"] == []:
        beam["foundation_n_mm2"] = _log(rng, 1e-6, 1e2)
    if rng.random() < 0.3:
        beam["expansion_um_per_m_k"] = _log(rng, 0.1, 100)
    if rng.random() < 0.3:
        beam["damping_ratio"] = _log(rng, 1e-4, 0.5)
    return beam


def _supports(rng: np.random.Generator, length: float) -> str | list[Table]:
    if rng.random() < 0.5:
        return str(rng.choice(SUPPORTS))
    places = np.unique(np.round(rng.uniform(0, length, rng.integers(1, 6)), 1))
    if len(places) == 1 or rng.random() < 0.4:  # ends on supports; otherwise there are overhangs
        places = np.unique([0.0, *places, length])
    supports = []
    for at_mm in places.tolist():
        one: Table = {"at_mm": min(at_mm, length), "kind": str(rng.choice(["simple", "simple", "fixed"]))}
        if one["kind"] == "simple" and rng.random() < 0.2:
            one["fixity"] = float(f"{rng.uniform(0, 0.95):.3f}")
        if rng.random() < 0.3:
            one["slides"] = bool(rng.random() < 0.5)
        supports.append(one)
    return supports


def _contact(rng: np.random.Generator, length: float, beam: Table) -> Table:
    supports = beam["supports"]
    places = [0.0, length] if isinstance(supports, str) else [one["at_mm"] for one in supports]
    low, high = sorted(np.round(rng.uniform(0, length, 2), 1).tolist())
    if rng.random() < 0.6:
        low, high = [(0.0, length), (0.01 * length, 0.99 * length), (0.1 * length, 0.9 * length)][rng.integers(3)]
    elif places and rng.random() < 0.5:  # it may stand on a support
        low = min(float(rng.choice(places)), high)
    if not low < high:
        low, high = 0.0, length
    contact: Table = {"position_mm": [low, high]}
    if rng.random() < 0.2:
        contact["width_mm"] = _log(rng, length / 1000, length / 5)
    return contact


def _sensors(rng: np.random.Generator, length: float, beam: Table) -> Table:
    count = int(rng.integers(1, 9))
    sensors: Table = {
        "count": count,
        "rate_hz": _log(rng, 1, 5000),
        "grid_mm": float(f"{length / rng.integers(20, 200):.4g}"),
    }
    if rng.random() < 0.8:
        sensors["noise_percent_of_max"] = _log(rng, 1e-3, 10) if rng.random() < 0.9 else _log(rng, 1e-7, 100)
    else:
        sensors["noise_mm"] = _log(rng, 1e-5, 0.1)
    if rng.random() < 0.5:
        low = _log(rng, 0.1, 5)
        sensors["range_mm"] = [low, low + _log(rng, 0.5, 20)]
    for name, low, high, share in (
        ("gain_error_percent", 1e-3, 30, 0.4),
        ("zero_drift_mm", 1e-6, 0.3, 0.4),
        ("mounting_tolerance_mm", length / 1e4, length / 50, 0.2),
        ("drift_um_per_k", 1e-3, 50, 0.1),
        ("min_distance_mm", length / 1000, length / 8, 0.3),
        ("size_mm", length / 1000, length / 30, 0.7),
    ):
        if rng.random() < share:
            sensors[name] = 0.0 if rng.random() < (0.4 if name == "size_mm" else 0.15) else _log(rng, low, high)
    if rng.random() < 0.2:
        sensors["adc_bits"] = int(rng.integers(6, 17))
    if rng.random() < 0.25:
        starts = rng.uniform(0, length, rng.integers(1, 3))
        sensors["keep_out_mm"] = [[round(one, 1), round(one + rng.uniform(0.01, 0.3) * length, 1)] for one in starts]
    if rng.random() < 0.25 and "keep_out_mm" not in sensors:
        supports = beam["supports"]
        on = [0.0, length] if isinstance(supports, str) else [one["at_mm"] for one in supports]
        fixed = np.round(rng.uniform(0, length, rng.integers(1, count + 1)), 1).tolist()
        if on and rng.random() < 0.3:  # on a support, where nothing moves
            fixed[0] = float(rng.choice(on))
        sensors["fixed_mm"] = sorted(set(fixed))
    return sensors


def _requirements(rng: np.random.Generator, rate_hz: float) -> Table:
    found: Table = {}
    if rng.random() < 0.7:
        found["latency_ms"] = float(f"{_log(rng, 0.9, 1000) * 1e3 / rate_hz:.4g}")
    if rng.random() < 0.2:
        found["max_mean_ms"] = _log(rng, 1, 1e5)
    if rng.random() < 0.6:
        found["descriptors"] = ["position", "force"]
    if rng.random() < 0.2:
        found["false_contacts_per_day"] = _log(rng, 1e-6, 10)
    if rng.random() < 0.1:
        found["position_error_mm"] = _log(rng, 0.1, 100)
    return found


def _force(rng: np.random.Generator, tables: Table) -> float | list[float]:
    """Return the force: mostly one that deflects the beam by a part of the sensors' range, sometimes any."""
    strong = _log(rng, 1e-3, 1e5)
    if rng.random() < 0.93:
        tables["contact"]["force_n"] = 1.0
        try:
            per_n = travel_of(parse_scene(tomli_w.dumps(tables), "the scene")).largest_mm
            low, high = tables["sensors"].get("range_mm", (1.0, 4.0))
            limit = min(high - low, tables["beam"]["length_mm"] / 200)
            strong = float(f"{limit * rng.choice([0.001, 0.1, 0.5, 0.5, 0.8, 0.8, 0.8]) / per_n:.4g}")
        except (ValueError, SceneError, ZeroDivisionError):
            pass
    return strong if rng.random() < 0.3 else [float(f"{strong * rng.choice([0.001, 0.1, 0.5]):.4g}"), strong]


class BrokenError(Exception):
    """A command broke the promise; the message says how."""


def try_scene(seed: int, commands: Sequence[str], folder: Path, *, fast: bool = True) -> Iterator[tuple[str, str]]:
    """Yield each command with "done", or what it said in one line; raises BrokenError if it does neither.

    With `fast`, two of three scenes are placed by the quick criterion.
    """
    path, model = folder / "scene.toml", folder / "scene.onnx"
    path.write_text(random_scene(seed))
    for command in commands:
        output = ["-o", str(model)] if command == "build" else []
        if command == "calibrate":
            if not model.exists():
                continue
            arguments = [str(model), str(_loads(seed, model, folder)), "-o", str(folder / "fresh.onnx")]
        else:
            quick = ["--criterion", "eigenvalue-product"] if fast and command != "explain" and seed % 3 else []
            arguments = [str(path), *quick, *output]
        yield command, run_here([command, *arguments, "--json"])


def run_here(arguments: list[str]) -> str:
    """Run `design-sensors` here and return "done" or its refusal."""
    said, complained = io.StringIO(), io.StringIO()
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained):
            warnings.simplefilter("error")
            code = cli.main(arguments)
    except SystemExit as end:
        raise BrokenError(f"exit {end.code}: {complained.getvalue()}") from None
    except Exception:  # noqa: BLE001  # any one breaks the promise
        raise BrokenError("".join(traceback.format_exc().splitlines(keepends=True)[-9:])) from None
    lines = [line for line in complained.getvalue().splitlines() if not line.startswith("note: ")]
    if code == 0:
        try:
            json.loads(said.getvalue(), parse_constant=_refuse)
        except ValueError as error:
            raise BrokenError(f"output: {error}") from None
        return "done"
    lines = [line for line in lines if line.startswith("design-sensors: ")]
    if code not in (1, 2) or len(lines) != 1 or any(word in lines[0] for word in ("nan", "inf ", "Traceback")):
        raise BrokenError(f"exit {code}: {complained.getvalue()}")
    return f"exit {code}: {lines[0]}"


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is no JSON")


def _loads(seed: int, path: Path, folder: Path) -> Path:
    """Write recorded loads of a surface that departs from its scene, a little or a lot; returns their file."""
    rng, metadata = np.random.default_rng([seed, 1]), load(path).metadata
    scene = parse_scene(metadata.scene, "the scene")
    channels, size = len(metadata.layout), rng.choice([0.0, 0.3, 1.0, 3.0])
    fixity, supports = [0.0, 0.0], scene.beam.support_list
    if supports and supports[0].kind == "simple" and rng.random() < 0.5:
        fixity[0] = min(0.9, 0.05 * size)
    layout = np.array([channel.position_mm for channel in metadata.layout])
    moved = np.clip(layout + rng.normal(scale=size, size=channels), 0, metadata.length_mm)
    real = Imperfections(
        position_offset_mm=tuple((moved - layout).tolist()),
        gain=tuple(np.exp(rng.normal(scale=0.03 * size, size=channels)).tolist()),
        offset_mm=tuple(rng.normal(scale=3 * size * metadata.noise.reading_mm, size=channels).tolist()),
        fixity=(fixity[0], fixity[1]),
        rigidity=float(np.exp(rng.normal(scale=0.05 * size))),
    )
    count, (low, high) = int(rng.integers(3, 15)), metadata.ranges.position_mm
    places = np.sort(rng.uniform(low, high, count)) if rng.random() < 0.5 else np.linspace(low, high, count)
    forces = rng.uniform(*metadata.ranges.force_n, count)
    loads = folder / "loads.csv"
    if supports and rng.random() < 0.3:  # a support stands beside its place
        moved_scene = metadata.model_copy(update={"scene": _with_moved_support(scene, metadata.scene, rng)})
        prior = true_prior(moved_scene, Imperfections())
    else:
        prior = true_prior(metadata, real)
    write_readings(loads, metadata, prior, places, forces, seed=seed, samples=20)
    return loads


def _with_moved_support(scene: Scene, text: str, rng: np.random.Generator) -> str:
    """Return the text of a scene with a support some mm beside its place."""
    supports = [one.model_dump(exclude_none=True) for one in scene.beam.support_list]
    one = supports[int(rng.integers(len(supports)))]
    one["at_mm"] = float(np.clip(one["at_mm"] + rng.choice([-9.0, 9.0]), 0, scene.beam.length_mm))
    tables = scene.model_dump(exclude_none=True, exclude_unset=True)
    tables["beam"]["supports"] = supports
    try:
        return tomli_w.dumps(
            parse_scene(tomli_w.dumps(tables), "moved").model_dump(exclude_none=True, exclude_unset=True)
        )
    except ValueError:
        return text


def main() -> int:
    """Run commands on random scenes; returns 1 if one broke the promise."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commands", nargs="+", choices=COMMANDS)
    parser.add_argument("--scenes", type=int, default=100, metavar="N")
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="write the scenes that broke it there")
    parser.add_argument("--whole", action="store_true", help="the whole searches and all draws, which take minutes")
    options = parser.parse_args()
    counted: Counter[tuple[str, str]] = Counter()
    broken = 0
    for seed in range(options.first, options.first + options.scenes):
        started = time.perf_counter()
        work = contextlib.nullcontext() if options.whole else short_work()
        with tempfile.TemporaryDirectory() as folder, work:
            try:
                for command, said in try_scene(seed, options.commands, Path(folder), fast=not options.whole):
                    counted[command, said[:6]] += 1
                    if options.keep:
                        print(seed, command, said, flush=True)
            except BrokenError as error:
                broken += 1
                print(f"seed {seed} {error}", flush=True)
                if options.keep:
                    options.keep.mkdir(exist_ok=True)
                    (options.keep / f"{seed}.toml").write_text(random_scene(seed))
        if time.perf_counter() - started > 60:
            print(f"seed {seed} took {time.perf_counter() - started:.0f} s", flush=True)
    for (command, said), number in sorted(counted.items()):
        print(f"{command:<10} {said:<7} {number}")
    print(f"broken     {broken}")
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main())
