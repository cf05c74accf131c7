"""A model in stages on a line that runs: `python tests/benchmarks/rollout_line.py`.

Rig, daemon and service as processes with their defaults, and a client that asks for the contact each 20 ms. A damaged,
a worse and a better candidate are staged; the better one is taken, and taken back. Printed is what was said, how long
it took, and what the client saw: states, problems, the largest age, and the positions that each model answered.
"""

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parents[2] / "demo"))

import beamtouch_models
from beamtouch_models import runtime
from line import Line, Surface
from support.running.waiting import wait_until
from support.surfaces.example_scenes import SCENES
from system.test_rollout_line import BENT, REAL, SCRIPT, Controller, Rollout, calibrated, fingerprint

SETTLED_S = 3.0
"""Before the client asks, the contact settles; at the end, the model that was taken back answers for so long."""
PATIENCE_S = 300.0


def seconds_until(condition: Callable[[], bool]) -> float:
    """Wait; return how long that took [s]."""
    begin_s = time.monotonic()
    wait_until(condition, PATIENCE_S)
    return time.monotonic() - begin_s


def wait_for_models(controller: Controller, count: int) -> float:
    """Wait until so many models have answered in turn; return how long that took [s]."""
    return seconds_until(lambda: len(controller.models) >= count)


def stage_all(rollout: Rollout, controller: Controller, worse: bytes, better: bytes) -> None:
    """Take a damaged, a worse and a better candidate through the stages."""
    rollout.stage(better[: len(better) // 2])
    took_s = seconds_until(lambda: "damaged" in str(rollout.candidate["error"]))
    print(f"damaged: named after {took_s:.1f} s; take exits with {rollout.run('take')}")
    for name, content in (("worse", worse), ("better", better)):
        rollout.stage(content)
        begin_s = time.monotonic()
        said = rollout.wait_for_verdict(fingerprint(content))
        print(f"{name}: judged after {time.monotonic() - begin_s:.1f} s: {said['verdict']}")
    for count, word in enumerate(("take", "take-back"), start=2):
        rollout.run(word)
        took_s = wait_for_models(controller, count)
        print(f"{word}: the other model answers after {took_s:.1f} s")
    time.sleep(SETTLED_S)


def show(controller: Controller) -> None:
    """Print what the client saw."""
    answers = controller.answers
    states = Counter(one.get("state") or one.get("type") for one in answers)
    print(f"answers: {dict(states)}; largest age {max(one.get('age_ms', 0.0) for one in answers):.0f} ms")
    for model in dict.fromkeys(one["model"] for one in answers if "model" in one):
        places = [one["position_mm"] for one in answers if one.get("model") == model and one["position_mm"]]
        print(f"{model}: {len(places)} contacts from {min(places):.1f} to {max(places):.1f} mm; the load is at 140 mm")


def main() -> None:
    """Build the models, run the line, print."""
    scene = SCENES / "bench.toml"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        built = beamtouch_models.resolve(beamtouch_models.read_scene(scene)).place(4).build("bench")
        built.save(folder / "bench.onnx")
        (folder / "built.toml").write_text(beamtouch_models.daemon_config(built.metadata))
        (folder / "script.toml").write_text(SCRIPT)
        (folder / "real.toml").write_text(f"gain = {list(REAL.gain)}\n")
        bench = runtime.load(folder / "bench.onnx")
        better, worse = calibrated(bench, REAL), calibrated(bench, BENT)
        options = ("--no-ringing", "--imperfections", str(folder / "real.toml"))
        surface = Surface("bench", "modbus-tcp", folder / "script.toml", options)
        sections = {"surfaces": {"bench": {"model": "bench.onnx"}}}
        with Line(folder, scene, folder / "bench.onnx", folder / "built.toml", [surface], sections) as line:
            rollout, controller = Rollout(line), Controller(line.url)
            wait_until(lambda: rollout.get("/contact").get("state") == "contact", PATIENCE_S)
            time.sleep(SETTLED_S)
            with controller.asking():
                stage_all(rollout, controller, worse, better)
        show(controller)


if __name__ == "__main__":
    main()
