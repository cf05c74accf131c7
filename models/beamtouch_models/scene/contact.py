"""The contacts that a scene is designed for. Validated strictly."""

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
            message = f"force_n = {list(self.force_range_n)}: the first must not exceed the second"
            raise ValueError(message)
        if self.position_mm[0] >= self.position_mm[1]:
            message = f"position_mm = {list(self.position_mm)}: the first must be less than the second"
            raise ValueError(message)
        return self

    @property
    def force_range_n(self) -> tuple[float, float]:
        """Smallest and largest force; equal if the force is known."""
        return self.force_n if isinstance(self.force_n, tuple) else (self.force_n, self.force_n)
