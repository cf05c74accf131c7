"""What `design-sensors explain --zones` says of zones."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.zone_bands import band_at
from example_scenes import SCENES

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from subprocess import CompletedProcess

    from beamtouch_models.arrays import Floats


def _scales(load_mm: Floats) -> Floats:
    """A rigid bar on two springs of 1 N/mm at its ends: each carries the load by its lever."""
    share = load_mm / 100
    return np.stack([1 - share, share], axis=-1)


@pytest.mark.parametrize(("noise_mm", "width_mm"), [(0.05, 2.3284), (0.01, 0.46568)])
def test_the_band_of_a_bar_on_two_scales(noise_mm: float, width_mm: float) -> None:
    # Under F = 10 N, the position is l/2 (1 + (d2 - d1)/F), of deviation l s / (F sqrt(2)).
    # The band is 2 * 1.68 * 1.96 of it.
    prior = Prior(100.0, (0.0, 100.0), (10.0, 10.0), noise_mm, 2, _scales)
    band = band_at(prior, 40.0, 1)
    assert band.width_mm == pytest.approx(width_mm, rel=0.04)
    assert band.wrong <= 0.005


def test_explain_forecasts_each_edge_within_the_beam(
    design_sensors_here: Callable[..., CompletedProcess[str]], tmp_path: Path
) -> None:
    path = tmp_path / "zones.toml"
    path.write_text("[zones.left]\nfrom_mm = 0\nto_mm = 120\n[zones.gate]\nfrom_mm = 120\nto_mm = 380\n")
    scene = SCENES / "bench.toml"
    edges = json.loads(design_sensors_here("explain", scene, "--zones", path, "--json").stdout)["zones"]
    assert [(edge["zone"], edge["edge_mm"]) for edge in edges] == [("left", 120), ("gate", 120), ("gate", 380)]
    # Next to a support the beam says little of the place.
    assert edges[0]["unsure_mm"] == edges[1]["unsure_mm"] < edges[2]["unsure_mm"] / 2

    path.write_text("[zones.gate]\nfrom_mm = 120\nto_mm = 500\n")
    refused = design_sensors_here("explain", scene, "--zones", path)
    assert refused.returncode == 2
    words = f"design-sensors: {path}: zones.gate: to_mm = 500 is beyond the end of the beam, which is 400 mm long\n"
    assert refused.stderr == words
