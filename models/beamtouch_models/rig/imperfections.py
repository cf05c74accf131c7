"""How a real surface differs from its scene and its model: what calibration is for."""

import tomllib
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from beamtouch_models.errors import SceneError
from beamtouch_models.scene import Scene, first_error
from beamtouch_models.structure import Finite, Fixity, PositiveFinite, Strict, changed_beam
from beamtouch_models.text_file import read_text

Array = NDArray[np.float64]
DampingRatio = Annotated[float, Field(gt=0, lt=1)]


class Imperfections(Strict):
    """A TOML file; what it leaves out is as the scene and the model say."""

    position_offset_mm: tuple[Finite, ...] = ()
    """True position of each sensor less that of the layout."""
    gain: tuple[PositiveFinite, ...] = ()
    """How many times as large each channel sees a deflection."""
    offset_mm: tuple[Finite, ...] = ()
    """Added to each gap; a tare takes it away."""
    curve_per_mm: Finite = 0.0
    """A deflection w is seen as gain (w + curve w^2): a characteristic that is not straight."""
    fixity: tuple[Fixity, Fixity] = (0.0, 0.0)
    """Of the leftmost and of the rightmost support."""
    rigidity: PositiveFinite = 1.0
    """Factor on E I."""
    damping_ratio: DampingRatio | None = None
    """With it the beam rings in its first mode, so damped, where the scene prices ringing as more than negligible.

    Without it deflections follow the load at once, as if every load came slowly beside the beam's first period.
    """

    def check_channels(self, channels: int) -> None:
        """Raise SceneError unless every list has an entry per channel."""
        for name in ("position_offset_mm", "gain", "offset_mm"):
            given = len(getattr(self, name))
            if given not in (0, channels):
                message = f"{name} has {given} entries for {channels} channels"
                raise SceneError(message)

    def applied_to(self, scene: Scene) -> Scene:
        """Return the scene of the real beam; raises SceneError where a wall is given a fixity."""
        beam = changed_beam(scene.beam, self.rigidity, self.fixity)
        return scene.model_copy(update={"beam": beam})

    def sensors_mm(self, layout_mm: Array) -> Array:
        """True positions of sensors that the layout has at `layout_mm` (channels,)."""
        return layout_mm + (np.array(self.position_offset_mm) if self.position_offset_mm else 0.0)

    def seen_mm(self, deflection_mm: Array) -> Array:
        """What the sensors make of true deflections (channels,)."""
        gain = np.array(self.gain) if self.gain else 1.0
        offset = np.array(self.offset_mm) if self.offset_mm else 0.0
        seen: Array = gain * (deflection_mm + self.curve_per_mm * deflection_mm**2) - offset
        return seen


def load_imperfections(path: Path) -> Imperfections:
    """Read the file; raises SceneError that says what is wrong with it."""
    text = read_text(path)
    try:
        return Imperfections.model_validate(tomllib.loads(text))
    except ValidationError as error:
        message = f"{path}: {first_error(error)}"
    except (ValueError, RecursionError) as error:
        message = f"{path}: not valid TOML: {error}"
    raise SceneError(message)
