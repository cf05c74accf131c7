"""How many surfaces of 1 kHz one core carries, and what many at rest take: the service on a core, senders on others."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from bench_service import TOKEN, server
from shipped import build

from processes import processor_s, resident_mb

MOST, SECONDS = 48, 3.0
RESTING = 200
PROMPT_MS = 20.0
"""A core carries the samples if from the taking of one to its receipt it takes no longer, but for 1 in 100."""
LOAD = Path(__file__).parent / "sample_load.py"


def run() -> list[dict[str, object]]:
    """Look for the number, by doubling and then by halves."""
    with tempfile.TemporaryDirectory() as folder:
        model = build(Path(folder))
        (Path(folder) / "token").write_text(TOKEN)
        surfaces = "".join(f'[surfaces.s{number}]\nmodel = "bench.onnx"\n' for number in range(RESTING))
        (Path(folder) / "service.toml").write_text(f'[server]\nport = 0\nwrite_token_file = "token"\n{surfaces}')
        deflections_mm = model.metadata.golden.deflection_mm[0]
        channels = json.dumps(dict(zip(model.channels, deflections_mm, strict=True)))
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, cores[-1:])  # inherited by the service
        try:
            started = server("-m", "beamtouch_service.cli", "run", "--config", Path(folder) / "service.toml")
            with started as (service, port):
                os.sched_setaffinity(0, cores[:-1] or cores)
                carried, found, core = search(service.pid, port, channels)
                calm = json.dumps(dict.fromkeys(model.channels, 0.0))
                rests = {count: loaded(service.pid, port, calm, count, "--at-rest") for count in (MOST, RESTING)}
                memory_mb = resident_mb(service.pid)
        finally:
            os.sched_setaffinity(0, cores)
    return [
        {
            "name": "surfaces of 1 kHz that one core carries",
            "value": carried,
            "unit": "surfaces",
            "samples/s": found["samples"] / SECONDS,
            "samples in a batch": found["samples"] / found["batches"],
            "p50 to the receipt, ms": found["p50_ms"],
            "p99 to the receipt, ms": found["p99_ms"],
            "processor, %": core * 100,
        },
        *(
            {
                "name": f"{count} surfaces at rest, 10 samples per second each",
                "value": share * 100,
                "unit": "% of a core",
                "samples/s of each": rest["samples"] / SECONDS / count,
                "p50 to the receipt, ms": rest["p50_ms"],
                "p99 to the receipt, ms": rest["p99_ms"],
            }
            for count, (rest, share) in rests.items()
        ),
        {"name": f"resident memory with {RESTING} surfaces", "value": memory_mb, "unit": "MB"},
    ]


def search(pid: int, port: int, channels: str) -> tuple[int, dict[str, float], float]:
    """Return the number, what was found with it, and the share of the core that it took."""
    kept: tuple[int, dict[str, float], float] = 0, {"samples": 0, "batches": 1, "p50_ms": 0.0, "p99_ms": 0.0}, 0.0
    low, high = 0, MOST + 1
    count = 1
    while high - low > 1:
        found, core = loaded(pid, port, channels, count)
        if found["p99_ms"] <= PROMPT_MS:
            low, kept = count, (count, found, core)
        else:
            high = count
        count = min(2 * low, MOST) if high > MOST else (low + high) // 2
    return kept


def loaded(pid: int, port: int, channels: str, count: int, *options: str) -> tuple[dict[str, float], float]:
    """Send to so many surfaces for a turn; returns what the senders found, and the share of the core it took."""
    begin_s = processor_s(pid)
    arguments = [sys.executable, str(LOAD), str(port), channels, str(count), str(SECONDS), TOKEN, *options]
    found: dict[str, float] = json.loads(subprocess.check_output(arguments, text=True))
    return found, (processor_s(pid) - begin_s) / SECONDS


if __name__ == "__main__":
    for row in run():
        print(row)
