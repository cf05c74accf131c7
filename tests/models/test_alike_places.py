"""Places that bend the beam nearly alike, seen by quiet sensors: the posterior has narrow peaks far from each other."""

from typing import Any

import numpy as np
import pytest

from beamtouch_models import make_scene
from beamtouch_models.design.accuracy.drawing import draw
from beamtouch_models.design.accuracy.posterior import posterior_quantiles
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.estimators.posterior.cells import resolving_cells
from beamtouch_models.design.surface import resolve
from models.posterior_cases import answers_of, graph_of

Case = tuple[object, object, tuple[float, float], float, list[float], dict[str, float]]
"""Supports, force, range of positions, width of a contact, sensors, and their errors."""

SPANS = [{"at_mm": 0.0}, {"at_mm": 250.0}, {"at_mm": 400.0}]
OVERHANGS = [{"at_mm": 80.0}, {"at_mm": 320.0}]
HELD = [{"at_mm": 0.0, "kind": "fixed"}, {"at_mm": 240.0, "fixity": 0.4}]
FIVE = [40.0, 66.0, 152.0, 178.0, 218.0]
CASES: dict[str, Case] = {
    "either side of a support": (
        *(OVERHANGS, (0.2, 20.0), (0.0, 400.0), 80.0, [7.0, 193.0, 393.0]),
        {"noise_mm": 1e-4},
    ),
    "two places of a known force": (SPANS, (20.0, 20.0), (100.0, 398.0), 0.0, FIVE, {"noise_mm": 1e-5}),
    "sensors beside their positions": (
        *("fixed-fixed", (10.0, 30.0), (0.0, 360.0), 0.0, [60.0, 127.0, 160.0, 207.0, 380.0]),
        {"noise_mm": 1e-4, "gain_error_percent": 0.01, "mounting_tolerance_mm": 0.8},
    ),
    "beside a support within the range": (
        *(HELD, (10.0, 10.0), (0.0, 360.0), 0.0, [87.0, 167.0, 307.0, 393.0]),
        {"noise_mm": 3e-4, "gain_error_percent": 0.08},
    ),
}


def prior_of(case: Case) -> Prior:
    """The prior of a steel strip."""
    supports, force_n, position_mm, width_mm, sensors_mm, errors = case
    beam: dict[str, Any] = {"length_mm": 400.0, "youngs_modulus_gpa": 210.0, "width_mm": 25.0, "thickness_mm": 3.0}
    scene = make_scene(
        beam=beam | {"supports": supports},
        contact={"force_n": force_n, "position_mm": position_mm, "width_mm": width_mm},
        sensors={"count": len(sensors_mm), "size_mm": 0.0, **errors},
    )
    return resolve(scene).prior(np.array(sensors_mm))


@pytest.mark.parametrize("name", CASES)
def test_the_error_is_at_the_limit_and_intervals_hold_the_truth(name: str) -> None:
    prior = prior_of(CASES[name])
    assert resolving_cells(prior) is None  # so that windows are looked for
    drawn = draw(prior, 1500, 3)
    levels = np.tile([0.5, 0.025, 0.975], (len(drawn.position_mm), 1))

    answers = answers_of(graph_of(prior), prior, drawn.deflection_mm)
    median, low, high = posterior_quantiles(prior, drawn.deflection_mm, levels)[0].T

    error, least = (np.abs(place - drawn.position_mm).mean() for place in (answers["position_mm"], median))
    assert error < 1.05 * least
    found = {"limit": (low, high), "graph": (answers["position_low_mm"], answers["position_high_mm"])}
    for whose, (start, end) in found.items():
        held = ((start <= drawn.position_mm) & (drawn.position_mm <= end)).mean()
        assert 0.93 < held < 0.97, whose
