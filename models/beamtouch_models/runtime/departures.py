"""What a calibration found: the departures of a real surface from its scene."""

import numpy as np
from pydantic import Field, FiniteFloat, PositiveFloat

from beamtouch_models.arrays import Floats
from beamtouch_models.runtime.metadata_parts import Deviation, MetadataPart, Pair, is_none


class Departures(MetadataPart):
    """Differences of a real surface from its scene. Lists have an entry per channel.

    A true deflection w is measured as y + offset, where y + curve y^2 = gain w.
    """

    position_offset_mm: list[FiniteFloat]
    """True position of each sensor minus its position in the layout."""
    gain: list[PositiveFloat]
    """Measured over true deflection."""
    offset_mm: list[FiniteFloat]
    """Measured deflection at rest; a tare removes it."""
    curve_per_mm: FiniteFloat = 0.0
    """Curvature of the characteristic."""
    fixity: Pair = (0.0, 0.0)
    """Fixity of the leftmost and the rightmost support."""
    rigidity: PositiveFloat = 1.0
    """Factor on E I, or on a plate and all its springs. Where known loads show only its product with all gains, it
    holds what the gains have in common."""
    across_offset_mm: list[FiniteFloat] | None = Field(default=None, exclude_if=is_none)
    """True place of each sensor minus that in the layout, along the second axis; only on a plate."""
    spring_stiffness: list[PositiveFloat] | None = Field(default=None, exclude_if=is_none)
    """Factor on the spring in each support of a plate, beside that on all of them; 1 for a rigid support."""

    @classmethod
    def none(cls, channels: int) -> "Departures":
        """Return those of a surface that is as its scene says."""
        return cls(position_offset_mm=[0.0] * channels, gain=[1.0] * channels, offset_mm=[0.0] * channels)

    @property
    def offsets_mm(self) -> Floats:
        """Offsets of the sensors as their positions are stated: (channels,), on a plate (channels, 2)."""
        if self.across_offset_mm is None:
            return np.array(self.position_offset_mm)
        return np.column_stack([self.position_offset_mm, self.across_offset_mm])

    def sensors_mm(self, layout_mm: Floats, size_mm: tuple[float, ...]) -> Floats:
        """Return the true positions (channels,) of the sensors of a layout on a beam of this length.

        On a plate of this size, they are places (channels, 2).
        """
        if layout_mm.ndim > 1 and self.across_offset_mm is None:
            return layout_mm
        true_mm: Floats = np.clip(layout_mm + self.offsets_mm, 0.0, size_mm if layout_mm.ndim > 1 else size_mm[0])
        return true_mm

    def measure(self, linear_mm: Floats) -> Floats:
        """Return what the sensors measure (..., channels) of deflections that hold the gains, gain w, in mm."""
        # The root of y + curve y^2 = linear that is 0 at 0, in the form that does not cancel.
        square = np.maximum(1 + 4 * self.curve_per_mm * linear_mm, 0.0)
        measured: Floats = 2 * linear_mm / (1 + np.sqrt(square)) + np.array(self.offset_mm)
        return measured

    def slope(self, linear_mm: Floats) -> Floats:
        """Return the change of `measure` with the deflection that it is given."""
        slope: Floats = 1 / np.sqrt(np.maximum(1 + 4 * self.curve_per_mm * linear_mm, np.finfo(np.float64).tiny))
        return slope

    def linear_mm(self, measured_mm: Floats) -> Floats:
        """Return the deflections that hold the gains (..., channels) of measured ones: the inverse of `measure`."""
        return self.straighten(measured_mm - np.array(self.offset_mm))

    def straighten(self, from_rest_mm: Floats) -> Floats:
        """Return the deflections that hold the gains (..., channels) of measured ones less those at rest."""
        linear: Floats = from_rest_mm + self.curve_per_mm * from_rest_mm**2
        return linear


class Calibration(MetadataPart):
    """A fit to recorded loads, to unlabelled contacts, or to the ones and then to the others."""

    departures: Departures
    fitted: list[str]
    """Kinds of departures that were fitted; the others are as in the scene."""
    loads: int = Field(ge=0)
    residual_mm: float = Field(ge=0)
    """Standard deviation that a fit leaves in the deflections of a left-out load, beyond noise; the floor holds it."""
    error_before_mm: float | None = None
    """Mean position error of the loads; None without loads."""
    error_after_mm: float | None = None
    """Mean position error of the loads, each by a fit without it."""
    contacts: int = Field(default=0, ge=0)
    """Number of unlabelled contacts."""
    misfit_before: float | None = None
    """Median misfit of the contacts, without the floor; None without contacts."""
    misfit_after: float | None = None
    """The same by the fit."""
    force_error: Deviation = 0.0
    """Relative error of all forces together, which loads or contacts leave; part of the intervals of the force."""
