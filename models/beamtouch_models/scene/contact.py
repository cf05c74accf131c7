"""What the user states about contacts, and about the temperature around the beam."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from beamtouch_models.scene.fields import Pair, PositiveFinite, PositivePair, Strict


class Contact(Strict):
    """The contacts that the surface is designed for, uniform over their ranges."""

    force_n: PositiveFinite | PositivePair
    """One number if the force is known, else its range."""
    position_mm: Pair
    """Range of positions, from the left end of the beam."""
    width_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    """Length over which a contact presses evenly, centred at its position; 0 is a point."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.force_range_n[0] > self.force_range_n[1]:
            raise ValueError(f"force_n = {list(self.force_range_n)}: the first must not exceed the second")
        if self.position_mm[0] >= self.position_mm[1]:
            raise ValueError(f"position_mm = {list(self.position_mm)}: the first must be less than the second")
        return self

    @property
    def force_range_n(self) -> tuple[float, float]:
        """Smallest and largest force; equal if the force is known."""
        return self.force_n if isinstance(self.force_n, tuple) else (self.force_n, self.force_n)


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
            raise ValueError(f"temperature_range_k = {[low, high]}: the first must not exceed the second")
        if low > FARTHEST_K:
            message = (
                f"temperature_range_k = {[low, high]}: state it relative to the temperature of mounting, not absolute; "
                f"mounted at 293 K, this is {[low - 293, high - 293]}"
            )
            raise ValueError(message)
        return self
