"""From an exact to an open force: error over limit, intervals, and what contradicts the force; minutes.

Error and coverage at the noise that a model is made for; what contradicts it, in settled samples, beside the largest
power of a test that knows what happened.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np
from scipy.special import chdtrc, chdtri

from beamtouch_models import Model, resolve
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.thresholds import left_by_contact
from beamtouch_models.design.scene import load_scene
from beamtouch_models.lab.challenge.challenge import distances, power_of_shift
from beamtouch_models.lab.challenge.play import SimulatedSurface
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.force_range import ForceRange
from support.surfaces.example_scenes import SCENES

LAYOUTS = {
    "paper, 2 sensors": [133.0, 267.0],
    "paper, 4 sensors": [100.0, 166.0, 235.0, 300.0],
    "bench, 4 sensors": [80.0, 160.0, 240.0, 320.0],
}
FORCES: dict[str, tuple[object, float | None]] = {
    f"10 N within {percent:g} %": (10.0, percent) for percent in (0.0, 0.01, 0.1, 1.0, 5.0, 20.0)
} | {
    "6 to 14 N": ((6.0, 14.0), None),
    "2 to 20 N": ((2.0, 20.0), None),
}
DRAWS, NOTICES, HONEST = 4000, 400, 20_000
RARE = 0.01


def main() -> None:
    """Print a line for each layout and force."""
    for name, layout in LAYOUTS.items():
        scene, _ = load_scene(SCENES / f"{name.split(',')[0]}.toml")
        for force, (force_n, percent) in FORCES.items():
            stated = {"force_n": force_n, "force_tolerance_percent": percent}
            changed = scene.model_copy(update={"contact": scene.contact.model_copy(update=stated)})
            surface = resolve(changed)
            model = surface.layout(layout).build("known", effort=0.1)
            print(f"{name}, {force}:", *_figures(model, surface.prior(np.array(layout))), flush=True)


def _figures(model: Model, prior: Prior) -> list[str]:
    found, rng = model.evaluate(draws=DRAWS), np.random.default_rng(0)
    assert found.span.ratio is not None
    assert found.position_coverage is not None
    assert found.position_width_mm is not None
    place, ends = prior.extent.uniform(DRAWS, rng), []
    for force_n in prior.force_n:
        answers = _answers(model, prior, prior.draw(place, np.full(DRAWS, force_n), rng))
        is_held = (answers["position_low_mm"] <= place[:, 0]) & (place[:, 0] <= answers["position_high_mm"])
        ends.append(f"{is_held.mean():.1%}")
    return [
        f"error over limit {found.span.ratio.value:.3f}, held {found.position_coverage.value:.1%}, at the ends",
        *ends,
        f"width {found.position_width_mm.value:.3g} mm; noticed of power:",
        *_noticed(model, prior, rng),
    ]


def _noticed(model: Model, prior: Prior, rng: np.random.Generator) -> list[str]:
    surface, thresholds = SimulatedSurface.of(model.metadata), model.metadata.thresholds
    settled = prior.at_noise(surface.min_noise_mm)
    left = left_by_contact(prior.channels, ForceRange(*prior.force_n).checked)
    alpha = float(chdtrc(left, thresholds.misfit[-1]))

    def under(force_n: float, *places_mm: float) -> Floats:
        shown: Floats = force_n * prior.influence_at(on_axis(np.array(places_mm))).mean(axis=0, keepdims=True)
        return shown

    loads = {
        "12 N at 60": under(12, 60),
        "at 130": under(12, 130),
        "5 N at 100 and 300": under(10, 100, 300),
        "at 150 and 250": under(10, 150, 250),
        "10 N over 100 to 300": under(10, *np.linspace(100, 300, 65)),
    }
    said = []
    for load, shown in loads.items():
        clean = np.repeat(shown, NOTICES, axis=0)
        sample = clean + rng.normal(size=clean.shape) * settled.errors.deviation_mm(clean)
        rest = ((sample / settled.errors.deviation_mm(sample)) ** 2).sum(axis=1)
        is_odd = (rest > thresholds.rest[-1]) & (_answers(model, settled, sample)["misfit"] > thresholds.misfit[-1])
        power = power_of_shift(distances(surface, shown, np.ones(shown.shape, np.bool_)), alpha)
        said.append(f"{load} {is_odd.mean():.0%}/{power:.0%};")
    place, force = settled.extent.uniform(HONEST, rng), rng.uniform(*settled.force_n, HONEST)
    misfit = _answers(model, settled, settled.draw(place, force, rng))["misfit"]
    return [*said, f"honest beyond {RARE:.0%}: {(misfit > chdtri(left, RARE)).mean():.2%}"]


def _answers(model: Model, prior: Prior, deflection_mm: Floats) -> dict[str, Floats]:
    return model.answer(deflection_mm, prior.errors.noise_mm)


if __name__ == "__main__":
    main()
