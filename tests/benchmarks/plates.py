"""Figures of plates, for `docs/figures.md`: on springs and on rigid corners, of three sizes.

    python tests/benchmarks/plates.py [--effort 0.25] [--rest 2000000] [--contacts 4000]

A table of error, limit, coverage by axis, smallest force and false contacts at rest, and one of coverage by place and
by force. Contacts are drawn at random from the ranges, samples are as settled; their answers are those of the built
graph, through the error model of the service. False contacts at rest: samples at rest with all errors of noise and zero
whose log odds exceed the threshold of touch, over the rate per sample that the threshold is for. As these are rare, the
threshold is that of a rate of 1 in 1000 here, made as `build` makes its own.
"""

import argparse
import time

import numpy as np

from beamtouch_models.design.accuracy.thresholds import directions, log_odds, shapes_at_rest, touch_thresholds
from beamtouch_models.design.layout import Layout
from beamtouch_models.design.model import Model
from beamtouch_models.design.scene import parse_scene
from beamtouch_models.design.surface import resolve

SIZES = ((200, 150), (400, 300), (800, 600))
"""Sides in mm."""
THICKNESS_MM = {200: 1.5, 400: 3, 800: 6}
STIFFNESS_N_PER_MM = {"springs": 15, "rigid": None}
FORCES_N, INSIDE_MM = (2.0, 20.0), 10
RATE = 1e-3
CHUNK = 50_000


def scene_of(size_mm: tuple[int, int], supports: str) -> str:
    """Return the scene of a plate as text."""
    (x, y), stiffness = size_mm, STIFFNESS_N_PER_MM[supports]
    springs = "" if stiffness is None else f"support_stiffness_n_per_mm = {stiffness}\n"
    return (
        f'[plate]\nlength_x_mm = {x}\nlength_y_mm = {y}\nthickness_mm = {THICKNESS_MM[x]}\nmaterial = "steel"\n'
        f'supports = "corners"\n{springs}'
        f"[contact]\nforce_n = {list(FORCES_N)}\nx_mm = [{INSIDE_MM}, {x - INSIDE_MM}]\n"
        f"y_mm = [{INSIDE_MM}, {y - INSIDE_MM}]\n"
        "[sensors]\ncount = 4\nnoise_mm = 0.002\nrate_hz = 200\nrange_mm = [1, 6]\nsize_mm = 12\n"
        '[requirements]\nlatency_ms = 50\ndescriptors = ["position", "force"]\n'
    )


def coverage(layout: Layout, model: Model, count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return places (contacts, 2), forces (contacts,) and whether intervals hold the place, and the force, (.., 3)."""
    rng, extent = np.random.default_rng(seed), layout.prior.extent
    place, force = extent.uniform(count, rng), rng.uniform(*FORCES_N, size=count)
    answers = model.estimate(layout.simulate(place, force, seed=seed))
    truth = {"x": place[:, 0], "y": place[:, 1], "force": force}
    units = {"x": "mm", "y": "mm", "force": "n"}
    held: list[np.ndarray] = []
    for name, true in truth.items():
        low, high = (answers[f"{name}_{end}_{units[name]}"] for end in ("low", "high"))
        held.append((low <= true) & (true <= high))
    return place, force, np.stack(held, axis=1)


def rest_ratio(layout: Layout, count: int, seed: int) -> tuple[float, float]:
    """Return how often samples at rest exceed a threshold of touch, over the rate that it is for, and its error."""
    prior, rng = layout.prior, np.random.default_rng(seed)
    threshold, unit = touch_thresholds(prior, RATE)[-1], directions(shapes_at_rest(prior))
    beyond = 0
    for _ in range(count // CHUNK):
        noise = rng.normal(size=(CHUNK, prior.channels)) * prior.errors.noise_mm
        zero = rng.uniform(-1, 1, size=(CHUNK, prior.channels)) * np.sqrt(3) * prior.errors.zero_mm
        # A direction beyond the threshold is needed, which hardly any sample has.
        sample = (noise + zero) / prior.rest_mm
        loud = sample[np.square(sample).sum(axis=1) > 2 * threshold * 0.9]
        beyond += int((log_odds(unit, loud) > threshold).sum())
    return beyond / count / RATE, np.sqrt(max(beyond, 1)) / count / RATE


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--effort", type=float, default=0.25)
    parser.add_argument("--rest", type=int, default=2_000_000)
    parser.add_argument("--contacts", type=int, default=4_000)
    options = parser.parse_args()
    for supports in STIFFNESS_N_PER_MM:
        for size in SIZES:
            begun = time.process_time()
            layout = resolve(parse_scene(scene_of(size, supports), "plate")).place(effort=options.effort)
            placed = time.process_time()
            model = layout.build("plate", effort=options.effort)
            built = time.process_time()
            accuracy, smallest = model.metadata.accuracy, model.metadata.smallest_force.force_n
            mm = layout.prior.diagonal_mm / 100
            seen = [force for force in smallest if force is not None]
            place, force, held = coverage(layout, model, options.contacts, 5)
            ratio, error = rest_ratio(layout, options.rest, 6)
            share = 100 * held.mean(axis=0)
            places = ", ".join(f"({x:g}, {y:g})" for x, y in layout.positions_mm)
            print(
                f"| {supports} | {size[0]} x {size[1]} x {THICKNESS_MM[size[0]]} | {places} "
                f"| {accuracy.error_percent * mm:.3g} mm ({accuracy.error_percent:.3g} %) | {accuracy.ratio:.3f} ± "
                f"{accuracy.ratio_standard_error:.3f} | {share[0]:.1f} | {share[1]:.1f} | {share[2]:.1f} "
                f"| {min(seen):.2g} to {max(seen):.2g}{'' if len(seen) == len(smallest) else ', nowhere in places'} "
                f"| {ratio:.2f} ± {error:.2f} | {placed - begun:.0f} + {built - placed:.0f} s |",
                flush=True,
            )
            shares = (place - layout.prior.extent.low_mm) / layout.prior.extent.size_mm
            rim = np.abs(shares - 0.5).max(axis=1) > 0.45
            corner = (np.abs(shares - 0.5) > 0.4).all(axis=1)
            parts = {
                "rim": rim,
                "corners": corner,
                "middle": (np.abs(shares - 0.5) < 0.25).all(axis=1),
                **{f"{low:g} to {low + 6:g} N": (force >= low) & (force < low + 6) for low in (2.0, 8.0, 14.0)},
            }
            told = [f"{name} {100 * held[part][:, :2].mean():.1f}" for name, part in parts.items()]
            print("    ", "; ".join(told), flush=True)


if __name__ == "__main__":
    main()
