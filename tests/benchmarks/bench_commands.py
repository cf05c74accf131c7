"""The commands of `design-sensors` on the scene `bench`, from end to end: processor time over `python -c pass`."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import monotonic

sys.path.insert(0, str(Path(__file__).parent.parent))

from support.surfaces.example_scenes import SCENES

BARE = [sys.executable, "-c", "pass"]
PROGRAMS = Path(sys.executable).parent
TURNS = 5
"""The least of so many counts, of commands that take a moment only."""
MAX_HELP = 3.0


def run() -> list[dict[str, object]]:
    """Time each command."""
    scene = str(SCENES / "bench.toml")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bare_s = min(spent(BARE, folder)["processor, s"] for _ in range(TURNS))
        rows: list[dict[str, object]] = []
        for program in ("design-sensors", "beamtouch-daemon", "beamtouch-service"):
            found = min((spent([program, "--help"], folder) for _ in range(TURNS)), key=lambda one: one["processor, s"])
            rows.append(row(f"{program} --help", found, bare_s) | {"goal": f"at most {MAX_HELP:g}"})
        for command in ("explain", "place", "build", "trade"):
            output = ["--output", f"{command}.onnx" if command == "build" else f"{command}.svg"]
            words = ["design-sensors", command, scene, *(output if command in ("build", "trade") else [])]
            rows.append(row(f"design-sensors {command}", spent(words, folder), bare_s))
    return rows


def spent(words: list[str], folder: Path) -> dict[str, float]:
    """Run a command in a folder; return what it and its children used."""
    begin_s = monotonic()
    program = [str(PROGRAMS / words[0]), *words[1:]]
    with subprocess.Popen(program, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, words
    return {"processor, s": used.ru_utime + used.ru_stime, "s": monotonic() - begin_s, "MB": used.ru_maxrss / 1e3}


def row(name: str, found: dict[str, float], bare_s: float) -> dict[str, object]:
    """Return the row of a command."""
    return {"name": name, "value": found["processor, s"] / bare_s, "unit": "over python -c pass", **found}
