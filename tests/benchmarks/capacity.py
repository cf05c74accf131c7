"""Processor time and memory of a service per surface: `python tests/benchmarks/capacity.py [--seconds 10]`.

Processor time does not count the time in which other programs have the core, so it can be measured on a busy machine.
There the senders fall behind, but send batches of the size that they would have on a quiet one.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from bench_service import TOKEN, server
from sample_load import EVERY_S

from beamtouch_models import modelfile
from beamtouch_models.building.build import build
from beamtouch_models.scene import load_scene
from example_scenes import SCENES
from processes import processor_s, resident_mb

LOAD = Path(__file__).parent / "sample_load.py"
SURFACES = {1000: 2, 200: 6, 50: 24}
"""Rate in Hz -> surfaces that are fed at once: a part of what a core carries."""
MEMORIES = (1, 100, 500)
USED = 0.6
"""Share of a core that is planned for: the rest is for questions, and for the surfaces of a service that died."""


def measure(folder: Path, surfaces: int, rates: dict[int, int], seconds: float) -> float:
    """Print the processor time per surface at these rates; returns the resident memory in MB."""
    text = "".join(f'[surfaces.s{number}]\nmodel = "bench.onnx"\n' for number in range(surfaces))
    (folder / "service.toml").write_text(f'[server]\nport = 0\nwrite_token_file = "token"\n{text}')
    model = modelfile.load(folder / "bench.onnx")
    channels = json.dumps(dict(zip(model.channels, model.metadata.golden.deflection_mm[0], strict=True)))
    arguments = ("-m", "beamtouch_service.cli", "run", "--config", folder / "service.toml")
    with server(*arguments) as (service, port):
        for rate_hz, count in rates.items():
            begin_s = processor_s(service.pid)
            in_batch = max(1, round(rate_hz * EVERY_S))
            load = [sys.executable, LOAD, port, channels, count, seconds, TOKEN, rate_hz, in_batch]
            found = json.loads(subprocess.check_output([str(one) for one in load], text=True))
            batch_s = (processor_s(service.pid) - begin_s) / found["batches"]
            carried = USED / (batch_s * rate_hz / in_batch)
            sent = f"{found['batches'] / seconds / count:.0f} batches/s of each surface were sent"
            words = f"{rate_hz} Hz: {batch_s * 1e6:.0f} us per batch of {in_batch} samples ({sent})"
            print(f"{words}; a core at {USED:.0%} carries {carried:.0f} surfaces", flush=True)
        return resident_mb(service.pid)


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene, text = load_scene(SCENES / "bench.toml")
        built = build(scene, text, "bench", count=None, seed=0, progress=lambda _doing, _done: None)
        (folder / "bench.onnx").write_bytes(built.content)
        (folder / "token").write_text(TOKEN)
        measure(folder, max(SURFACES.values()), SURFACES, options.seconds)
        for surfaces in MEMORIES:
            print(f"{surfaces} surfaces: {measure(folder, surfaces, {}, 0.0):.0f} MB", flush=True)


if __name__ == "__main__":
    main()
