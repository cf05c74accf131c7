"""The fit of a model to a real surface."""

from pydantic import Field, FiniteFloat, PositiveFloat

from beamtouch_models.metadata.fields import Deviation, MetadataPart, Pair


class Departures(MetadataPart):
    """Differences of a real surface from its scene, fitted by a calibration. Lists have an entry per channel."""

    position_offset_mm: list[FiniteFloat]
    """True position of each sensor minus its position in the layout."""
    gain: list[PositiveFloat]
    """Measured over true deflection."""
    offset_mm: list[FiniteFloat]
    """Measured deflection at rest."""
    curve_per_mm: FiniteFloat = 0.0
    """Curvature of the characteristic: y + curve y^2 is proportional to the deflection; y is measured minus offset."""
    fixity: Pair = (0.0, 0.0)
    """Fixity of the leftmost and the rightmost support."""
    rigidity: PositiveFloat = 1.0
    """Factor on E I."""


class Calibration(MetadataPart):
    """A fit to recorded loads, to unlabelled contacts, or to the ones and then to the others."""

    departures: Departures
    fitted: list[str]
    """Kinds of departures that were fitted; the others are as in the scene."""
    loads: int = Field(ge=0)
    residual_mm: float = Field(ge=0, alias="unexplained_mm")
    """Standard deviation that a fit leaves in the deflections of a left-out load, beyond noise; part of the noise."""
    error_before_mm: float | None = None
    """Mean position error of the loads; None without loads."""
    error_after_mm: float | None = None
    """Mean position error of the loads, each by a fit without it."""
    contacts: int = Field(default=0, ge=0)
    """Number of unlabelled contacts."""
    misfit_before: float | None = None
    """Median misfit of the contacts, without the floor; None without contacts."""
    misfit_after: float | None = None
    """The same, each by a fit without it."""
    force_error: Deviation = 0.0
    """Relative error of all forces together, which unlabelled contacts leave; part of the intervals of the force."""
