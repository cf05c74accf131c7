"""Figure 8: the position error of the paper's network with two to five sensors, beside the accuracy limit.

The networks learn from computed deflections without noise, as the paper's did. A simulated rig replaces the paper's;
its readings carry noise that the networks were not trained with. The paper's measurements stand beside ours. The same
networks also learn from noisy deflections, which shows what the training leaves out.
"""

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.drawing import Draws, draw
from beamtouch_models.design.accuracy.limit import accuracy_limit
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.charts import Chart, Series
from beamtouch_models.design.estimators.paper_network import MAX_EPOCHS, PaperNetwork, train
from beamtouch_models.design.physics.beam import influence_of
from beamtouch_models.design.placement.placing import place
from beamtouch_models.design.surface import resolve
from beamtouch_models.design.sweeps import Fraction, silent
from beamtouch_models.lab.reproduction.paper import (
    LENGTH_MM,
    LOADS_MM,
    SCENE,
    Figure,
    Numbers,
    deflection_mm,
    equal_pitch_mm,
    rounded,
)
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.error_model import Errors

COUNTS = (2, 3, 4, 5)
KINDS = ("equal", "optimised")
"""Layouts of each number of sensors: at equal pitch, and with the largest eigenvalue product."""
NETWORKS = 3
"""Networks trained for each layout, from different initial weights, because a single one is a matter of luck."""
DRAWS = 40_000
LIMIT_DRAWS = 8_192
"""The limit uses fewer contacts, evenly spread: a posterior costs a hundred times as much as a network's answer."""
NOISES_PERCENT = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.25, 1.5, 1.75, 2.0)
"""Standard deviations of a reading, in percent of the largest deflection. The last is that of the simulated rig."""
UNIT_MM = float(deflection_mm([LENGTH_MM / 2], [LENGTH_MM / 2])[0, 0]) / 100
"""A percent of the largest deflection."""
MEASURED_PERCENT = {(2, "equal"): 4.67, (2, "optimised"): 3.28, (5, "equal"): 3.13, (5, "optimised"): 3.16}
"""The paper's errors with its rig."""
TOLERANCE = 0.15
"""Largest relative difference from the paper's value that counts as agreement; two networks of one layout differ by a
fifth of it."""


Layouts = dict[tuple[int, str], Floats]
"""Positions of sensors, by their number and the kind of layout, in this order."""


def layouts_of(seed: int) -> Layouts:
    """Return the layouts of figure 8."""
    surface, layouts = resolve(SCENE), {}
    for count in COUNTS:
        layouts[count, "equal"] = equal_pitch_mm(count)
        layouts[count, "optimised"] = np.array(place(surface.influence, surface.rules, count, seed).positions_mm)
    return layouts


def measure(
    layouts: Layouts,
    seed: int,
    *,
    networks: int = NETWORKS,
    max_epochs: int = MAX_EPOCHS,
    progress: Fraction = silent,
) -> Numbers:
    """Train `networks` of the paper's networks for each layout, and as many with noise; return the errors of all.

    Lists have an entry for each layout; errors are in percent of the length, as in eq. 5.
    """
    rig_percent, influence = NOISES_PERCENT[-1], influence_of(SCENE)
    clean = [deflection_mm(positions_mm) for positions_mm in layouts.values() for _ in range(networks)]
    rng = np.random.default_rng([seed, 0])
    noisy = [clean_mm + rng.normal(scale=rig_percent * UNIT_MM, size=clean_mm.shape) for clean_mm in clean]
    trained = train([*clean, *noisy], LOADS_MM, LENGTH_MM, seed=seed, max_epochs=max_epochs, progress=progress)
    as_in_paper, with_noise = trained[: len(clean)], trained[len(clean) :]
    errors, noise_trained, limits = [], [], []
    for index, positions_mm in enumerate(layouts.values()):
        drawn = draw(Prior.of(influence, on_axis(positions_mm), Errors(0.0)), DRAWS, seed)
        noise_mm = np.random.default_rng([seed, len(positions_mm)]).normal(size=drawn.deflection_mm.shape) * UNIT_MM
        own = slice(index * networks, (index + 1) * networks)
        every = [
            [_error_percent(network, drawn, percent * noise_mm) for percent in NOISES_PERCENT]
            for network in as_in_paper[own]
        ]
        errors.append(every)
        noise_trained.append(
            np.mean([_error_percent(network, drawn, rig_percent * noise_mm) for network in with_noise[own]])
        )
        prior = Prior.of(influence, on_axis(positions_mm), Errors(rig_percent * UNIT_MM))
        limits.append(accuracy_limit(prior, LIMIT_DRAWS, seed))
    error_percent = np.mean(errors, axis=1)
    return {
        "layouts": list(layouts),
        "positions_mm": list(layouts.values()),
        "noise_percent": NOISES_PERCENT,
        "error_at_noise_percent": error_percent,
        "theoretical_percent": error_percent[:, 0],
        "rig_percent": error_percent[:, -1],
        "rig_spread_percent": np.std(errors, axis=1, ddof=min(networks - 1, 1))[:, -1],
        "noise_trained_percent": noise_trained,
        "limit_percent": [layout_limit.value for layout_limit in limits],
        "limit_standard_error": [layout_limit.standard_error for layout_limit in limits],
        "networks": len(as_in_paper),
        "reached": sum(network.outcome == "reached" for network in as_in_paper),
        "epochs": [end(network.epochs for network in as_in_paper) for end in (min, max)],
    }


def _error_percent(network: PaperNetwork, drawn: Draws, noise_mm: Floats) -> float:
    """Return the mean |error| of a network, eq. 5."""
    answer_mm = network.estimate_mm(drawn.deflection_mm + noise_mm)
    return float(np.abs(answer_mm - drawn.position_mm).mean() / LENGTH_MM * 100)


def figure_8(measured: Numbers) -> Figure:
    """Return figure 8 from what `measure` returns."""
    rig, limits, theory = (np.array(measured[f"{name}_percent"]) for name in ("rig", "limit", "theoretical"))
    paper_percent = np.array([MEASURED_PERCENT.get((count, kind), np.nan) for count in COUNTS for kind in KINDS])
    in_paper = ~np.isnan(paper_percent)
    # The noise that fits all four values of the paper best.
    ours, theirs = np.array(measured["error_at_noise_percent"])[in_paper], paper_percent[in_paper]
    nearest = int(np.abs(ours / theirs[:, None] - 1).max(axis=0).argmin())
    saved = (1 - rig[1::2] / rig[::2]) * 100
    numbers = measured | {
        "paper_percent": list(MEASURED_PERCENT.values()),
        "fitting_noise_percent": NOISES_PERCENT[nearest],
        "fitting_percent": ours[:, nearest],
        "saved_percent": saved,
        "limit_saved_percent": (1 - limits[1::2] / limits[::2]) * 100,
    }
    checks = {
        "trained": measured["reached"] == measured["networks"],
        "theory": bool(theory[:2].max() < 5),
        "rig": bool(rig[:2].max() < 5),
        "falling": bool((rig[2:] <= rig[:-2]).all()),
        "few": bool(saved[0] > 0 and saved[0] > saved[-1]),
        "two": bool(abs(saved[0] / 100 - (1 - paper_percent[1] / paper_percent[0])) < TOLERANCE),
    }
    for (count, kind), percent, value in zip(MEASURED_PERCENT, theirs, rig[in_paper], strict=True):
        checks[f"measured {count} sensors, {kind}"] = bool(abs(value / percent - 1) < TOLERANCE)
    series = []
    for colour, (kind, name) in enumerate(zip(KINDS, ("equal pitch", "optimised"), strict=True)):
        paper = [(count, value) for (count, its_kind), value in MEASURED_PERCENT.items() if its_kind == kind]
        points = [count for count, _ in paper], [value for _, value in paper]
        rig_noise = f"rig, {NOISES_PERCENT[-1]:g} % noise"
        series += [
            Series(f"{rig_noise}: {name}", COUNTS, rounded(rig[colour::2]), colour),
            Series(f"limit at that noise: {name}", COUNTS, rounded(limits[colour::2]), colour, "dashed"),
            Series(f"theory: {name}", COUNTS, rounded(theory[colour::2]), colour + 2),
            Series(f"measured by the paper: {name}", *points, colour, "points"),
        ]
    says = "Position error with two to five sensors, equal and optimised: in theory, on a simulated rig, and the limit"
    chart = Chart(
        says, "sensors", "mean |error|, % of the length", series, y_from_zero=True, x_range=(1.8, 5.2), whole_x=True
    )
    return Figure(8, "errors", chart, rounded(numbers), checks)
