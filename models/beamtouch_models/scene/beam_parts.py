"""Parts of a beam as a scene states them: supports and segments."""

from typing import Annotated, Literal, NamedTuple, Self

from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from beamtouch_models.scene.fields import Finite, Fixity, PositiveFinite, Strict

PINNED, CLAMPED = 'kind = "simple", slides = false', 'kind = "fixed"'
MEANT = {"roller": 'kind = "simple"', "clamped": CLAMPED, "clamp": CLAMPED, "wall": CLAMPED} | dict.fromkeys(
    ("pinned", "pin", "hinge", "hinged"), PINNED
)
"""Other names of supports, and how a scene states them."""


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
    """Whether the beam can move lengthwise on it, as on a roller; by default on a simple support, not on a fixed one.
    It matters only if the temperature changes."""

    @field_validator("kind", mode="before")
    @classmethod
    def _in_words_of_a_scene(cls, value: object) -> object:
        meant = MEANT.get(value.lower()) if isinstance(value, str) else None
        if meant is not None:
            message = f'must be "simple" or "fixed"; for {value}, write {meant}'
            raise ValueError(message)
        return value

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.kind == "fixed" and self.fixity:
            message = "a fixed support has no fixity; make it simple, or leave fixity out"
            raise ValueError(message)
        return self

    @property
    def holds_lengthwise(self) -> bool:
        """Whether the beam cannot move lengthwise on it."""
        return not (self.kind == "simple" if self.slides is None else self.slides)

    @property
    def stiffness(self) -> float:
        """Rotational stiffness in units of E I / L."""
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
END_KINDS: dict[str, tuple[Literal["simple", "fixed"] | None, Literal["simple", "fixed"] | None]] = {
    "simply-supported": ("simple", "simple"),
    "cantilever": ("fixed", None),
    "fixed-fixed": ("fixed", "fixed"),
    "propped": ("fixed", "simple"),
}
"""Supports at the left and the right end, by name."""

# The tags keep a bad entry of a list from being reported as a bad name. Their hyphen keeps them out of messages.
Supports = Annotated[
    Annotated[SupportName, Tag("a-name")] | Annotated[tuple[Support, ...], Field(strict=False), Tag("a-list")],
    Discriminator(lambda value: "a-name" if isinstance(value, str) else "a-list"),
]
