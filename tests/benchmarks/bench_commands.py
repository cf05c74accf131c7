"""Time of each command of `design-sensors` on the scene `bench`, beside a Python that does nothing, in turns."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from example_scenes import SCENES

COMMAND = ("-m", "beamtouch_models.cli")
TURNS = 3
GOAL = 3.0
"""Of `--help`, over a Python that does nothing."""


def run() -> list[dict[str, object]]:
    """Time each command from its start to its end."""
    scene = str(SCENES / "bench.toml")
    with tempfile.TemporaryDirectory() as folder:
        commands = {
            "--help": ["--help"],
            "explain": ["explain", scene],
            "place": ["place", scene],
            "build": ["build", scene, "-o", f"{folder}/bench.onnx"],
            "trade": ["trade", scene, "-o", f"{folder}/trade"],
        }
        took_s: dict[str, list[float]] = {"": [], **{name: [] for name in commands}}
        for turn in range(TURNS):
            took_s[""].append(_seconds(["-c", "pass"]))
            for name, words in commands.items():
                if turn == 0 or name != "trade":  # it takes a minute
                    took_s[name].append(_seconds([*COMMAND, *words], Path(folder)))
    nothing_s = median(took_s.pop(""))
    rows: list[dict[str, object]] = [{"name": "python -c pass", "value": nothing_s, "unit": "s"}]
    for name, times_s in took_s.items():
        goal = {"goal": GOAL} if name == "--help" else {}
        ratio = median(times_s) / nothing_s
        rows.append({"name": name, "value": ratio, "unit": "of that", "seconds": median(times_s), **goal})
    return rows


def _seconds(words: list[str], folder: Path | None = None) -> float:
    begin_s = time.perf_counter()
    done = subprocess.run([sys.executable, *words], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return time.perf_counter() - begin_s
