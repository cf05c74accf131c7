"""One scene of `design-sensors trade`: its folder, its front, and the model that is asked for."""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from beamtouch_common.digits import digits
from beamtouch_common.files import write_atomically
from beamtouch_models import loading
from beamtouch_models.building.build import Choices, build
from beamtouch_models.building.remarks import remarks
from beamtouch_models.commands.build import surface_name
from beamtouch_models.commands.progress import shown_progress
from beamtouch_models.commands.reproduce import folder_of
from beamtouch_models.errors import ModelFileError
from beamtouch_models.estimators.estimator import Name
from beamtouch_models.placement import Aim
from beamtouch_models.pricing.noise import growing
from beamtouch_models.progress import Progress
from beamtouch_models.scene import Scene
from beamtouch_models.sweeps import Spread
from beamtouch_models.trade.front import most_accurate, named, pareto_front, quickest
from beamtouch_models.trade.plots import plot, since_touch_plot
from beamtouch_models.trade.point import Point
from beamtouch_models.trade.quantised import quantised
from beamtouch_models.trade.results import HEADINGS, json_of, markdown, row, said
from beamtouch_models.trade.sweep import Results, Sweep

WIDTH_WITHOUT_TERMINAL = 180
LAYOUTS = Aim("eigenvalue-product")
"""The layouts of the points, so that the model is the one that was measured."""


class TradedScene:
    """A scene with the folder of its results, which always has the newest."""

    def __init__(self, path: Path, scene: Scene, text: str, folder: Path, options: argparse.Namespace) -> None:
        """Take over a loaded scene; nothing is written yet."""
        self.path, self.name = path, surface_name(path)
        self._scene, self._text, self._folder, self._options = scene, text, folder, options
        self._sweep: Sweep | None = None
        self._kept: Results | None = None
        self.is_gathered = False
        """Whether workers have measured all that they can."""

    @property
    def remarks(self) -> list[str]:
        """What an engineer should look at again in the scene."""
        return remarks(self._scene)

    @property
    def planned(self) -> int:
        """Number of points if none fails."""
        return self._sweep.planned if self._sweep else 0

    def begin(self, estimators: Sequence[Name], spread: Spread) -> None:
        """Make the folder and begin all tasks; raises SceneError if a build refuses the scene."""
        folder_of(self._folder)
        options = self._options
        self._sweep = Sweep(self._scene, estimators, draws=options.draws, seed=options.seed, spread=spread)

    def gather(self, progress: Progress) -> None:
        """Take what the workers find; raises SceneError if no point can be built."""
        self._begun.gather(progress, self._keep)
        self.is_gathered = True

    def finish(self) -> None:
        """Measure the times, print the front, and build the requested point, NotToBeHadError if there is none."""
        with shown_progress() as progress:
            results = self._begun.finish(progress, self._keep)
        points = results.trade.points
        for failure in results.trade.failures:
            print(f"note: {said(failure)}", file=sys.stderr)
        picked = self._build_picked(points)
        if self._options.json:
            model = str(self._folder / f"{self.name}.onnx")
            chosen = None if picked is None else {"index": points.index(picked), "model": model}
            found = {"scene": str(self.path), "output": str(self._folder), "picked": chosen, **_json(results)}
            print(json.dumps(found), flush=True)
            return
        _show(self.name, pareto_front(points), len(points))
        print(
            f"all {len(points)} points are in {self._folder}: trade.md, trade.svg, since-touch.svg, trade.json",
            file=sys.stderr,
        )
        if picked is not None:
            figures = f"{digits(picked.error_mm, 3)} mm, {digits(picked.latency_ms, 3)} ms"
            print(f"built {self._folder / f'{self.name}.onnx'}: {named(picked)}; {figures}")

    def write_kept(self) -> int:
        """Write the newest results again; returns the number of points."""
        if self._kept is None:
            return 0
        self._write(self._kept)
        return len(self._kept.trade.points)

    @property
    def _begun(self) -> Sweep:
        if self._sweep is None:
            message = "begin first"
            raise RuntimeError(message)
        return self._sweep

    def _keep(self, results: Results) -> None:
        # Kept before they are written: after an interruption between two files, all are written again.
        self._kept = results
        self._write(results)

    def _write(self, results: Results) -> None:
        """Write the results so far, each file as a whole."""
        trade, folder = results.trade, self._folder
        front = pareto_front(trade.points)
        text = markdown(self.name, trade, front, results.physics, results.curves)
        write_atomically(folder / "trade.json", (json.dumps(_json(results), indent=1) + "\n").encode())
        write_atomically(folder / "trade.md", text.encode())
        write_atomically(folder / "trade.svg", plot(trade.points, front).encode())
        if results.curves:
            write_atomically(folder / "since-touch.svg", since_touch_plot(results.curves, trade.points).encode())

    def _build_picked(self, points: Sequence[Point]) -> Point | None:
        """Write the model of the best point within the bound of the options; return that point, None without one."""
        left, options = list(points), self._options
        while left:
            picked = None
            if options.latency_ms is not None:
                picked = most_accurate(left, options.latency_ms)
            elif options.error_mm is not None:
                picked = quickest(left, options.error_mm)
            if picked is None:
                return None
            content = self._built(picked)
            try:
                loading.load_bytes(content, named(picked))
            except ModelFileError as error:
                # Answers of 8-bit weights may depend on how a machine rounds.
                print(f"note: not built: {error}", file=sys.stderr)
                left.remove(picked)
                continue
            write_atomically(self._folder / f"{self.name}.onnx", content)
            return picked
        return None

    def _built(self, point: Point) -> bytes:
        scene, seed = self._scene, self._options.seed
        precision = quantised if point.quantised else lambda graph: graph
        choices = Choices(point.estimator, growing(scene, point.filter), precision, LAYOUTS)
        with shown_progress() as progress:
            return build(
                scene, self._text, self.name, count=point.sensors, seed=seed, progress=progress, choices=choices
            ).content


def _json(results: Results) -> dict[str, object]:
    trade = results.trade
    return json_of(trade, pareto_front(trade.points), results.physics, results.curves)


def _show(name: str, front: Sequence[Point], points: int) -> None:
    console = Console(width=None if sys.stdout.isatty() else WIDTH_WITHOUT_TERMINAL)
    title = f"{name}: the front, {len(front)} of {points} points"
    table = Table(title=title, box=SIMPLE_HEAD, title_justify="left")
    for heading in HEADINGS[1:]:
        table.add_column(heading, justify="left" if heading in ("estimator", "filter") else "right")
    for point in front:
        table.add_row(*row(point, on_front=True)[1:])
    console.print(table)
