"""The cost of a measured table in accuracy: what the error would be if it were exact."""

from dataclasses import replace

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.limit import accuracy_limit
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.layout import Layout
from beamtouch_models.design.physics.influence_function import Interpolation

DRAWS, LEAST = 4000, 500
"""Simulated contacts of a limit, and the fewest."""


def describe_table_cost(layout: Layout, seed: int) -> str:
    """Say what the interpolation of a measured table and the repeatability of its loads cost; empty without a table."""
    influence, errors = layout.surface.influence, layout.surface.errors
    table, draws = influence.interpolation, layout.aim.effort.of(DRAWS, LEAST)
    if table is None or table.repeats is None:
        return ""

    def limit_mm(known: Interpolation) -> float:
        prior = Prior.of(replace(influence, interpolation=known), layout.placement.place_mm, errors)
        return accuracy_limit(prior, draws, seed).scaled(prior.diagonal_mm / 100).value

    whole_mm = limit_mm(table)
    between_mm = whole_mm - limit_mm(replace(table, deviation_at=_exact))
    measured = layout.surface.scene.measured
    if measured is not None and measured.theory is not None:
        return (
            f"of the mean error of {digits(whole_mm, 3)} mm at best, that the theory misses the loads costs "
            f"{digits(max(between_mm, 0.0), 2)} mm"
        )
    anew_mm = whole_mm - limit_mm(replace(table, repeats=None))
    return (
        f"of the mean error of {digits(whole_mm, 3)} mm at best, interpolation between the loads of the table costs "
        f"{digits(max(between_mm, 0.0), 2)} mm, and that loads do not repeat {digits(max(anew_mm, 0.0), 2)} mm"
    )


def _exact(sensor_mm: Floats, load_mm: Floats) -> Floats:
    return np.zeros((len(load_mm), len(sensor_mm)))
