"""How far a rest gap may be from the last tare, or from the configuration, before it looks like a load."""

import pytest

from beamtouch_daemon.measuring.tares import find_contradictions

from .surfaces import surface_of

LIGHT = {"smallest_force_mm": 0.2}
"""The range of the sensor is 3 mm."""


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "by more than a tenth of `smallest_force_mm`, the deflection of the channel under the smallest force of the model.",
    "Four times `zero_drift_mm` is always allowed.",
    (
        "Without `smallest_force_mm`, the first tare may differ by a tenth of the sensor's range and each later one "
        "by a fiftieth, so a light load passes."
    ),
)
@pytest.mark.promise(
    "docs/reference/daemon-configuration.md", "`tare` refuses a rest gap that differs by a tenth of it."
)
@pytest.mark.parametrize(
    ("channel", "drift_mm", "is_first", "allowed_mm"),
    [
        ({}, 0.0, True, 0.3),
        ({}, 0.0, False, 0.06),
        (LIGHT, 0.0, True, 0.02),
        (LIGHT, 0.0, False, 0.02),
        ({"smallest_force_mm": 2.0}, 0.0, False, 0.06),
        (LIGHT, 0.004, False, 0.02),
        (LIGHT, 0.01, False, 0.04),
        (LIGHT, 0.01, True, 0.04),
        ({}, 0.02, False, 0.08),
    ],
)
def test_a_rest_gap_may_differ_by_so_much_either_way(
    channel: dict[str, object], drift_mm: float, is_first: bool, allowed_mm: float
) -> None:
    surface = surface_of(2, channel, zero_drift_mm=drift_mm)
    last_mm = {} if is_first else {"s1": 2.5, "s2": 2.5}
    for sign in (-1, 1):
        within, beyond = ({"s1": 2.5 + sign * part * allowed_mm, "s2": 2.5} for part in (0.99, 1.01))
        assert find_contradictions(within, last_mm, surface) == []
        (said,) = find_contradictions(beyond, last_mm, surface)
        assert said.startswith("s1 ")
        assert said.endswith("its rest_gap_mm" if is_first else "the last tare")
