"""From a surface that differs from its scene to a calibrated model: rig, daemon, design-sensors as processes."""

import json
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from beamtouch_models import modelfile
from beamtouch_models.daemon_config import daemon_config
from example_scenes import SCENES
from line import Truth

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]

PROGRAMS = Path(sys.executable).parent
SCENE = SCENES / "bench.toml"
POSITIONS = np.linspace(20, 380, 10)
FORCE_N = 12.0
AT_REST_S, ON_S, OFF_S, RECORDED_S, RATE_HZ = 12.0, 7.0, 0.2, 2.0, 50.0
"""Long enough for a machine with much else to do."""
IMPERFECT = """
position_offset_mm = [1.0, -1.0, 1.0, -1.0]
gain = [1.03, 0.97, 0.97, 1.03]
offset_mm = [0.02, -0.01, 0.0, 0.03]
curve_per_mm = 0.007
fixity = [0.05, 0.0]
"""


def script() -> str:
    """Nothing for a while, to tare; then one load after the other."""
    steps = "".join(
        f"[[step]]\nseconds = {ON_S}\nposition_mm = {position}\nforce_n = {FORCE_N}\n[[step]]\nseconds = {OFF_S}\n"
        for position in POSITIONS
    )
    return f"repeat = false\n[[step]]\nseconds = {AT_REST_S}\n{steps}"


@contextmanager
def rig(folder: Path, model: Path) -> Iterator[tuple[dict[str, object], Path]]:
    """An imperfect surface on Modbus TCP; yields the daemon's source table and the file of what touches."""
    (folder / "script.toml").write_text(script())
    (folder / "imperfections.toml").write_text(IMPERFECT)
    truth = folder / "truth.csv"
    command: list[str | Path] = [
        PROGRAMS / "beamtouch-rig",
        SCENE,
        "--model",
        model,
        "--modbus-tcp",
        "127.0.0.1:0",
        "--truth",
        truth,
    ]
    files: list[str | Path] = ["--script", folder / "script.toml", "--imperfections", folder / "imperfections.toml"]
    process = subprocess.Popen([*command, *files], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        port = int(process.stdout.readline().rpartition(":")[2])
        yield {"kind": "modbus-tcp", "host": "127.0.0.1", "port": port, "timeout_ms": 5000.0}, truth
    finally:
        process.terminate()
        process.communicate(timeout=10)


def record(config: Path, path: Path, truth: Truth) -> None:
    """Play the person: press Enter once each load is on."""
    given = [option for position in POSITIONS for option in ("--at", str(position), str(FORCE_N))]
    command: list[str | Path] = [
        PROGRAMS / "beamtouch-daemon",
        "record",
        config,
        "-o",
        path,
        "--seconds",
        str(RECORDED_S),
        *given,
    ]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None
    deadline = time.monotonic() + 200
    for position in POSITIONS:
        while True:
            assert time.monotonic() < deadline
            time.sleep(0.02)
            truth.read()
            load = truth.at(time.time() - 0.02)
            if load is not None and load[0] is not None and abs(load[0] - position) < 1e-3:
                break
        process.stdin.write("\n")
        process.stdin.flush()
    out, _ = process.communicate(timeout=30)
    assert process.returncode == 0
    assert out.startswith("10 loads in ")


def test_ten_recorded_loads_make_a_model_of_the_real_surface(bench_model: Path, tmp_path: Path) -> None:
    token = tmp_path / "beamtouch.token"
    token.write_text("a-token-that-nobody-asks-for")
    with rig(tmp_path, bench_model) as (source, truth_path):
        config = tomllib.loads(daemon_config(modelfile.load(bench_model).metadata))
        (surface,) = config["surfaces"].values()
        surface["source"], surface["rate_hz"] = source, RATE_HZ
        path = tmp_path / "daemon.toml"
        path.write_text(tomli_w.dumps(config))
        tare: list[str | Path] = [PROGRAMS / "beamtouch-daemon", "tare", path]
        subprocess.run(tare, check=True, capture_output=True, timeout=30)
        truth = Truth(truth_path)
        record(path, tmp_path / "loads.csv", truth)
        truth.close()
    calibrate: list[str | Path] = [PROGRAMS / "design-sensors", "calibrate", bench_model, tmp_path / "loads.csv"]
    done = subprocess.run(
        [*calibrate, "-o", tmp_path / "real.onnx", "--json"], check=True, capture_output=True, text=True, timeout=120
    )
    found = json.loads(done.stdout)
    assert found["calibration"]["loads"] == 10
    # Two seconds each are 100 samples; the tare has taken the offsets away.
    assert found["error_after_mm"]["mean"] < 0.4 * found["error_before_mm"]["mean"]
    assert 0.02 < found["calibration"]["departures"]["fixity"][0] < 0.08
    assert modelfile.load(tmp_path / "real.onnx").metadata.calibration is not None
