"""Imperfections: differences of a real surface from its scene and its model, which calibration removes."""

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from beamtouch_common.files import load_toml
from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError
from beamtouch_models.scene import Scene
from beamtouch_models.scene.beam import changed_beam
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
    """Curvature of the characteristic: a deflection w is measured as gain (w + curve w^2)."""
    fixity: Annotated[tuple[Fixity, Fixity], Field(strict=False)] = (0.0, 0.0)
    """Fixity of the leftmost and the rightmost support."""
    rigidity: PositiveFinite = 1.0
    """Factor on E I."""
    damping_ratio: DampingRatio | None = None
    """Damping ratio of the first mode, in which the beam rings unless the price of ringing is negligible. Default: the
    scene's `beam.damping_ratio`."""

    def check_channels(self, channels: int) -> None:
        """Raise SceneError unless every list is empty or has one entry per channel."""
        for name in ("position_offset_mm", "gain", "offset_mm"):
            given = len(getattr(self, name))
            if given not in (0, channels):
                message = f"{name} has {given} entries for {channels} channels"
                raise SceneError(message)

    def applied_to(self, scene: Scene) -> Scene:
        """Return the scene of the real beam; raises SceneError if a fixed support gets a fixity."""
        beam = changed_beam(scene.beam, self.rigidity, self.fixity)
        return scene.model_copy(update={"beam": beam})

    def sensors_mm(self, layout_mm: Floats) -> Floats:
        """Return the true positions of the sensors at `layout_mm` (channels,)."""
        return layout_mm + (np.array(self.position_offset_mm) if self.position_offset_mm else 0.0)

    def seen_mm(self, deflection_mm: Floats) -> Floats:
        """Return the deflections that the sensors measure under true deflections (channels,)."""
        gain = np.array(self.gain) if self.gain else 1.0
        offset = np.array(self.offset_mm) if self.offset_mm else 0.0
        seen: Floats = gain * (deflection_mm + self.curve_per_mm * deflection_mm**2) - offset
        return seen


def load_imperfections(path: Path) -> Imperfections:
    """Read an imperfections file; raises InputError with the reason if it is wrong."""
    return load_toml(Imperfections, path)
