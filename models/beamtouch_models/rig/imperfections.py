"""Imperfections: the departures of a virtual surface from its scene, which calibration finds, and its damping.

One key is stated otherwise than in `Departures`: the offset is one of the gap.
"""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from beamtouch_common.files import load_toml
from beamtouch_models.errors import SceneError
from beamtouch_models.metadata import Departures
from beamtouch_models.scene.fields import Finite, Fixity, PositiveFinite, Strict

DampingRatio = Annotated[float, Field(gt=0, lt=1)]


class Imperfections(Strict):
    """The keys of the imperfections file; by default the surface is as the scene and the model state."""

    position_offset_mm: Annotated[tuple[Finite, ...], Field(strict=False)] = ()
    """True position of each sensor minus its position in the layout."""
    gain: Annotated[tuple[PositiveFinite, ...], Field(strict=False)] = ()
    """Measured over true deflection, per channel."""
    offset_mm: Annotated[tuple[Finite, ...], Field(strict=False)] = ()
    """Added to each gap; a tare removes it."""
    curve_per_mm: Finite = 0.0
    """Curvature of the characteristic: a deflection w is measured as y, where y + curve y^2 = gain w."""
    fixity: Annotated[tuple[Fixity, Fixity], Field(strict=False)] = (0.0, 0.0)
    """Fixity of the leftmost and the rightmost support."""
    rigidity: PositiveFinite = 1.0
    """Factor on E I."""
    damping_ratio: DampingRatio | None = None
    """Damping ratio of the first mode, in which the beam rings unless the price of ringing is negligible. Default: the
    scene's `beam.damping_ratio`."""

    def departures(self, channels: int) -> Departures:
        """Return the departures of a surface.

        Raises
        ------
        SceneError
            A list is neither empty nor has one entry per channel.
        """
        given = {name: list(getattr(self, name)) for name in ("position_offset_mm", "gain", "offset_mm")}
        for name, values in given.items():
            if len(values) not in (0, channels):
                message = f"{name} has {len(values)} entries for {channels} channels"
                raise SceneError(message)
        stated = {name: values for name, values in given.items() if values}
        if self.offset_mm:  # a larger gap is a smaller deflection
            stated["offset_mm"] = [-value for value in self.offset_mm]
        whole = {"fixity": self.fixity, "rigidity": self.rigidity, "curve_per_mm": self.curve_per_mm}
        return Departures.none(channels).model_copy(update=stated | whole)


def load_imperfections(path: Path) -> Imperfections:
    """Read an imperfections file; raises InputError with the reason if it is wrong."""
    return load_toml(Imperfections, path)
