"""The whole reproduction: seven figures, their numbers, and the table of verdicts."""

import json
from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

from beamtouch_models.design.charts import draw, standalone
from beamtouch_models.design.estimators.paper_network import MAX_EPOCHS
from beamtouch_models.design.sweeps import Progress
from beamtouch_models.lab.reproduction.figure_8 import NETWORKS, figure_8, layouts_of, measure
from beamtouch_models.lab.reproduction.figures import (
    figure_2,
    figure_3,
    figure_4,
    figure_7,
    figures_5_and_6,
    misprints,
)
from beamtouch_models.lab.reproduction.paper import HEAD, SOURCE, TITLE, Figure, Row

TABLE, RESULTS = "table.md", "results.json"


@dataclass(frozen=True)
class Reproduction:
    """The reproduced figures and the table of verdicts."""

    seed: int
    figures: tuple[Figure, ...]
    misprints: list[Row]

    @property
    def rows(self) -> list[Row]:
        """All rows of the table."""
        return [row for figure in self.figures for row in figure.rows] + self.misprints

    def files(self) -> dict[str, str]:
        """Return the text of every file, by name."""
        plots = {figure.file_name: standalone(draw(figure.chart)) for figure in self.figures}
        return plots | {RESULTS: json.dumps(self.results(), indent=1) + "\n", TABLE: self._page()}

    def results(self) -> dict[str, Any]:
        """Return all numbers and verdicts, for JSON."""
        return {
            "paper": f"{TITLE}. {SOURCE}",
            "seed": self.seed,
            "rows": [asdict(row) for row in self.rows],
            "figures": {str(figure.number): figure.results() for figure in self.figures},
        }

    def summary(self) -> str:
        """Return the number of rows per verdict, in one line."""
        verdicts = Counter(row.verdict for row in self.rows)
        return ", ".join(f"{verdicts[verdict]} {verdict}" for verdict in ("agrees", "differs", "not stated"))

    def _page(self) -> str:
        lines = ["# The paper's figures, reproduced", "", f"The paper: *{TITLE}*. {SOURCE}.", ""]
        lines += [f"Seed {self.seed}. Rows: {self.summary()}. All numbers are in `{RESULTS}`.", ""]
        lines += [f"| {' | '.join(HEAD)} |", "|---|---|---|---|"]
        lines += [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row.cells)} |" for row in self.rows]
        for figure in self.figures:
            lines += [
                "",
                f"![Figure {figure.number}]({figure.file_name})",
                "",
                f"Figure {figure.number}. {figure.chart.says}.",
            ]
        return "\n".join(lines) + "\n"


def reproduce(seed: int, progress: Progress, *, networks: int = NETWORKS, max_epochs: int = MAX_EPOCHS) -> Reproduction:
    """Compute the paper's figures 2 to 8.

    Parameters
    ----------
    seed : seed of everything random; the same seed gives the same bytes
    progress : called with the current step and the fraction done
    networks, max_epochs : number of networks trained for each layout, and the bound on their training
    """
    progress("figures 2 to 4", 0.0)
    first = (figure_2(), figure_3(), figure_4(seed))
    progress("the paper's search", 0.02)
    search = figures_5_and_6(seed)
    progress("placing two to five sensors", 0.1)
    layouts = layouts_of(seed)
    seventh = figure_7(layouts[4, "optimised"])
    measured = measure(
        layouts,
        seed,
        networks=networks,
        max_epochs=max_epochs,
        progress=lambda done: progress("training the paper's networks", 0.15 + 0.8 * done),
    )
    return Reproduction(seed, (*first, *search, seventh, figure_8(measured)), misprints())
