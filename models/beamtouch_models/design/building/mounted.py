"""Sensors that an earlier build has placed, and that may be mounted: a new build of the scene keeps their places."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

from beamtouch_common.encodings import decode
from beamtouch_common.errors import InputError
from beamtouch_models.design.building.stored import positions_in, stored_in_file
from beamtouch_models.design.scene import Scene, change_scene
from beamtouch_models.design.scene.plausible_plate import AXES, xy_of
from beamtouch_models.errors import ModelFileError
from beamtouch_models.places import Place, in_words


@dataclass(frozen=True)
class Mounted:
    """The sensors of an earlier build."""

    file: Path
    """The model file, or the daemon's configuration, that has their places."""
    positions_mm: tuple[Place, ...]
    """Their places from the left end, in the order of the channels."""

    def fits(self, scene: Scene) -> bool:
        """Return whether these places can be those of a scene."""
        few, many = scene.count_range
        fixed: set[Place] = {*scene.sensors.fixed_mm, *map(xy_of, scene.sensors.fixed)}
        if not few <= len(self.positions_mm) <= many or not fixed <= set(self.positions_mm):
            return False
        places = [dict(zip(AXES, place, strict=True)) for place in self.positions_mm if isinstance(place, tuple)]
        try:
            change_scene(scene, sensors={"fixed": places} if places else {"fixed_mm": list(self.positions_mm)})
        except InputError:
            return False
        return True

    def moves_to(self, positions_mm: tuple[Place, ...]) -> str:
        """Say where the sensors of this file go if these are the new places; empty if they stay."""
        if set(positions_mm) == set(self.positions_mm):
            return ""
        pairs = zip(self.positions_mm, positions_mm, strict=False)
        if len(positions_mm) == len(self.positions_mm):
            moved = ", ".join(f"{in_words(old)} -> {in_words(new)}" for old, new in pairs if old != new)
            return f"sensors are not where {self.file} had them: {moved} mm"
        old, new = (", ".join(map(in_words, places)) for places in (self.positions_mm, positions_mm))
        return f"sensors are not where {self.file} had them: {old} mm; now {new} mm"


def find_mounted(name: str, model: Path, config: Path | None) -> Mounted | None:
    """Return the sensors of the files that a build of the surface `name` is about to replace; None if there are none.

    The configuration counts before the model, because somebody may have corrected a place in it. A file that is neither
    a model nor a configuration with places has none; nor has one that cannot be read.
    """
    if config is not None and (places := _positions_in_config(config, name)):
        return Mounted(config, places)
    return Mounted(model, places) if (places := _positions_in_model(model)) else None


def _positions_in_model(path: Path) -> tuple[Place, ...]:
    try:
        return positions_in(stored_in_file(path))
    except ModelFileError:
        return ()


def _positions_in_config(path: Path, name: str) -> tuple[Place, ...]:
    try:
        surface = tomllib.loads(decode(path.read_bytes()))["surfaces"][name]
        if all("x_mm" in channel for channel in surface["channels"]):
            return tuple((float(channel["x_mm"]), float(channel["y_mm"])) for channel in surface["channels"])
        return tuple(float(channel["position_mm"]) for channel in surface["channels"])
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return ()
