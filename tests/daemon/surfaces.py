"""Surfaces as the configuration states them, with a line for a characteristic."""

from collections.abc import Mapping

from beamtouch_daemon.config.settings import Surface

STEP_MM = 0.0001
"""Of a count."""
RATE_HZ = 200.0
CHANNEL = {"gain_mm_per_count": -STEP_MM, "offset_mm": 4.5, "rest_gap_mm": 2.5, "range_mm": [1.0, 4.0]}
"""A count of 20000 is the gap at rest."""


def surface_of(channels: int = 2, channel: Mapping[str, object] | None = None, /, **changes: object) -> Surface:
    """Return a surface; `changes` are further keys of it, and `channel` has those of each channel."""
    numbered = [
        {"name": f"s{index + 1}", "register": index} | CHANNEL | dict(channel or {}) for index in range(channels)
    ]
    source = {"kind": "modbus-tcp", "host": "127.0.0.1"}
    return Surface.model_validate({"rate_hz": RATE_HZ, "source": source, "channels": numbered} | changes)


def mean_of(window: int) -> dict[str, object]:
    """Return the settings of a mean of so many readings."""
    return {"kind": "moving-average", "window": window}
