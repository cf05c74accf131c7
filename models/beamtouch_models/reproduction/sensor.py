"""Figure 2: the characteristic of the proximity sensors."""

import numpy as np

from beamtouch_models.charts import Chart, Series
from beamtouch_models.reproduction.finding import Figure, compared, rounded
from beamtouch_models.reproduction.paper import SCENE
from beamtouch_models.rig.surface import counts_of_gap
from beamtouch_models.surface import Surface


def figure_2() -> Figure:
    """Return figure 2: the output of the rig's sensor over the gap, and its deviation from a line from 1 to 4 mm."""
    sensor = Surface.of(SCENE).sensor
    full_scale = 2**sensor.adc_bits - 1
    gap = np.linspace(0.0, 5.0, 501)
    output = counts_of_gap(sensor, gap) / full_scale * 100
    stated = (gap >= 1) & (gap <= 4)
    line = np.polynomial.Polynomial.fit(gap[stated], output[stated], 1)
    departure = np.abs(output - line(gap))
    straight = gap[departure < 0.01]
    row = compared(
        "fig. 2: linear range of the sensor",
        "1 to 4 mm",
        f"{straight[0]:.3g} to {straight[-1]:.3g} mm (by construction of the rig's sensor); off the line by "
        f"{departure[stated].max():.1g} % of the scale",
        agrees=bool(abs(straight[0] - 1) < 0.1 and abs(straight[-1] - 4) < 0.1),
        why="the rig's sensor is not linear over that range",
    )
    chart = Chart(
        "Output of the proximity sensor over its gap: straight from 1 to 4 mm, levelling off beyond",
        "gap, mm",
        "output, % of the scale",
        [
            Series("output of the rig's sensor", rounded(gap), rounded(output)),
            Series("straight line through 1 to 4 mm", [0.5, 4.5], rounded(line(np.array([0.5, 4.5]))), 1, "dashed"),
        ],
    )
    results = {
        "gap_mm": rounded(gap[::10]),
        "output_percent": rounded(output[::10]),
        "largest_departure_percent": rounded(float(departure[stated].max())),
    }
    return Figure(2, "sensor", "A characteristic of the proximity sensors.", chart, results, (row,))
