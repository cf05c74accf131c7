"""Finds out whether the values of a device would be gaps with another `byte_order`. Pure."""

from collections.abc import Sequence
from typing import get_args

import numpy as np

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.sources import Modbus
from beamtouch_daemon.config.value_types import ByteOrder, words_of
from beamtouch_daemon.processing.characteristic import QUALITIES, Characteristic
from beamtouch_daemon.sources.registers import Value
from beamtouch_service.samples import Quality


def find_byte_orders(surface: Surface, counts: Sequence[float | None]) -> list[ByteOrder]:
    """Return the byte orders in which most of the values that came are good, if none is with the configured one.

    Only values in several registers count, and only if there is one; `counts` has a value for each channel.
    """
    if not isinstance(surface.source, Modbus):
        return []
    places = [
        at for at, value_type in enumerate(surface.value_types) if words_of(value_type) > 1 and counts[at] is not None
    ]
    characteristic, configured = Characteristic.of(surface), surface.source.byte_order

    def good_in(order: ByteOrder) -> int:
        values = np.full(len(counts), np.nan)
        for place in places:
            value_type = surface.value_types[place]
            registers = Value(0, value_type, configured).encode(counts[place] or 0.0)
            value = Value(0, value_type, order).decode(dict(enumerate(registers)))
            values[place] = np.nan if value is None else value
        (codes,) = characteristic.quality(values[np.newaxis]).tolist()
        return [QUALITIES[codes[place]] for place in places].count(Quality.GOOD)

    return [] if good_in(configured) else [order for order in get_args(ByteOrder) if 2 * good_in(order) > len(places)]
