"""The surroundings of a surface as a scene states them. Validated strictly."""

from typing import Self

from pydantic import model_validator

from beamtouch_models.scene.fields import Pair, Strict

FARTHEST_K = 150.0
"""A beam that is always more than this above its mounting temperature was stated in absolute kelvin."""


class Environment(Strict):
    """The surroundings of the surface."""

    temperature_range_k: Pair | None = None
    """Lowest and highest temperature, relative to that at which the beam was mounted: [-10, 15]."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        low, high = self.temperature_range_k or (0.0, 0.0)
        if low > high:
            message = f"temperature_range_k = {[low, high]}: the first must not exceed the second"
            raise ValueError(message)
        if low > FARTHEST_K:
            message = (
                f"temperature_range_k = {[low, high]}: state it relative to the temperature of mounting, not absolute; "
                f"mounted at 293 K, this is {[low - 293, high - 293]}"
            )
            raise ValueError(message)
        return self
