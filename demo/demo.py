"""A live demo: rigs, service and daemon as real processes, and a table of true and reported contacts.

Two surfaces of the same model run side by side, one over Modbus TCP, the other over the serial protocol.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx2
from rich.box import SIMPLE
from rich.console import Console
from rich.live import Live
from rich.table import Table

from line import Line, Surface, Truth

ROOT = Path(__file__).parent.parent
SCENE = ROOT / "models" / "scenes" / "bench.toml"
BUILT = ROOT / "build" / "demo"
SURFACES = (Surface("modbus", "modbus-tcp"), Surface("serial", "serial"))
PERIOD_S = 0.1
TRUTH_DELAY_S = 0.05
"""Wait before a contact is compared: the rig writes the true load every 10 ms."""
LENGTH_MM = 400.0
MIDDLE_MM = (60.0, 340.0)

PICTURE = """<svg viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg">
<style>.{unique_id}-matrix {{ font-family: monospace; font-size: {char_height}px; line-height: {line_height}px; }}
{styles}</style>
<defs>{lines}</defs>
<rect width="100%" height="100%" rx="8" fill="#292929"/>
<g transform="translate({terminal_x}, {terminal_y})">{backgrounds}
<g class="{unique_id}-matrix">{matrix}</g></g>
</svg>
"""
"""SVG template without external resources; the default template of rich loads fonts."""


@dataclass
class Watched:
    """One surface on the screen and its errors so far."""

    surface: Surface
    truth: Truth
    answer: dict[str, Any] = field(default_factory=dict)
    true_position_mm: float | None = None
    true_force_n: float = 0.0
    errors_mm: list[float] = field(default_factory=list)
    middle_errors_mm: list[float] = field(default_factory=list)

    @property
    def error_mm(self) -> float | None:
        """Reported minus true position; None unless both have a contact."""
        if self.answer.get("state") != "contact" or self.true_position_mm is None:
            return None
        return float(self.answer["position_mm"]) - self.true_position_mm

    def ask(self, client: httpx2.Client) -> None:
        """Get the contact, and the true load at the time of its sample."""
        response = client.get(f"/surfaces/{self.surface.name}/contact")
        self.answer = response.json()
        time.sleep(TRUTH_DELAY_S)
        self.truth.read()
        moment = self.truth.at(_unix(self.answer["sampled_at"])) if response.is_success else None
        self.true_position_mm, self.true_force_n = moment or (None, 0.0)
        error = self.error_mm
        if error is not None and self.true_position_mm is not None:
            self.errors_mm.append(abs(error))
            if MIDDLE_MM[0] <= self.true_position_mm <= MIDDLE_MM[1]:
                self.middle_errors_mm.append(abs(error))


def main() -> int:
    """Run the demo; returns 0 if both surfaces reported contacts and nothing failed."""
    parser = argparse.ArgumentParser(description="Show live contacts of two virtual surfaces.")
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S", help="duration in seconds (default 20)")
    parser.add_argument("--picture", type=Path, metavar="FILE.svg", help="also save the output as a picture")
    options = parser.parse_args()
    console = Console(width=None if sys.stdout.isatty() else 80, record=options.picture is not None)
    code = _run(console, options.seconds)
    if options.picture is not None:
        console.save_svg(str(options.picture), title="make demo", code_format=PICTURE)
    return code


def _run(console: Console, seconds: float) -> int:
    try:
        model, daemon_config = _model(console)
        with tempfile.TemporaryDirectory(prefix="beamtouch-demo-") as folder:
            line = Line(Path(folder), SCENE, model, daemon_config, SURFACES)
            with line:
                watched = _watch(line, console, seconds)
                failed = line.dead()
                for name in failed:
                    console.print(f"{name} ended unexpectedly:\n{line.log(name)}")
            summary = json.loads(line.summary.read_text())["surfaces"] if line.summary.exists() else {}
    except KeyboardInterrupt:
        console.print("stopped")
        return 0
    except (RuntimeError, subprocess.CalledProcessError) as error:
        console.print(f"demo: {error}")
        return 1
    return _summarise(console, watched, summary) if not failed else 1


def _model(console: Console) -> tuple[Path, Path]:
    """Return the paths of the model and the daemon's config; builds both if one is missing."""
    model, config = BUILT / "bench.onnx", BUILT / "daemon.toml"
    if not model.exists() or not config.exists():
        BUILT.mkdir(parents=True, exist_ok=True)
        console.print(f"building the model of {SCENE.relative_to(ROOT)} (once, about 20 s)")
        program = Path(sys.executable).parent / "design-sensors"
        command = [program, "build", SCENE, "-o", model, "--daemon-config", config, "--json"]
        subprocess.run(list(map(str, command)), check=True, stdout=subprocess.DEVNULL)
    return model, config


def _watch(line: Line, console: Console, seconds: float) -> list[Watched]:
    """Ask for contacts until the time is up or Ctrl-C is pressed; returns the surfaces with their errors."""
    watched = [Watched(surface, Truth(line.truth(surface.name))) for surface in line.surfaces]
    next_print = 0.0
    live = Live(console=console, auto_refresh=False) if console.is_terminal else None
    try:
        with httpx2.Client(base_url=line.url) as client:
            _wait_until_ready(line, client)
            start = time.monotonic()
            if live:
                live.start()
            while (elapsed := time.monotonic() - start) < seconds and not line.dead():
                for one in watched:
                    one.ask(client)
                if live:
                    live.update(_table(watched, elapsed), refresh=True)
                elif elapsed >= next_print:
                    console.print(_table(watched, elapsed))
                    next_print += 2.0
                time.sleep(max(0.0, PERIOD_S - (time.monotonic() - start - elapsed)))
    except KeyboardInterrupt:
        console.print("stopped early")
    finally:
        if live:
            live.stop()
        for one in watched:
            one.truth.close()
    return watched


def _wait_until_ready(line: Line, client: httpx2.Client) -> None:
    """Wait until both surfaces have samples, for at most 10 s."""
    deadline = time.monotonic() + 10
    while not client.get("/health/ready").is_success and time.monotonic() < deadline and not line.dead():
        time.sleep(0.05)


def _table(watched: list[Watched], elapsed: float) -> Table:
    table = Table(title=f"contacts after {elapsed:.1f} s (age in ms)", box=SIMPLE)
    for heading in ("surface", "true mm", "found", "95 % interval", "error", "true N", "found", "age"):
        table.add_column(heading, justify="left" if heading == "surface" else "right", no_wrap=True)
    for one in watched:
        table.add_row(one.surface.name, *_cells(one))
    return table


def _cells(one: Watched) -> list[str]:
    answer = one.answer
    if "state" not in answer:
        return ["", "none", str(answer["type"]).rpartition(":")[2], "", "", "", ""]
    true = ("", "") if one.true_position_mm is None else (f"{one.true_position_mm:.1f}", f"{one.true_force_n:.1f}")
    age = f"{answer['age_ms']:.0f}"
    if answer["state"] == "clear":
        return [true[0], "clear", "", "", true[1], "", age]
    interval = f"{answer['position_low_mm']:.1f}..{answer['position_high_mm']:.1f}"
    error = "" if one.error_mm is None else f"{one.error_mm:+.1f}"
    force = f"{answer['force_n']:.1f}"
    return [true[0], f"{answer['position_mm']:.1f}", interval, error, true[1], force, age]


def _summarise(console: Console, watched: list[Watched], summary: dict[str, dict[str, int]]) -> int:
    """Print the mean errors and the sample counts; returns the exit code."""
    table = Table(title="summary: mean error of contacts, samples", box=SIMPLE)
    for heading in ("surface", "contacts", "whole beam", "60..340 mm", "published", "lost"):
        table.add_column(heading, justify="left" if heading == "surface" else "right", no_wrap=True)
    complete = True
    for one in watched:
        counts = summary.get(one.surface.name, {})
        table.add_row(
            one.surface.name,
            str(len(one.errors_mm)),
            _mean(one.errors_mm),
            _mean(one.middle_errors_mm),
            str(counts.get("samples_published", "unknown")),
            str(counts.get("samples_dropped", "unknown")),
        )
        complete = complete and bool(one.errors_mm) and bool(counts)
    console.print(table)
    if not complete:
        console.print("a surface reported no contact, or the daemon wrote no counts")
    return 0 if complete else 1


def _mean(errors_mm: list[float]) -> str:
    if not errors_mm:
        return "none"
    mean = sum(errors_mm) / len(errors_mm)
    return f"{mean:.2f} mm {mean / LENGTH_MM * 100:.2f} %"


def _unix(text: str) -> float:
    return datetime.fromisoformat(text).timestamp()


if __name__ == "__main__":
    sys.exit(main())
