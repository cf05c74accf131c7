"""Error against noise and number of sensors: what a better sensor buys, and what one more."""

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
noises_mm = np.geomspace(1e-4, 1e-1, 6)

figure, axes = plt.subplots(figsize=(7, 4))
for count in (2, 4, 6):
    layout = surface.place(count, criterion="eigenvalue-product")
    limits = [layout.limit(noise_mm=noise_mm, draws=256).value for noise_mm in noises_mm]
    axes.loglog(noises_mm, limits, "o-", label=f"{count} sensors")
axes.set(
    xlabel="noise of a sample in mm",
    ylabel="mean error in mm",
    title="Where errors of the gains rule, less noise buys nothing",
)
axes.legend()

plt.savefig(sys.argv[1] if len(sys.argv) > 1 else "noise_and_sensors.svg", bbox_inches="tight")
