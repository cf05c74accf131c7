"""Influence lines: what each sensor measures while a newton travels along the beam."""

import sys

import matplotlib.pyplot as plt
import numpy as np

from beamtouch_models import influence_matrix, read_scene

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
place = np.linspace(0, 400, 201)
matrix = 1000 * influence_matrix(scene, sensors, place)

figure, axes = plt.subplots(figsize=(7, 3.5))
axes.plot(place, matrix, label=[f"sensor at {sensor} mm" for sensor in sensors])
axes.set(
    xlabel="place of the load in mm", ylabel="deflection in um per newton", title="Influence lines of a steel strip"
)
axes.legend()

plt.savefig(sys.argv[1] if len(sys.argv) > 1 else "influence_lines.svg", bbox_inches="tight")
