"""The beam of a scene: its supports, segments and sections, an elastic foundation, and its identity."""

import hashlib
import json
import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import Discriminator, Field, Tag, ValidationError, field_validator, model_validator

from beamtouch_common.complaints import reason_of
from beamtouch_models.design.scene.materials import MATERIALS, MaterialName, density_kg_m3_of, expansion_per_k_of
from beamtouch_models.design.scene.tables import DampingRatio, Finite, Fixity, PositiveFinite, Strict
from beamtouch_models.errors import SceneError

SHEAR_COEFFICIENT = 5 / 6
"""Shear coefficient of a rectangular section; Timoshenko & Gere, Mechanics of Materials, 1972, sec. 12.12."""
SMALLEST_NORMAL = 2.0**-1022
"""Smallest float64 with full precision."""

PINNED, CLAMPED = 'kind = "simple", slides = false', 'kind = "fixed"'
MEANT = {"roller": 'kind = "simple"', "clamped": CLAMPED, "clamp": CLAMPED, "wall": CLAMPED} | dict.fromkeys(
    ("pinned", "pin", "hinge", "hinged"), PINNED
)
"""Other names of supports, and how a scene states them."""
END_KINDS: dict[str, tuple[Literal["simple", "fixed"] | None, Literal["simple", "fixed"] | None]] = {
    "simply-supported": ("simple", "simple"),
    "cantilever": ("fixed", None),
    "fixed-fixed": ("fixed", "fixed"),
    "propped": ("fixed", "simple"),
}
"""Supports at the left and the right end, by name."""
DIGITS = 12
"""Hex digits of an identity. Two beams of a million have the same one with a probability of 0.002."""


class Support(Strict):
    """A support: "simple" holds the deflection at zero, "fixed" the slope as well."""

    at_mm: Finite
    """Position from the left end."""
    kind: Literal["simple", "fixed"] = "simple"
    """"simple" holds the deflection at zero, "fixed" the slope as well."""
    fixity: Fixity = 0.0
    """Resistance of a simple support to rotation: 1 / (1 + 3 E I / (k L)), with its rotational stiffness k, E I of the
    stiffest section and the beam's length L. 0 is a hinge; values near 1 approach a fixed end. Monforton & Wu, Matrix
    analysis of semi-rigidly connected frames, J. Struct. Div. ASCE 89 (1963)."""

    slides: bool | None = None
    """True if the beam can move lengthwise on it, as on a roller; by default on a simple support, not on a fixed one.
    It matters only if the temperature changes."""

    @field_validator("kind", mode="before")
    @classmethod
    def _in_words_of_a_scene(cls, value: object) -> object:
        meant = MEANT.get(value.lower()) if isinstance(value, str) else None
        if meant is not None:
            raise ValueError(f'must be "simple" or "fixed"; for {value}, write {meant}')
        return value

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.kind == "fixed" and self.fixity:
            raise ValueError("a fixed support has no fixity; make it simple, or leave fixity out")
        return self

    @property
    def holds_lengthwise(self) -> bool:
        """True if the beam cannot move lengthwise on it."""
        return not (self.kind == "simple" if self.slides is None else self.slides)

    @property
    def rotational_stiffness(self) -> float:
        """In units of E I / L."""
        return 3 * self.fixity / (1 - self.fixity)


class Segment(Strict):
    """A stretch of the beam with its own section; keys that it omits are those of the beam."""

    to_mm: PositiveFinite
    """Its end, from the left end of the beam; it begins where the previous segment ends."""
    width_mm: PositiveFinite | None = None
    """Width of its section."""
    thickness_mm: PositiveFinite | None = None
    """Thickness of its section."""
    flexural_rigidity_n_mm2: PositiveFinite | None = None
    """Its E I; give either this or width and thickness."""


class Section(NamedTuple):
    """A stretch of the beam with its resolved section."""

    to_mm: float
    rigidity_n_mm2: float
    area_mm2: float | None
    """None if the scene does not state width and thickness."""
    thickness_mm: float | None = None


SupportName = Literal["simply-supported", "cantilever", "fixed-fixed", "propped"]

# The tags keep a bad entry of a list from being reported as a bad name. Their hyphen keeps them out of messages.
Supports = Annotated[
    Annotated[SupportName, Tag("a-name")] | Annotated[tuple[Support, ...], Field(strict=False), Tag("a-list")],
    Discriminator(lambda value: "a-name" if isinstance(value, str) else "a-list"),
]


class Beam(Strict):
    """The beam, its supports and its foundation."""

    length_mm: PositiveFinite
    """Length of the beam. Positions count from its left end."""
    supports: Supports = "simply-supported"
    """A name, or a list of supports: [{at_mm = 0, kind = "simple"}, ...]."""
    material: MaterialName | None = None
    """Name of a material whose modulus, density and expansion hold where the scene does not state them."""
    youngs_modulus_gpa: PositiveFinite | None = None
    """Modulus of elasticity: steel 210, stainless steel 193 to 200, aluminium 70."""
    shear_modulus_gpa: PositiveFinite | None = None
    """If stated, shear deflection is included (Timoshenko)."""
    width_mm: PositiveFinite | None = None
    """Width of the section."""
    thickness_mm: PositiveFinite | None = None
    """Thickness of the section, in the direction of the load."""
    flexural_rigidity_n_mm2: PositiveFinite | None = None
    """E I; give either this or modulus, width and thickness."""
    density_kg_m3: PositiveFinite | None = None
    """Density; with it, sag and ringing are computed. Without it, neither is known."""
    expansion_um_per_m_k: PositiveFinite | None = None
    """Coefficient of linear thermal expansion."""
    damping_ratio: DampingRatio | None = None
    """Damping over critical damping of the lowest mode; by default 0.01. Measure it: in firm clamps it may be 0.001."""
    segments: Annotated[tuple[Segment, ...], Field(strict=False)] = ()
    """Segments from left to right, up to the beam's end; by default the beam is prismatic."""
    foundation_n_mm2: PositiveFinite | None = None
    """Elastic (Winkler) foundation under the whole beam: reaction in N per mm of beam and mm of deflection."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.flexural_rigidity_n_mm2 is not None and self.youngs_modulus_gpa is not None:
            raise ValueError("give youngs_modulus_gpa or flexural_rigidity_n_mm2, not both")
        if self.segments:
            self._check_segments()
        for section in self.sections:
            if not SMALLEST_NORMAL <= section.rigidity_n_mm2 < math.inf:
                raise ValueError(f"a flexural rigidity of {section.rigidity_n_mm2:g} N mm^2 cannot be computed with")
            if self.shear_modulus_gpa is not None and section.area_mm2 is None:
                raise ValueError("shear_modulus_gpa needs width_mm and thickness_mm as well")
        self._check_supports()
        return self

    def _check_segments(self) -> None:
        ends = [segment.to_mm for segment in self.segments]
        if any(start >= end for start, end in pairwise(ends)):
            raise ValueError(f"segments: to_mm = {ends} must ascend")
        if ends[-1] != self.length_mm:
            message = f"segments end at {ends[-1]:g} mm, the beam at {self.length_mm:g} mm; they must cover it exactly"
            raise ValueError(message)

    def _check_supports(self) -> None:
        """Raise ValueError if supports are off the beam, coincide, or leave the beam free to move."""
        places = [support.at_mm for support in self.support_list]
        if any(not 0 <= place <= self.length_mm for place in places):
            raise ValueError(f"supports at {places} mm: one lies off the beam, 0..{self.length_mm:g} mm")
        if len(set(places)) < len(places):
            raise ValueError(f"supports at {places} mm: two stand at the same place; keep one")
        if self.foundation_n_mm2 is not None or any(
            support.kind == "fixed" or support.fixity for support in self.support_list
        ):
            return
        if not places:
            raise ValueError("supports: nothing carries the beam; add supports or a foundation")
        if len(places) == 1:
            raise ValueError("supports: one simple support lets the beam rotate: add a support or make it fixed")

    @property
    def support_list(self) -> tuple[Support, ...]:
        """The supports from left to right."""
        if not isinstance(self.supports, str):
            return tuple(sorted(self.supports, key=lambda support: support.at_mm))
        ends = zip((0.0, self.length_mm), END_KINDS[self.supports], strict=True)
        return tuple(Support(at_mm=at_mm, kind=kind) for at_mm, kind in ends if kind is not None)

    @property
    def held_mm(self) -> tuple[float, ...]:
        """Places from left to right at which a support holds the deflection at zero."""
        return tuple(support.at_mm for support in self.support_list)

    @property
    def sections(self) -> tuple[Section, ...]:
        """The sections from left to right; a prismatic beam has one."""
        segments = self.segments or (Segment(to_mm=self.length_mm),)
        return tuple(self._section(segment) for segment in segments)

    def _section(self, segment: Segment) -> Section:
        width = segment.width_mm or self.width_mm
        thickness = segment.thickness_mm or self.thickness_mm
        area = None if width is None or thickness is None else width * thickness
        own = segment.width_mm is not None or segment.thickness_mm is not None
        rigidity = segment.flexural_rigidity_n_mm2
        if own and rigidity is not None:
            raise ValueError("segments: give width_mm and thickness_mm or flexural_rigidity_n_mm2, not both")
        if rigidity is None and not own:
            rigidity = self.flexural_rigidity_n_mm2
        if rigidity is None:
            modulus_gpa = self.modulus_gpa
            if modulus_gpa is None or width is None or thickness is None:
                message = "give youngs_modulus_gpa or material, width_mm and thickness_mm, or flexural_rigidity_n_mm2"
                raise ValueError(message)
            rigidity = modulus_gpa * 1e3 * width * (thickness * thickness * thickness) / 12
        elif segment.flexural_rigidity_n_mm2 is not None:
            area = thickness = None
        return Section(segment.to_mm, rigidity, area, thickness)

    @property
    def modulus_gpa(self) -> float | None:
        """Young's modulus, as stated or of the material; None if the scene gives neither, or the rigidity instead."""
        if self.youngs_modulus_gpa is not None or self.material is None or self.flexural_rigidity_n_mm2 is not None:
            return self.youngs_modulus_gpa
        return MATERIALS[self.material].youngs_modulus_gpa

    @property
    def mass_density_kg_m3(self) -> float | None:
        """Density, as stated or of the material; None if the scene gives neither."""
        return density_kg_m3_of(self.density_kg_m3, self.material)

    @property
    def expansion_per_k(self) -> float | None:
        """Coefficient of thermal expansion in 1/K, as stated or of the material; None if the scene gives neither."""
        return expansion_per_k_of(self.expansion_um_per_m_k, self.material)

    @property
    def rigidity_n_mm2(self) -> float:
        """Flexural rigidity E I of the stiffest section, in N mm^2."""
        return max(section.rigidity_n_mm2 for section in self.sections)


def changed_beam(beam: Beam, rigidity: float, fixity: tuple[float, float]) -> Beam:
    """Return a beam with `rigidity` times its rigidity and with the `fixity` of its first and last support.

    Raises
    ------
    SceneError
        A support that gets a fixity is missing or already fixed, or the rigidity cannot be computed with.
    """
    fields: dict[str, Any] = beam.model_dump()
    fields["youngs_modulus_gpa"] = beam.modulus_gpa
    for part in (fields, *fields["segments"]):
        for key in ("youngs_modulus_gpa", "flexural_rigidity_n_mm2"):
            if part.get(key) is not None:
                part[key] *= rigidity
    if any(fixity):
        supports = [support.model_dump() for support in beam.support_list]
        if len(supports) < (2 if fixity[1] else 1):
            raise SceneError(f"fixity: the beam has {len(supports) or 'no'} support; give 0 for those that it lacks")
        for index, value in zip((0, -1), fixity, strict=True):
            if value and supports[index]["kind"] == "fixed":
                raise SceneError("fixity: that support is already fixed; give it 0")
            if value:
                supports[index]["fixity"] = value
        fields["supports"] = supports
    try:
        return Beam.model_validate(fields)
    except ValidationError as error:
        raise SceneError(f"rigidity: {reason_of(error.errors()[0])}") from None


def identity_of_beam(beam: Beam, sensors_mm: Mapping[str, float]) -> str:
    """Return the identity of a beam with sensors, by the names of their channels, at these positions [mm].

    It stands for what decides how the sensors move under a load: length, rigidity, supports, foundation, positions and
    names. Noise, drift, ranges, requirements and the estimator have no part in it, and neither has a calibration. The
    order of the channels has none either, because samples name them. Six digits of each number count.
    """
    shear = beam.shear_modulus_gpa
    facts = {
        "length_mm": text_of(beam.length_mm),
        "sections": [
            [
                text_of(section.to_mm),
                text_of(section.rigidity_n_mm2),
                text_of(section.area_mm2 if shear is not None else None),
            ]
            for section in beam.sections
        ],
        "shear_modulus_gpa": text_of(shear),
        "foundation_n_mm2": text_of(beam.foundation_n_mm2),
        # Sliding lengthwise moves no sensor.
        "supports": [
            [value if key == "kind" else text_of(value) for key, value in support if key != "slides"]
            for support in beam.support_list
        ],
        "sensors_mm": {name: text_of(position_mm) for name, position_mm in sensors_mm.items()},
    }
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:DIGITS]


def text_of(number: float | None) -> str:
    """Return the text of a number in an identity, empty if there is none."""
    # 0.0 is added because -0.0 is another text.
    return "" if number is None else f"{number + 0.0:.6g}"
