"""Figures with their numbers, and a verdict on each statement of the paper; `statements.csv` lists the statements."""

import csv
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Literal

from beamtouch_models.charts import Chart

Numbers = dict[str, Any]
"""Numbers by name, for JSON."""
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
    """Which statements of the paper hold here."""

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
        curves = [{"label": one.label, "x": list(one.x), "y": list(one.y)} for one in self.chart.series]
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
