"""From a surface that differs from its scene to a calibrated model: rig and daemon as processes."""

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from beamtouch_models import cli, modelfile
from beamtouch_models.building.daemon_config import daemon_config
from few_draws import short_work
from forked import Forked
from forked_line import MODULES, Rig, rig
from quick_model import SCENE, write_quick_model
from toolchain import made_once

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]

POSITIONS = np.linspace(20, 380, 10)
FORCE_N = 12.0
RECORDED_S, RATE_HZ = 0.5, 100.0
IMPERFECT = """
position_offset_mm = [1.0, -1.0, 1.0]
gain = [1.03, 0.97, 1.03]
offset_mm = [0.02, -0.01, 0.03]
curve_per_mm = 0.007
fixity = [0.05, 0.0]
"""


def record(config: Path, path: Path, beam: Rig) -> None:
    """Play the person: put each load on, press Enter, and leave it on until it is recorded."""
    given = [option for position in POSITIONS for option in ("--at", str(position), str(FORCE_N))]
    words = ("record", str(config), "-o", str(path), "--seconds", str(RECORDED_S), *given)
    process = Forked(MODULES["beamtouch-daemon"], words, Path.cwd())
    try:
        for number, position in enumerate(POSITIONS, start=1):
            beam.put(f"{position} {FORCE_N}")
            process.stdin.write("\n")
            process.stdin.flush()
            # Half a second is 50 samples, of which a busy machine may miss some.
            recorded = re.compile(rf"load {number}: {FORCE_N:g} N at {position:g} mm, (\d+) samples")
            while (found := recorded.fullmatch(said := process.stderr.readline().strip())) is None:
                assert said.startswith(f"load {number}: put "), said
            assert 10 <= int(found[1]) <= 50
        out, _ = process.communicate(timeout=60)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 0
    assert out.startswith("10 loads in ")


def test_ten_recorded_loads_make_a_model_of_the_real_surface(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = made_once(tmp_path_factory, "quick-model", write_quick_model) / "quick.onnx"
    scene = tmp_path / "quick.toml"
    scene.write_text(SCENE)
    token = tmp_path / "beamtouch.token"
    token.write_text("a-token-that-nobody-asks-for")
    (tmp_path / "off.toml").write_text(IMPERFECT)
    at = ("--modbus-tcp", "127.0.0.1:0", "--by-hand", "--no-ringing")
    with rig(scene, model, *at, "--imperfections", tmp_path / "off.toml") as beam:
        config = tomllib.loads(daemon_config(modelfile.load(model).metadata))
        (surface,) = config["surfaces"].values()
        surface["source"] |= {"port": int(beam.place), "timeout_ms": 5000.0}
        surface["rate_hz"] = RATE_HZ
        path = tmp_path / "daemon.toml"
        path.write_text(tomli_w.dumps(config))
        tare = Forked(MODULES["beamtouch-daemon"], ("tare", str(path), "--accept-change"), Path.cwd())
        tare.communicate(timeout=60)
        assert tare.wait() == 0
        record(path, tmp_path / "loads.csv", beam)
    # Its thresholds and its accuracy are not asked for.
    words = ("calibrate", str(model), str(tmp_path / "loads.csv"), "-o", str(tmp_path / "real.onnx"), "--json")
    with short_work():
        assert cli.main(list(words)) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["calibration"]["loads"] == 10
    # The tare has taken the offsets away.
    assert found["error_after_mm"]["mean"] < 0.4 * found["error_before_mm"]["mean"]
    first, second, third = found["calibration"]["departures"]["gain"]
    assert (second / first, third / first) == pytest.approx((0.97 / 1.03, 1.0), abs=0.03)
    assert modelfile.load(tmp_path / "real.onnx").metadata.calibration is not None
