"""The price of the sensors' errors, and of a failed sensor, in the error of position: data and rows of the report."""

import math
from dataclasses import dataclass, replace

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.accuracy.limit import accuracy_limit
from beamtouch_models.accuracy.prior import Prior, SampleErrors
from beamtouch_models.arrays import Floats
from beamtouch_models.metadata import Metadata
from beamtouch_models.surface import Surface

Rows = list[tuple[str, ...]]


@dataclass(frozen=True)
class ErrorPrice:
    """The accuracy limit of a layout with and without one kind of error, in percent of the length."""

    name: str
    size: str
    """Its standard deviation, with its unit."""
    with_percent: float
    without_percent: float


def error_prices(surface: Surface, positions_mm: Floats, draws: int, seed: int) -> tuple[ErrorPrice, ...]:
    """Price each kind of error of the sensors but the noise, on the same contacts.

    The part of the zeros' errors that comes with the temperature is priced by itself as well.
    """
    errors, warmth_mm = surface.errors, surface.modelled_readings.warmth_mm

    def limit_percent(some: SampleErrors) -> float:
        return accuracy_limit(Prior.real(surface.influence, positions_mm, some), draws, seed).percent

    whole = limit_percent(errors)
    at_one_temperature = replace(errors, zero_mm=math.sqrt(max(0.0, errors.zero_mm**2 - warmth_mm**2)))
    kinds = [
        ("gain error", f"{digits(100 * errors.gain, 3)} %", replace(errors, gain=0.0)),
        ("zero drift", f"{digits(1000 * errors.zero_mm, 3)} µm", replace(errors, zero_mm=0.0)),
        ("mounting tolerance", f"{digits(errors.mounting_mm, 3)} mm", replace(errors, mounting_mm=0.0)),
    ]
    if warmth_mm:
        kinds.insert(2, ("of this, with the temperature", f"{digits(1000 * warmth_mm, 3)} µm", at_one_temperature))
    return tuple(
        ErrorPrice(name, size, whole, whole if without == errors else limit_percent(without))
        for name, size, without in kinds
    )


def price_rows(prices: tuple[ErrorPrice, ...]) -> Rows:
    """Return a row per kind of error."""
    return [
        (
            price.name,
            price.size,
            f"{price.with_percent:.3f}",
            f"{price.without_percent:.3f}",
            f"{100 * (price.with_percent / price.without_percent - 1):.1f}",
        )
        for price in prices
    ]


def failed_rows(metadata: Metadata) -> Rows:
    """Return a row for all sensors and for each one failed."""
    found, mm = metadata.placed, metadata.length_mm / 100
    errors = np.array([found.limit_percent, *found.limit_without_percent])
    names = ["none", *(channel.name for channel in metadata.layout)]
    # A single sensor has no row without it.
    return [
        (name, f"{percent:.3f}", digits(percent * mm, 3), f"{percent / errors[0]:.2f}")
        for name, percent in zip(names, errors, strict=False)
    ]
