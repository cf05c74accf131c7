"""Reproduced figures: plot, numbers, and a verdict on each statement of the paper."""

from dataclasses import dataclass
from typing import Any, Literal

from beamtouch_models.charts import Chart

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
        if self.verdict == "not stated":
            return "not stated in the paper" + (f"; {self.why}" if self.why else "")
        return f"{self.verdict}: {self.why}" if self.why else self.verdict


@dataclass(frozen=True)
class Figure:
    """A figure of the paper, reproduced."""

    number: int
    name: str
    caption: str
    chart: Chart
    results: dict[str, Any]
    """Its numbers, for JSON."""
    rows: tuple[Row, ...]

    @property
    def file_name(self) -> str:
        """Name of the plot's file."""
        return f"figure-{self.number}-{self.name}.svg"


def compared(quantity: str, paper: str, ours: str, *, agrees: bool, why: str) -> Row:
    """Return a row with its verdict; `why` is kept only if it differs."""
    return Row(quantity, paper, ours, "agrees", "") if agrees else Row(quantity, paper, ours, "differs", why)


def rounded(values: Any) -> Any:  # noqa: ANN401  # an array of any shape, or a number
    """Round numbers for JSON to seven significant digits; further digits would be rounding noise."""
    if hasattr(values, "tolist"):
        values = values.tolist()
    if isinstance(values, list):
        return [rounded(value) for value in values]
    return float(f"{values:.7g}") if isinstance(values, float) else values
