"""The text of a new scene, with comments, from a few answers."""

from dataclasses import asdict, dataclass
from importlib.resources import files
from typing import Literal

import numpy as np

from beamtouch_models.design.physics.beam import influence
from beamtouch_models.design.pricing.noise import ZERO_SHARE
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.design.scene.materials import MATERIALS, MaterialName

End = Literal["clamped", "pinned", "roller", "free"]
BENDS = 1 / 3
"""Deflection under the assumed largest force over the range of a sensor."""
SLOPES = 0.03
"""Slope under the assumed largest force, in rad: well within small-angle theory."""
MARGIN = 0.02
"""Part of the length near a support where the beam moves too little for a contact."""
SUPPORTS: dict[End, tuple[str, str]] = {
    "clamped": ('kind = "fixed"', "clamped: it can neither turn nor move"),
    "pinned": ('kind = "simple", slides = false', "pinned: it can turn, not slide"),
    "roller": ('kind = "simple"', "on a roller: it can turn and slide"),
}


@dataclass(frozen=True)
class Answers:
    """Answers of an engineer; None: a value is assumed, and the scene says so."""

    length_mm: float
    width_mm: float
    thickness_mm: float
    material: MaterialName = "steel"
    left: End = "pinned"
    right: End = "roller"
    roller_mm: tuple[float, ...] = ()
    """Rollers between the ends."""
    force_n: tuple[float, float] | None = None
    position_mm: tuple[float, float] | None = None
    sensors: int = 4
    noise_mm: float = 0.005
    rate_hz: float = 200.0
    range_mm: tuple[float, float] = (1.0, 4.0)
    size_mm: float | None = None
    latency_ms: float = 20.0
    position_error_mm: float | None = None


def scene_text(answers: Answers, name: str) -> str:
    """Return the scene as TOML. It may still be refused, so load it after writing.

    Raises
    ------
    ValidationError
        The beam of the answers cannot stand.
    SceneError
        It cannot be computed.
    """
    length = answers.length_mm
    ends: list[tuple[float, End]] = [(0.0, answers.left), (length, answers.right)]
    rows = [
        f"    {{ at_mm = {support_mm:.12g}, {SUPPORTS[end][0]} }},  # {SUPPORTS[end][1]}"
        for support_mm, end in _held(answers)
    ]
    edge = [MARGIN * length if end != "free" else 0.0 for _, end in ends]
    places = answers.position_mm or (edge[0], length - edge[1])
    wanted = answers.position_error_mm
    assumed = "assumed: it uses up to a third of range_mm; state yours"
    values = asdict(answers) | {
        "name": name,
        "known": MATERIALS[answers.material],
        "supports": "\n".join(rows),
        "position_mm": places,
        "where": "where contacts may be" if answers.position_mm else "near a support the beam moves too little",
        "drift_mm": answers.noise_mm * ZERO_SHARE,
        "size": "# size_mm = 8" if answers.size_mm is None else f"size_mm = {answers.size_mm:.12g}",
        "force_n": answers.force_n or _assumed_force_n(answers, places),
        "told": "smallest and largest" if answers.force_n else assumed,
        "middle_mm": (length / 2 - 10, length / 2 + 10),
        "error": "# position_error_mm = 10" if wanted is None else f"position_error_mm = {wanted:.12g}",
    }
    return files(__package__).joinpath("new_scene.toml.txt").read_text(encoding="utf-8").format_map(values)


def _held(answers: Answers) -> list[tuple[float, End]]:
    """Return where and how the beam is held, from left to right."""
    ends: list[tuple[float, End]] = [(0.0, answers.left), (answers.length_mm, answers.right)]
    rollers: list[tuple[float, End]] = [(roller_mm, "roller") for roller_mm in answers.roller_mm]
    return sorted((support_mm, end) for support_mm, end in ends + rollers if end != "free")


def _assumed_force_n(answers: Answers, places_mm: tuple[float, float]) -> tuple[float, float]:
    """Return a range of forces that suits a beam: a tenth to all of what bends or slopes it as far as is assumed."""
    beam = Beam.model_validate(
        {
            "length_mm": answers.length_mm,
            "material": answers.material,
            "width_mm": answers.width_mm,
            "thickness_mm": answers.thickness_mm,
            "supports": [
                {"at_mm": support_mm, "kind": "fixed" if end == "clamped" else "simple"}
                for support_mm, end in _held(answers)
            ],
        }
    )
    position_mm = np.linspace(0.0, answers.length_mm, 201)
    shape = influence(beam, position_mm, np.linspace(*places_mm, 41))
    slope = float(np.abs(np.diff(shape, axis=1)).max() / position_mm[1])
    most = min(BENDS * (answers.range_mm[1] - answers.range_mm[0]) / float(np.abs(shape).max()), SLOPES / slope)
    largest = float(f"{most:.2g}")
    return float(f"{largest / 10:.2g}"), largest
