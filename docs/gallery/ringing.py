"""Ringing: what the sensors see after a sudden touch."""

import sys

import matplotlib.pyplot as plt
import numpy as np

from beamtouch_models import frequency_hz, influence_matrix, read_scene, ringing_mm

SCENE = """
[beam]
length_mm = 400
youngs_modulus_gpa = 210
width_mm = 25
thickness_mm = 3
density_kg_m3 = 7850

[contact]
force_n = [2, 20]
position_mm = [10, 390]

[sensors]
noise_mm = 0.002
rate_hz = 100

[requirements]
latency_ms = 50
"""

scene = read_scene(SCENE)
sensors = [68, 156, 244, 332]
static_mm = 10 * influence_matrix(scene, sensors, [150])[0]
time_s = np.linspace(0, 1, 1001)

figure, axes = plt.subplots(figsize=(7, 3.5))
for damping_ratio, style in ((0.01, "-"), (0.1, "--")):
    moving_mm = ringing_mm(scene, static_mm, time_s, damping_ratio=damping_ratio)
    axes.plot(1000 * time_s, moving_mm[:, 1], style, label=f"damping ratio {damping_ratio:g}")
axes.axhline(static_mm[1], color="grey", linewidth=0.8)
axes.set(
    xlabel="time since the touch in ms",
    ylabel="deflection in mm",
    title=f"A strip that rings at {frequency_hz(scene):.0f} Hz",
)
axes.legend()

plt.savefig(sys.argv[1] if len(sys.argv) > 1 else "ringing.svg", bbox_inches="tight")
