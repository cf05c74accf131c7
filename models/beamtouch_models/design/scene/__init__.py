"""The scene of a surface: what the user states before it is built, validated strictly.

`beam` (with `materials`) and `tables` have its parts; `plausible` finds obvious mistakes.
"""

import json
import math
from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from pydantic import ConfigDict, Field, model_validator

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_common.files import parse_toml, read_text, validate
from beamtouch_common.units import MM
from beamtouch_models.design.rates import MAX_FALSE, max_false_per_day
from beamtouch_models.design.scene.beam import Beam, identity_of_beam
from beamtouch_models.design.scene.measured import FOLDER, Measured, identity_of_measured
from beamtouch_models.design.scene.plate import Plate, identity_of_plate
from beamtouch_models.design.scene.plausible import in_its_unit, in_other_units, misplaced, not_of_measured
from beamtouch_models.design.scene.plausible_plate import implausible_plate
from beamtouch_models.design.scene.tables import Contact, Environment, Requirements, Sensors, Strict
from beamtouch_models.errors import SceneError, require

if TYPE_CHECKING:  # no help waits for numpy
    from beamtouch_models.places import Place

__all__ = [
    "Requirements", "Scene", "change_scene", "format_scene", "identity_of", "load_scene", "make_scene", "parse_scene",
    "read_scene",
]  # fmt: skip


class Scene(Strict):
    """Statements of the user about a surface before it is built.

    >>> scene.beam.length_mm, scene.contact.force_n
    (400.0, (2.0, 20.0))
    """

    # A file needs a structure; a scene without one is for scripts.
    model_config = ConfigDict(
        json_schema_extra={
            "required": ["contact", "sensors"],
            "oneOf": [{"required": ["beam"]}, {"required": ["plate"]}, {"required": ["measured"]}],
        },
    )

    stated_beam: Beam | None = Field(default=None, alias="beam")
    """The beam, with its supports and its foundation. Only a plate, a measured structure, or one whose influence
    function a script gives in its place, has none."""
    plate: Plate | None = None
    """A plate with its supports, in place of a beam. Its places have two axes."""
    measured: Measured | None = None
    """A structure whose influence was measured, in place of a beam."""
    contact: Contact
    """The contacts that the surface is designed for."""
    sensors: Sensors
    """The proximity sensors under the beam."""
    requirements: Requirements = Field(default_factory=Requirements)
    """Requirements of the surface; all have defaults."""
    environment: Environment = Field(default_factory=Environment)
    """Temperatures around the surface, and what they do to the zeros."""

    @model_validator(mode="after")
    def _on_the_beam(self) -> Self:
        self._check_axes()
        # Units come first: the other checks stumble over a number in another one.
        if (beam := self.stated_beam) is not None and (
            message := next(chain(in_other_units(beam), misplaced(beam, self.contact, self.sensors)), "")
        ):
            raise ValueError(message)
        if self.plate is not None and (message := next(implausible_plate(self.plate, self.contact, self.sensors), "")):
            raise ValueError(message)
        if self.measured is not None and (
            message := next(not_of_measured(self.measured, self.contact, self.sensors), "")
        ):
            raise ValueError(message)
        if message := next(in_its_unit(self.unit, self.sensors), ""):
            raise ValueError(message)
        if self.sensors.count != "auto" and self.sensors.count_range[0] > self.sensors.count_range[1]:
            raise ValueError(f"sensors.count = {list(self.sensors.count_range)}: the first must not exceed the second")
        return self

    def _check_axes(self) -> None:
        """Raise ValueError if contact or sensors have other axes than the structure, or if there are two structures."""
        structures = {"beam": self.stated_beam, "plate": self.plate, "measured": self.measured}
        stated = [name for name, structure in structures.items() if structure is not None]
        if len(stated) > 1:
            raise ValueError(f"state either {stated[0]} or {stated[1]}, not both")
        axes = len(self.contact.ranges_mm)
        if self.plate is not None and axes == 1:
            raise ValueError("contact has position_mm, but a plate has two axes; state x_mm and y_mm in its place")
        if self.measured is not None and axes != self.measured.axes:
            own, other = ("position_mm", "x_mm and y_mm") if axes == 1 else ("x_mm and y_mm", "position_mm")
            raise ValueError(f"contact has {own}, but the table of the structure has {other}; state {other} there")
        others = ("fixed_mm", "keep_out_mm") if axes == 2 else ("fixed", "keep_out")
        if wrong := [key for key in others if getattr(self.sensors, key)]:
            where, right = ("a beam", wrong[0].removesuffix("_mm")) if axes == 2 else ("a plate", f"{wrong[0]}_mm")
            raise ValueError(f"sensors.{wrong[0]} is for {where}; write sensors.{right} here")

    @model_validator(mode="after")
    def _within_reason(self) -> Self:
        if self.sensors.drift_um_per_k is not None and self.environment.temperature_range_k is None:
            raise ValueError("sensors.drift_um_per_k needs environment.temperature_range_k, as [-10, 15]")
        beam, tolerance, fewest = self.stated_beam, self.sensors.mounting_tolerance_mm, self.sensors.count_range[0]
        if beam is not None and tolerance >= (spacing := beam.length_mm / fewest):
            raise ValueError(
                f"sensors.mounting_tolerance_mm = {tolerance:g}: {fewest} sensors on {beam.length_mm:g} mm are "
                f"{digits(spacing, 3)} mm apart; measure their positions to less than that"
            )
        often, rate_hz = self.requirements.false_contacts_per_day, self.sensors.rate_hz
        if often > (most := max_false_per_day(rate_hz)):
            raise ValueError(
                f"requirements.false_contacts_per_day = {often:g}: at sensors.rate_hz = {rate_hz:g} at most "
                f"{digits(most, 6)} a day, one sample in {1 / MAX_FALSE:g}; state less"
            )
        return self

    @property
    def has_beam(self) -> bool:
        """True if the structure is a beam."""
        return self.stated_beam is not None

    @property
    def has_two_axes(self) -> bool:
        """True if places have two axes, as on a plate or a skin."""
        return self.contact.stated_position_mm is None

    @property
    def is_computed(self) -> bool:
        """True if theory computes the structure; otherwise it is measured, or a script gives its influence function."""
        return self.stated_beam is not None or self.plate is not None

    @property
    def solid(self) -> Beam | Plate:
        """The beam or the plate; SceneError if the scene states neither."""
        return self.beam if self.plate is None else self.plate

    @property
    def size_mm(self) -> tuple[float, ...]:
        """Length of the structure along each axis; SceneError if the scene states none."""
        structure = self.plate or self.measured
        return (self.beam.length_mm,) if structure is None else structure.size_mm

    @property
    def diagonal_mm(self) -> float:
        """Length of which errors are a percentage: that of a beam, the diagonal of a plate."""
        return math.hypot(*self.size_mm)

    @property
    def unit(self) -> str:
        """Unit of what sensors show: mm, unless the table of a measured structure has another one."""
        return MM if self.measured is None else self.measured.loads.unit

    @property
    def length_mm(self) -> float:
        """Length of a structure of one axis, or along x; SceneError if the scene states none."""
        return self.size_mm[0]

    @property
    def count_range(self) -> tuple[int, int]:
        """Smallest and largest number of sensors.

        Of a measured structure, these are at most those of its table: all of them, unless the scene says otherwise.
        """
        few, many = self.sensors.count_range
        if self.measured is None:
            return few, many
        most = len(self.measured.loads.names)
        if self.sensors.count == "auto":
            return most if self.requirements.position_error_mm is None else min(few, most), most
        return min(few, most), min(many, most)

    @property
    def fewest(self) -> int:
        """Smallest number of sensors to consider: never less than the fixed ones."""
        return max(self.count_range[0], self.sensors.fixed_count)

    @property
    def beam(self) -> Beam:
        """The beam, for what needs one; SceneError if the scene states none."""
        for other in ("plate", "measured"):
            if getattr(self, other) is not None:
                raise SceneError(
                    f"this is for beams, but the scene has [{other}]; `resolve(scene).influence.at` has the influence "
                    "of any structure, and `resolve(scene)` all that follows from it"
                )
        if self.stated_beam is None:
            raise SceneError(
                "beam is missing; add it (`resolve` also takes an influence function of your own in its place, for "
                "layouts, limits and simulated samples)"
            )
        return self.stated_beam

    @property
    def wants_force(self) -> bool:
        """True if the model states the force."""
        return "force" in self.requirements.descriptors


def read_scene(scene: Path | str) -> Scene:
    """Read a scene.

    Parameters
    ----------
    scene : path of a TOML file, or TOML text; a text of one line that ends with ".toml" is a path

    Raises
    ------
    InputError
        The file cannot be read, or it is not a scene; the message names the key.

    Examples
    --------
    >>> read_scene(format_scene(scene)) == scene
    True
    """
    if not isinstance(scene, Path | str):
        raise InputError(f"the scene: give a path or TOML text, not {type(scene).__name__}")
    path = path_of(scene)
    return parse_scene(str(scene), "the scene") if path is None else _parse_file(path, read_text(path))


def path_of(scene: object) -> Path | None:
    """Return the path of a scene that is stated by its path, None if it is something else, as TOML text."""
    if isinstance(scene, str) and "\n" not in scene and scene.endswith(".toml"):
        return Path(scene)
    return scene if isinstance(scene, Path) else None


def make_scene(**tables: Mapping[str, Any]) -> Scene:
    """Make a scene of its tables, with the keys of a scene file.

    `beam`: length_mm, width_mm, thickness_mm, material (or youngs_modulus_gpa, density_kg_m3), supports, ...
    `plate`, in its place: length_x_mm, length_y_mm, thickness_mm, material, supports, support_stiffness_n_per_mm, ...
    `contact`: force_n (one number, or a range), force_tolerance_percent, width_mm, and position_mm, a range; on a
    plate, x_mm and y_mm.
    `sensors`: noise_mm (of one reading), rate_hz, count, range_mm, size_mm, gain_error_percent, zero_drift_mm, ...
    `requirements`: latency_ms, position_error_mm, descriptors, false_contacts_per_day, ...
    `environment`: temperature_range_k, drift_um_per_min.

    docs/reference/scene.md has all with their units and defaults, and so has `design-sensors schema`.

    >>> make_scene(
    ...     beam={"length_mm": 400, "material": "steel", "width_mm": 25, "thickness_mm": 3},
    ...     contact={"force_n": 10, "position_mm": [10, 390]},
    ...     sensors={"noise_mm": 0.002, "rate_hz": 100, "count": 3},
    ... ).sensors.count
    3

    Raises
    ------
    InputError
        It is not a scene; the message names the key.
    """
    return validate(Scene, tables, "the scene")


def change_scene(scene: Scene, **tables: Mapping[str, Any] | None) -> Scene:
    """Return a scene with other values of some keys; None takes a key away, or a whole table.

    >>> change_scene(scene, beam={"thickness_mm": 4}, sensors={"count": 5}).beam.thickness_mm
    4.0

    Raises
    ------
    InputError
        It is no scene any more; the message names the key.
    """
    require(scene, Scene, "scene", "what read_scene or make_scene returns")
    changed = scene.model_dump(exclude_unset=True)
    for name, values in tables.items():
        if values is None:
            changed.pop(name, None)
            continue
        require(values, Mapping, name, "a table, as a dict of its keys")
        changed[name] = {**changed.get(name, {}), **values}
    return make_scene(**_without_none(changed))


def format_scene(scene: Scene) -> str:
    """Return a scene as TOML text with the keys that it states, a line for each key.

    >>> print(format_scene(scene)[:24])
    [beam]
    length_mm = 400.0
    """
    require(scene, Scene, "scene", "what read_scene or make_scene returns")
    tables = _without_none(scene.model_dump(mode="json", exclude_unset=True))
    return "\n".join(
        f"[{name}]\n" + "".join(f"{key} = {_toml(value)}\n" for key, value in table.items())
        for name, table in tables.items()
    )


def identity_of(scene: Scene, sensors_mm: "Mapping[str, Place]") -> str:
    """Return the identity of the structure of a scene with sensors, by the names of their channels, at places [mm].

    Raises
    ------
    SceneError
        The scene states no structure.
    """
    if scene.plate is not None:
        return identity_of_plate(scene.plate, {name: _numbers(place) for name, place in sensors_mm.items()})
    if scene.measured is not None:
        error_mm = scene.sensors.noise_mm, scene.sensors.zero_drift_mm
        places_mm = {name: _numbers(place) for name, place in sensors_mm.items()}
        return identity_of_measured(scene.measured, places_mm, error_mm)
    return identity_of_beam(scene.beam, {name: _numbers(place)[0] for name, place in sensors_mm.items()})


def _numbers(place: "Place") -> tuple[float, ...]:
    return place if isinstance(place, tuple) else (place,)


def _without_none(tables: Mapping[str, Mapping[str, Any] | None]) -> dict[str, dict[str, Any]]:
    stated = ((name, table) for name, table in tables.items() if table is not None)
    return {name: {key: value for key, value in table.items() if value is not None} for name, table in stated}


def _toml(value: object) -> str:
    """Return a value as TOML; its numbers, texts, truth values and lists are those of JSON."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_toml(item)}' for key, item in value.items() if item is not None)} }}"
    if isinstance(value, str) and "\n" in value:
        return f'"""\n{value}"""'  # a table; it has no quotes
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(value)


def load_scene(path: Path) -> tuple[Scene, str]:
    """Read the scene file of a command, which states a structure; returns the scene and its text, with all tables.

    Raises InputError as `parse_scene` does.
    """
    text = read_text(path)
    scene = _parse_file(path, text)
    if scene.measured is not None:
        return scene, format_scene(scene)
    if not scene.is_computed:
        raise InputError(f"{path}: beam is missing; add it")
    return scene, text


def _parse_file(path: Path, text: str) -> Scene:
    return parse_toml(Scene, text, str(path), context={FOLDER: path.parent})


def parse_scene(text: str, origin: str) -> Scene:
    """Read a scene from TOML text; raises InputError as `beamtouch_common.files.parse_toml` does."""
    return parse_toml(Scene, text, origin)
