"""Health of sensors under a plate, from contacts anywhere on it: a rigid plate on springs, in closed form."""

import numpy as np
import pytest

from beamtouch_models.places import grid_of
from beamtouch_models.runtime import BestSample, Health
from beamtouch_models.runtime.metadata import Metadata
from beamtouch_models.runtime.metadata_parts import Channel, Influence, Ranges
from models.sprung_plate import SIZE_MM, sunk_mm
from support.surfaces.small_model import PLATE_OUTPUTS, model_of

CORNERS_MM = [(10.0, 10.0), (10.0, 290.0), (390.0, 10.0), (390.0, 290.0)]
NOISE_MM, CONTACTS = 0.001, 300


def metadata_of(sensors_mm: list[tuple[float, float]]) -> Metadata:
    grid = grid_of([np.linspace(10, 390, 9), np.linspace(10, 290, 9)])
    layout = [Channel(name=f"s{n}", position_mm=x, across_mm=y) for n, (x, y) in enumerate(sensors_mm, 1)]
    changed = {
        "influence": Influence(mm_per_n=sunk_mm(np.array(sensors_mm), grid).tolist()),
        "ranges": Ranges(position_mm=(10, 390), across_mm=(10, 290), force_n=(2, 20)),
        "layout": layout,
    }
    return model_of(outputs=PLATE_OUTPUTS, channels=len(layout)).metadata.model_copy(update=changed)


@pytest.mark.promise(
    "docs/reference/sensor-health.md",
    "On a plate, place and force take three of the channels, so that only a fourth one shows a change",
)
@pytest.mark.parametrize(
    ("sensors_mm", "gains"),
    [
        (CORNERS_MM, [1, 1, 1, 1]),
        (CORNERS_MM, [1, 1.05, 1, 1]),
        ([*CORNERS_MM, (200.0, 10.0), (200.0, 290.0)], [1, 1, 1, 0.95, 1, 1]),
        # Three sensors say where and how hard, and nothing else.
        (CORNERS_MM[:3], [1, 1.05, 1]),
    ],
)
def test_a_gain_that_has_changed_is_found_by_contacts_on_a_plate(
    sensors_mm: list[tuple[float, float]], gains: list[float]
) -> None:
    rng, count = np.random.default_rng(4), len(sensors_mm)
    place_mm, force_n = rng.uniform(10, SIZE_MM - 10, (CONTACTS, 2)), rng.uniform(2, 20, (CONTACTS, 1))
    seen_mm = force_n * sunk_mm(np.array(sensors_mm), place_mm) * gains + rng.normal(0, NOISE_MM, (CONTACTS, count))
    health, deviation_mm = Health(metadata_of(sensors_mm)), [NOISE_MM] * count
    rest_mm = [0.0] * count
    health.add(
        [
            BestSample(10**6 * (at + 1), row, deviation_mm, rest_mm, deviation_mm, is_contact=True)
            for at, row in enumerate(seen_mm.tolist())
        ]
    )
    found = [channel.gain for channel in health.channels()]
    assert all(one is not None for one in found)
    for one, gain in zip(found, gains, strict=True):
        assert one is not None
        assert one.changed == (gain != 1 and count > 3)
        assert one.low - 0.002 <= gain - 1 <= one.high + 0.002
