"""Why these positions: the accuracy limit of two sensors, for all places of the two."""

import sys

import matplotlib.pyplot as plt
import numpy as np

from beamtouch_models import read_scene, resolve

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

surface = resolve(read_scene(SCENE))
left = np.arange(50, 200, 25)
limits = [[surface.layout([a, 400 - b]).limit(draws=128).value for a in left] for b in left]
row, column = np.unravel_index(np.argmin(limits), np.shape(limits))
best = left[column], 400 - left[row]
paper = surface.place(2, criterion="eigenvalue-product").positions_mm

figure, axes = plt.subplots(figsize=(5.5, 4.5))
filled = axes.contourf(left, 400 - left, limits, levels=12, cmap="viridis_r")
figure.colorbar(filled, label="mean error in mm")
axes.plot(*best, "o", color="white", label="least error of these")
axes.plot(*paper, "x", color="white", label="largest eigenvalue product")
axes.set(xlabel="left sensor in mm", ylabel="right sensor in mm", title="Two sensors under a steel strip")
axes.legend(facecolor="grey", labelcolor="white")

plt.savefig(sys.argv[1] if len(sys.argv) > 1 else "why_these_positions.svg", bbox_inches="tight")
