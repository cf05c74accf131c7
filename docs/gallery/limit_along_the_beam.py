"""The accuracy limit along the beam: the error is largest near the ends."""

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
place = np.linspace(10, 390, 39)

figure, axes = plt.subplots(figsize=(7, 3.5))
for sensors in ([133, 267], [68, 156, 244, 332]):
    axes.plot(place, surface.layout(sensors).error_along(place).error_mm, label=f"{len(sensors)} sensors")
    axes.plot(sensors, np.zeros(len(sensors)), "^", color=axes.lines[-1].get_color())
axes.set(xlabel="place of the contact in mm", ylabel="mean error in mm", title="The accuracy limit along a steel strip")
axes.legend()

plt.savefig(sys.argv[1] if len(sys.argv) > 1 else "limit_along_the_beam.svg", bbox_inches="tight")
