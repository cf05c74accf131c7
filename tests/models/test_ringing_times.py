"""How long a beam rings: against a damped oscillator that scipy integrates."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from beamtouch_models.design.pricing.ringing import decay_s
from support.programs.in_process import Command
from support.surfaces.example_scenes import PAPER, SCENES


def last_above_s(frequency_hz: float, zeta: float, ratio: float) -> float:
    """Return when y'' + 2 zeta w y' + w^2 y = w^2, from rest, is last further than 1/ratio from 1."""
    omega = 2 * math.pi * frequency_hz
    swing = solve_ivp(
        lambda _t, y: [y[1], omega**2 * (1 - y[0]) - 2 * zeta * omega * y[1]],
        (0, 2 * decay_s(ratio, frequency_hz, zeta)),
        [0.0, 0.0],
        rtol=1e-9,
        atol=1e-12,
        max_step=0.02 / frequency_hz,
    )
    return float(swing.t[np.flatnonzero(np.abs(swing.y[0] - 1) > 1 / ratio)[-1]])


@pytest.mark.parametrize(
    ("frequency_hz", "zeta", "ratio"), [(44.0, 0.01, 100.0), (10.0, 0.05, 30.0), (10.0, 0.6, 40.0), (10.0, 0.8, 2.0)]
)
def test_the_ringing_is_under_the_noise_after_the_stated_time(frequency_hz: float, zeta: float, ratio: float) -> None:
    stated, true = decay_s(ratio, frequency_hz, zeta), last_above_s(frequency_hz, zeta, ratio)
    assert true <= stated * 1.001
    assert stated - true < 0.6 / frequency_hz / math.sqrt(1 - zeta**2)


def test_explain_says_how_the_bench_rings_if_the_scene_states_a_mass(
    design_sensors_roughly: Command, tmp_path: Path
) -> None:
    path, text = tmp_path / "scene.toml", (SCENES / "bench.toml").read_text()

    def explained(scene: str) -> dict[str, Any] | None:
        path.write_text(scene)
        told: dict[str, Any] | None = json.loads(design_sensors_roughly("explain", path, "--json").stdout)["ringing"]
        return told

    assert explained(PAPER) is None  # no density
    found = explained(text)
    assert found is not None
    # Blevins, table 8-1: (pi^2 / 2 pi l^2) sqrt(EI / m), with EI = 11.8125 N m^2 and m = 0.58875 kg/m.
    frequency_hz = math.pi / 2 / 0.16 * math.sqrt(11.8125 / 0.58875)
    assert found["frequency_hz"] == pytest.approx(frequency_hz, rel=1e-9)
    # 20 N weigh 2.04 kg; in the middle, the spring of the beam alone would carry them at 9.3 Hz.
    spring_n_per_m = 48 * 11.8125 / 0.4**3
    alone_hz = math.sqrt(spring_n_per_m / (20 / 9.80665)) / 2 / math.pi
    laden_hz = (alone_hz**-2 + frequency_hz**-2) ** -0.5
    assert found["laden_frequency_hz"] == pytest.approx(laden_hz, rel=1e-3)
    ratio = 500.0  # the noise is 0.2 % of the largest deflection
    assert found["damping_is_assumed"]
    assert found["after_lift_s"] == pytest.approx(decay_s(ratio, frequency_hz, 0.01), rel=1e-9)
    assert found["after_touch_s"] == pytest.approx(decay_s(ratio, found["laden_frequency_hz"], 0.01), rel=1e-9)
    quicker = explained(text.replace("density_kg_m3", "damping_ratio = 0.05\ndensity_kg_m3"))
    assert quicker is not None
    assert quicker["after_lift_s"] == pytest.approx(found["after_lift_s"] / 5, rel=1e-3)
    assert not quicker["damping_is_assumed"]
