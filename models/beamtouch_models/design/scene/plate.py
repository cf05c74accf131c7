"""The plate of a scene: its supports, its material, and its identity."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, ValidationError, model_validator

from beamtouch_common.complaints import reason_of
from beamtouch_models.design.scene.beam import DIGITS, SMALLEST_NORMAL, text_of
from beamtouch_models.design.scene.materials import MATERIALS, MaterialName, density_kg_m3_of, expansion_per_k_of
from beamtouch_models.design.scene.tables import DampingRatio, Finite, PositiveFinite, Strict
from beamtouch_models.errors import SceneError

POISSON_RATIO = 0.3
"""Of a plate that states neither a material nor a ratio: that of most metals."""
MAX_SUPPORTS = 64
LEAST_SPREAD = 1e-3
"""Least distance of a support from the line through the others, over the plate's longer side."""


class PlateSupport(Strict):
    """A support: a point, or a line across the whole plate if only one coordinate is stated."""

    x_mm: Finite | None = None
    """Distance from the left edge; without it, the support is a line along x."""
    y_mm: Finite | None = None
    """Distance from the lower edge; without it, the support is a line along y."""
    stiffness_n_per_mm: PositiveFinite | None = None
    """Stiffness of its spring, of a line as a whole; without it, that of `support_stiffness_n_per_mm`."""

    @model_validator(mode="after")
    def _is_somewhere(self) -> Self:
        if self.x_mm is None and self.y_mm is None:
            raise ValueError("give x_mm and y_mm for a point, or one of them for a line across the plate")
        return self

    @property
    def is_line(self) -> bool:
        """True if it is a line across the plate."""
        return self.x_mm is None or self.y_mm is None


PlateSupportName = Literal["corners", "edges"]
# The tags keep a bad entry of a list from being reported as a bad name. Their hyphen keeps them out of messages.
PlateSupports = Annotated[
    Annotated[PlateSupportName, Tag("a-name")]
    | Annotated[tuple[PlateSupport, ...], Field(strict=False, max_length=MAX_SUPPORTS), Tag("a-list")],
    Discriminator(lambda value: "a-name" if isinstance(value, str) else "a-list"),
]


class Plate(Strict):
    """A thin rectangular plate and its supports. Places count from its lower left corner, as seen from above."""

    length_x_mm: PositiveFinite
    """Length along x, from left to right."""
    length_y_mm: PositiveFinite
    """Length along y, from below to above."""
    thickness_mm: PositiveFinite
    """Thickness, in the direction of the load."""
    supports: PlateSupports = "corners"
    """"corners", "edges" (all four, free to rotate), or a list: [{x_mm = 10, y_mm = 10}, ...]."""
    support_stiffness_n_per_mm: PositiveFinite | None = None
    """Stiffness of the spring in each support that states none: of a corner, or of a whole edge; without it, supports
    are rigid."""
    material: MaterialName | None = None
    """Name of a material whose values hold where the scene does not state them."""
    youngs_modulus_gpa: PositiveFinite | None = None
    """Modulus of elasticity: steel 210, stainless steel 193 to 200, aluminium 70."""
    poisson_ratio: Annotated[float, Field(gt=-1, le=0.5)] | None = None
    """Poisson's ratio; by default that of the material, or 0.3."""
    density_kg_m3: PositiveFinite | None = None
    """Density; with it, sag and ringing are computed. Without it, neither is known."""
    expansion_um_per_m_k: PositiveFinite | None = None
    """Coefficient of linear thermal expansion."""
    damping_ratio: DampingRatio | None = None
    """Damping over critical damping of the lowest mode; by default 0.01."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not SMALLEST_NORMAL <= self.rigidity_n_mm < math.inf:
            raise ValueError(f"a flexural rigidity of {self.rigidity_n_mm:g} N mm cannot be computed with")
        self._check_supports()
        return self

    def _check_supports(self) -> None:
        """Raise ValueError if supports are off the plate, coincide, or let the plate tilt freely."""
        if not self.supports:
            raise ValueError("supports: nothing carries the plate; add supports")
        for support in self.support_list:
            for key, value, length in zip(("x_mm", "y_mm"), _where(support), self.size_mm, strict=True):
                if value is not None and not 0 <= value <= length:
                    raise ValueError(f"supports: {key} = {value:g} lies off the plate, 0..{length:g} mm")
        places = [_where(support) for support in self.support_list]
        for place in places:
            if places.count(place) > 1:
                raise ValueError(f"supports: two stand at {in_words(place)}; keep one")
        if not _spread(self.support_points) > LEAST_SPREAD * max(self.size_mm):
            raise ValueError("supports: all lie on one line, so the plate can tilt; add a support beside that line")

    @property
    def size_mm(self) -> tuple[float, float]:
        """Length along each axis."""
        return self.length_x_mm, self.length_y_mm

    @property
    def length_mm(self) -> float:
        """Length along the first axis."""
        return self.length_x_mm

    @property
    def held_mm(self) -> tuple[float, ...]:
        """Places on the first axis at which all of the plate is held: of a beam, its supports; of a plate, none."""
        return ()

    @property
    def support_list(self) -> tuple[PlateSupport, ...]:
        """The supports, each with its own stiffness; None where it is rigid."""
        if not isinstance(self.supports, str):
            supports: Sequence[PlateSupport] = self.supports
        elif self.supports == "corners":
            ends = [(x, y) for x in (0.0, self.length_x_mm) for y in (0.0, self.length_y_mm)]
            supports = [PlateSupport(x_mm=x, y_mm=y) for x, y in ends]
        else:
            supports = [PlateSupport(x_mm=x) for x in (0.0, self.length_x_mm)]
            supports += [PlateSupport(y_mm=y) for y in (0.0, self.length_y_mm)]
        stiffness = self.support_stiffness_n_per_mm
        return tuple(
            support if support.stiffness_n_per_mm else support.model_copy(update={"stiffness_n_per_mm": stiffness})
            for support in supports
        )

    @property
    def support_points(self) -> tuple[tuple[float, float], ...]:
        """Points of the supports, with both ends of a line."""
        points = []
        for support in self.support_list:
            ends = [(0.0, length) if value is None else (value,) for value, length in _ends(support, self.size_mm)]
            points += [(x, y) for x in ends[0] for y in ends[1]]
        return tuple(points)

    @property
    def is_sprung(self) -> bool:
        """True if all supports give way."""
        return all(support.stiffness_n_per_mm is not None for support in self.support_list)

    @property
    def modulus_gpa(self) -> float:
        """Young's modulus, as stated or of the material; ValueError if the scene gives neither."""
        if self.youngs_modulus_gpa is not None:
            return self.youngs_modulus_gpa
        if self.material is None:
            raise ValueError("give material or youngs_modulus_gpa")
        return MATERIALS[self.material].youngs_modulus_gpa

    @property
    def poisson(self) -> float:
        """Poisson's ratio, as stated, of the material, or 0.3."""
        if self.poisson_ratio is not None:
            return self.poisson_ratio
        return POISSON_RATIO if self.material is None else MATERIALS[self.material].poisson_ratio

    @property
    def rigidity_n_mm(self) -> float:
        """Flexural rigidity E t^3 / (12 (1 - nu^2)), in N mm; Timoshenko & Woinowsky-Krieger, 1959, eq. 3."""
        thickness = self.thickness_mm
        return self.modulus_gpa * 1e3 * (thickness * thickness * thickness) / (12 * (1 - self.poisson**2))

    @property
    def mass_density_kg_m3(self) -> float | None:
        """Density, as stated or of the material; None if the scene gives neither."""
        return density_kg_m3_of(self.density_kg_m3, self.material)

    @property
    def expansion_per_k(self) -> float | None:
        """Coefficient of thermal expansion in 1/K, as stated or of the material; None if the scene gives neither."""
        return expansion_per_k_of(self.expansion_um_per_m_k, self.material)


def stiffened_plate(plate: Plate, rigidity: float, spring_stiffness: Sequence[float] | None = None) -> Plate:
    """Return a plate with `rigidity` times its rigidity and the stiffness of its springs.

    `spring_stiffness` has another factor on the spring in each support. Raises SceneError if these cannot be computed
    with.
    """
    factors = [1.0] * len(plate.support_list) if spring_stiffness is None else spring_stiffness
    if len(factors) != len(plate.support_list):
        raise SceneError(f"spring_stiffness has {len(factors)} entries for {len(plate.support_list)} supports")
    fields: dict[str, Any] = plate.model_dump()
    fields["youngs_modulus_gpa"] = plate.modulus_gpa * rigidity
    fields["support_stiffness_n_per_mm"] = None
    stiffness = [support.stiffness_n_per_mm for support in plate.support_list]
    fields["supports"] = [
        support.model_dump() | {"stiffness_n_per_mm": spring and spring * rigidity * factor}
        for support, spring, factor in zip(plate.support_list, stiffness, factors, strict=True)
    ]
    try:
        return Plate.model_validate(fields)
    except ValidationError as error:
        raise SceneError(f"rigidity: {reason_of(error.errors()[0])}") from None


def _where(support: PlateSupport) -> tuple[float | None, float | None]:
    return support.x_mm, support.y_mm


def _ends(support: PlateSupport, size_mm: tuple[float, float]) -> tuple[tuple[float | None, float], ...]:
    return tuple(zip(_where(support), size_mm, strict=True))


def in_words(place: Sequence[float | None]) -> str:
    """Return a place, or a line across the plate, in words."""
    return ", ".join(
        f"{key} = {value:g}" for key, value in zip(("x_mm", "y_mm"), place, strict=True) if value is not None
    )


def _spread(points: Sequence[tuple[float, float]]) -> float:
    """Return the farthest distance of points from the line through the two that are farthest apart."""
    start, end = max(((a, b) for a in points for b in points), key=lambda pair: math.dist(*pair))
    length = math.dist(start, end)
    if length == 0:
        return 0.0
    along = (end[0] - start[0]) / length, (end[1] - start[1]) / length
    return max(abs((x - start[0]) * along[1] - (y - start[1]) * along[0]) for x, y in points)


def identity_of_plate(plate: Plate, sensors_mm: Mapping[str, Sequence[float]]) -> str:
    """Return the identity of a plate with sensors, by the names of their channels, at these places [mm].

    It stands for what decides how the sensors move under a load, as that of a beam does. Six digits of each number
    count.
    """
    supports = [[text_of(value) for value in (*_where(one), one.stiffness_n_per_mm)] for one in plate.support_list]
    facts = {
        "size_mm": [text_of(length) for length in plate.size_mm],
        "rigidity_n_mm": text_of(plate.rigidity_n_mm),
        "poisson_ratio": text_of(plate.poisson),
        "supports": sorted(supports),
        "sensors_mm": {name: [text_of(number) for number in place] for name, place in sensors_mm.items()},
    }
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:DIGITS]
