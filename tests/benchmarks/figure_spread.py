"""Spread over seeds of the figures that `build`, `evaluate` and `trade` print, beside their stated standard errors.

`python tests/benchmarks/figure_spread.py [--seeds 20] [--json FILE]`. Each command runs as a user runs it, once per
seed; `evaluate` measures the same model each time. `trade` runs on two numbers of sensors without a filter. Spread and
stated error are in percent of the mean of the figure.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

COMMAND = str(Path(sys.executable).parent / "design-sensors")
SCENES = Path(__file__).parent.parent.parent / "models" / "scenes"
NAMES = ("bench", "conveyor", "paper")
Found = dict[str, tuple[float, float | None]]
"""Figures by name: value, and standard error where one is stated."""


def main() -> int:
    """Run the commands and print a row per figure; returns 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="seeds per command (20)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows to FILE")
    options = parser.parse_args()
    rows = []
    for row in (row for name in NAMES for row in _rows(name, options.seeds)):
        rows.append(row)
        cells = (f"{key} {value:.4g}" if isinstance(value, float) else str(value) for key, value in row.items())
        print("  ".join(cells), flush=True)
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")
    return 0


def _rows(name: str, seeds: int) -> Iterator[dict[str, object]]:
    with tempfile.TemporaryDirectory() as folder:
        scene = SCENES / f"{name}.toml"
        model, work = Path(folder) / "model.onnx", Path(folder)
        _run("build", scene, "-o", model)
        two = work / "two.toml"
        two.write_text(_two_layouts(scene.read_text()))
        for command in ("evaluate", "build", "trade"):
            took, found = [], []
            for seed in range(1, seeds + 1):
                start = time.monotonic()
                if command == "evaluate":
                    found.append(_evaluated(_run("evaluate", model, "--seed", seed)))
                elif command == "build":
                    found.append(_built(_run("build", scene, "-o", work / "other.onnx", "--seed", seed)))
                else:
                    arguments = ("-o", work / "out", "--estimators", "posterior", "--seed", seed)
                    found.append(_traded(_run("trade", two, *arguments)))
                took.append(time.monotonic() - start)
            for figure in found[0]:
                values = np.array([one[figure][0] for one in found])
                stated = [one[figure][1] for one in found]
                mean = float(values.mean())
                yield {
                    "name": f"{command} {name}: {figure}",
                    "mean": mean,
                    "spread, %": float(values.std(ddof=1)) / mean * 100 if mean else 0.0,
                    "stated, %": None if None in stated or not mean else float(np.mean(stated)) / mean * 100,  # type: ignore[arg-type]
                    "s per run": float(np.median(took)),
                }


def _run(*arguments: object) -> dict[str, Any]:
    done = subprocess.run([COMMAND, *map(str, arguments), "--json"], capture_output=True, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def _two_layouts(text: str) -> str:
    """The scene with two numbers of sensors, and no time for a filter."""
    text = re.sub(r"count = (\d+)", lambda found: f"count = [{found[1]}, {int(found[1]) + 1}]", text)
    text = re.sub(r"latency_ms = \d+", "", text)
    rate = re.search(r"rate_hz = (\d+)", text)
    period_ms = 1000 / int(rate[1]) if rate else 10.0
    return text.replace("[requirements]", f"[requirements]\nlatency_ms = {period_ms:g}")


def _evaluated(result: dict[str, Any]) -> Found:
    (one,) = result["evaluations"]
    figures = {f"{part} {key}": one[part][key] for part in ("span", "middle") for key in one[part]}
    figures |= {key: one[key] for key in one if key not in ("span", "middle")}
    return {
        key: (figure["value"], figure["standard_error"])
        for key, figure in figures.items()
        if isinstance(figure, dict) and "standard_error" in figure
    } | {"span worst_mm": (one["span"]["worst_mm"], None)}


def _built(result: dict[str, Any]) -> Found:
    accuracy = result["accuracy"]
    return {
        "error": (accuracy["error_percent"], accuracy["error_standard_error"]),
        "limit": (accuracy["limit_percent"], accuracy["limit_standard_error"]),
        "error over limit": (accuracy["ratio"], accuracy["ratio_standard_error"]),
    }


def _traded(result: dict[str, Any]) -> Found:
    found: Found = {}
    for model in result["models"]:
        if model["changed"] not in (None, "sensors"):
            continue
        of = f"{model['sensors']} sensors"
        for key in ("error_percent", "limit_percent", "ratio"):
            found[f"{of}, {key}"] = (model[key]["value"], model[key]["standard_error"])
    return found


if __name__ == "__main__":
    sys.exit(main())
