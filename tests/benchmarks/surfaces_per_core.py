"""Surfaces that a core carries: `python tests/benchmarks/surfaces_per_core.py [--surfaces 2] [--seconds 20]`.

Rigs, one daemon and one service as processes: beams at rest, touched for a tenth of the time, and under a load that
always moves, at 1 kHz over serial and at 200 Hz over Modbus TCP. The processor time of daemon and service does not
count the time in which other programs have the core, so a busy machine can measure it too, as long as it does not lose
readings: the readings per second of a surface are stated.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import httpx2

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent))
sys.path.append(str(Path(__file__).parent.parent.parent / "demo"))

from shipped import build

from line import Kind, Line, Surface
from support.programs.processes import processor_s

LINES: dict[int, Kind] = {1000: "serial", 200: "modbus-tcp"}
WARM_S = 5.0
"""The time in which a mean comes to rest, and the first answers are past."""
TOUCH = "[[step]]\nseconds = 0.2\nposition_mm = 150\nforce_n = 10\n"
COURSES = {
    "at rest": "[[step]]\nseconds = 60\n",
    "touched for a tenth": f"[[step]]\nseconds = 1.8\n{TOUCH}" * 30,
    "moving": "".join(
        f"[[step]]\nseconds = 0.02\nposition_mm = {100 + 2 * (step if step < 100 else 200 - step)}\nforce_n = 10\n"
        for step in range(200)
    )
    * 15,
}


def measured(line: Line, names: list[str], seconds: float) -> dict[str, float]:
    """Return the share of a core that a surface takes of the daemon and of the service, and samples per second."""
    with httpx2.Client(base_url=line.url, trust_env=False, timeout=30) as http:
        samples = [newest(http, names)]
        begin_s, used = monotonic(), [{name: processor_s(pid) for name, pid in line.pids().items()}]
        sleep(seconds)
        used.append({name: processor_s(pid) for name, pid in line.pids().items()})
        passed_s = monotonic() - begin_s
        samples.append(newest(http, names))
    share = {name: (used[1][name] - used[0][name]) / passed_s / len(names) for name in ("daemon", "service")}
    return {**share, "samples": (samples[1] - samples[0]) / passed_s / len(names)}


def newest(http: httpx2.Client, names: list[str]) -> int:
    """Return the sum of the numbers of the newest samples of all surfaces."""
    found: list[dict[str, Any]] = [http.get(f"/surfaces/{name}/contact").raise_for_status().json() for name in names]
    return sum(one["sequence"] for one in found)


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--surfaces", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=20.0)
    given = parser.parse_args()
    names = [f"s{number}" for number in range(given.surfaces)]
    for rate_hz, kind in LINES.items():
        for course, script in COURSES.items():
            with tempfile.TemporaryDirectory() as name:
                folder = Path(name)
                build(folder, rate_hz=rate_hz)
                scene, model, config = (folder / one for one in ("bench.toml", "bench.onnx", "generated.toml"))
                (folder / "script.toml").write_text(script)
                surfaces = [Surface(one, kind, folder / "script.toml") for one in names]
                with Line(folder, scene, model, config, surfaces) as line:
                    sleep(WARM_S)
                    found = measured(line, names, given.seconds)
                counts = json.loads(line.summary.read_text())["surfaces"]
            lost = sum(counts[one]["readings_lost"] for one in names) / sum(counts[one]["readings"] for one in names)
            print(
                f"{rate_hz} Hz, {course}: {found['samples']:.0f} samples per s; "
                + "; ".join(
                    f"{program} {found[program]:.1%} of a core, {1 / max(found[program], 1e-9):.0f} surfaces on one"
                    for program in ("service", "daemon")
                )
                + f"; {lost:.1%} of the readings lost",
                flush=True,
            )


if __name__ == "__main__":
    main()
