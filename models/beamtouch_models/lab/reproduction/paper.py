"""The paper: its beam, loads, layouts and noise, and a verdict on each of its statements.

`statements.csv` lists the statements, beside the numbers of a figure.
"""

import csv
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_models.arrays import Floats
from beamtouch_models.design.charts import Chart
from beamtouch_models.design.physics.beam import influence
from beamtouch_models.design.placement import layout_rules
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.beam import Beam

TITLE = (
    "An approach to optimise the critical sensor locations in one-dimensional novel distributive tactile surface to "
    "maximise performance"
)
"""Title of the paper."""
SOURCE = "P. Tongpadungrod, T. D. L. Rhys, P. N. Brett, Sensors and Actuators A: Physical 105 (2003) 47-54"
LENGTH_MM = 400.0
FORCE_N = 10.0
"""Assumed, because the paper does not state its weight; it cancels from all results in percent."""
NOISE_PERCENT = 2.0
"""The lower noise of the paper's figure 4, in percent of the largest deflection."""
LOADS_MM = np.arange(1.0, 400.0)
"""399 load positions, one per mm along the beam, as in section 3."""
SCENE = Scene.model_validate(
    {
        # The paper states neither section nor modulus; 25 x 3 mm of steel stays within the sensors' 3 mm of travel.
        "beam": {"length_mm": LENGTH_MM, "youngs_modulus_gpa": 210.0, "width_mm": 25.0, "thickness_mm": 3.0},
        # The paper's weight is the same for every contact.
        "contact": {"force_n": FORCE_N, "force_tolerance_percent": 0.0, "position_mm": (1.0, 399.0)},
        "sensors": {"count": 2, "noise_percent_of_max": NOISE_PERCENT, "range_mm": (1.0, 4.0), "size_mm": 0.0},
    }
)
_UNIT_BEAM = Beam(length_mm=1.0, flexural_rigidity_n_mm2=1.0)
MAX_DEFLECTION = 1 / 48
"""Deflection at a load in the middle, in units of W l^3/(EI)."""


def equal_pitch_mm(count: int) -> Floats:
    """Return the positions of sensors that divide the beam into equal parts; (count,) in mm."""
    return layout_rules.equal_pitch_mm(np.array([LENGTH_MM]), count)[:, 0]


def dimensionless(sensor_mm: ArrayLike) -> Floats:
    """Return the influence matrix of a layout, (399, sensors), with lengths in units of l and W/(EI) = 1."""
    return influence(_UNIT_BEAM, np.asarray(sensor_mm) / LENGTH_MM, LOADS_MM / LENGTH_MM)


def deflection_mm(sensor_mm: ArrayLike, load_mm: ArrayLike = LOADS_MM) -> Floats:
    """Return the deflection at each sensor under the paper's weight, (loads, sensors) in mm."""
    return FORCE_N * influence(SCENE.beam, sensor_mm, load_mm)


Numbers = dict[str, Any]
"""Numbers by name, for JSON."""
HEAD = ("statement", "paper", "here", "verdict")
Verdict = Literal["agrees", "differs", "not stated"]


@dataclass(frozen=True)
class Row:
    """One statement of the paper beside ours."""

    quantity: str
    paper: str
    """Empty if the paper states nothing."""
    ours: str
    verdict: Verdict
    why: str = ""
    """The reason of a difference."""

    @property
    def verdict_text(self) -> str:
        """The verdict in words, with its reason."""
        said = "not stated in the paper;" if self.verdict == "not stated" else f"{self.verdict}:"
        return f"{said} {self.why}" if self.why else said[:-1]

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """The cells of the table of statements, whose head is `HEAD`."""
        return self.quantity, self.paper or "-", self.ours, self.verdict_text


def rows_of(figure: str, numbers: Numbers, checks: dict[str, bool]) -> list[Row]:
    """Return the rows of a figure, or of the misprints.

    `checks` says which statements hold here, by the name of each in `statements.csv`. A statement without a name is
    ours alone. The others give a reason only where they differ.
    """
    rows = []
    text = (files(__package__) / "statements.csv").read_text(encoding="utf-8")
    for line in csv.DictReader(text.splitlines()):
        if line["figure"] == figure:
            verdict: Verdict = "not stated"
            if line["check"]:
                verdict = "agrees" if checks[line["check"]] else "differs"
            reason = "" if verdict == "agrees" else line["reason"].format(**numbers)
            rows.append(Row(line["statement"], line["paper"], line["here"].format(**numbers), verdict, reason))
    return rows


@dataclass(frozen=True)
class Figure:
    """A figure of the paper, reproduced."""

    number: int
    name: str
    chart: Chart
    numbers: Numbers
    checks: dict[str, bool]
    """Statements of the paper, each with its outcome here."""

    @property
    def file_name(self) -> str:
        """Name of the plot's file."""
        return f"figure-{self.number}-{self.name}.svg"

    @property
    def rows(self) -> list[Row]:
        """Its rows of the table."""
        return rows_of(str(self.number), self.numbers, self.checks)

    def results(self) -> Numbers:
        """Return its numbers and the points of its plot, for JSON."""
        curves = [{"label": series.label, "x": list(series.x), "y": list(series.y)} for series in self.chart.series]
        return self.numbers | {"curves": curves}


def rounded(values: Any) -> Any:  # noqa: ANN401  # an array of any shape, a number, or several by name
    """Round numbers for JSON to seven significant digits; further digits would be rounding noise."""
    if hasattr(values, "tolist"):
        values = values.tolist()
    if isinstance(values, dict):
        return {name: rounded(value) for name, value in values.items()}
    if isinstance(values, list | tuple):
        return [rounded(value) for value in values]
    return float(f"{values:.7g}") if isinstance(values, float) else values
