"""One sensor of four dies: every door of both programs says so, says when it is back, and the alerts can hear it."""

from __future__ import annotations

import re
import subprocess
import tomllib
from typing import TYPE_CHECKING, Any

import httpx2
import pytest
import tomli_w
from pymodbus.client import ModbusTcpClient

from beamtouch_models import modelfile
from beamtouch_models.building.daemon_config import daemon_config
from contact_registers import decoded
from example_scenes import SCENES
from forked_line import ForkedLine
from free_ports import free_port
from line import Line, Surface
from modbus_client import modbus_port
from parts import require
from pasted import ROOT
from plain_http import TIMEOUT_S
from service.process.broker import Broker, broker_in
from waiting import wait_until

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

pytestmark = pytest.mark.long

RULES = ROOT / "deploy" / "beamtouch.rules.yml"
RULE_TESTS = ROOT / "tests" / "system" / "beamtouch.rules.test.yml"
DEAD = "s3"


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with broker_in(tmp_path) as started:
        yield started


class Watched:
    """A line with metrics of both programs, registers and a broker."""

    def __init__(self, line: Line, metrics_port: int) -> None:
        self.line = line
        self._daemon = f"http://127.0.0.1:{metrics_port}"
        self._modbus = modbus_port(line)

    def ask(self, path: str) -> httpx2.Response:
        return httpx2.get(self.line.url + path, trust_env=False, timeout=TIMEOUT_S)

    def scrape(self) -> dict[str, str]:
        """Return what Prometheus gets from each program."""
        text = httpx2.get(f"{self._daemon}/metrics", trust_env=False, timeout=TIMEOUT_S).text
        return {"daemon": text, "service": self.ask("/metrics").text}

    def registers(self) -> dict[str, Any]:
        with ModbusTcpClient("127.0.0.1", port=self._modbus) as client:
            return decoded(client.read_input_registers(0, count=42).registers, ["s1", "s2", "s3", "s4"])

    def log(self, level: str) -> list[str]:
        lines = self.line.log("service").splitlines()
        return [line.partition(f" {level} ")[2] for line in lines if level in line and "channel" in line]

    def set_range(self, range_mm: list[float]) -> list[float]:
        """Make the daemon take another range for the sensor that dies; return the one that it had."""
        path = self.line.folder / "daemon.toml"
        config = tomllib.loads(path.read_text())
        channel = config["surfaces"]["bench"]["channels"][2]
        before: list[float] = channel["range_mm"]
        channel["range_mm"] = range_mm
        path.write_text(tomli_w.dumps(config))
        self.line.restart_daemon()
        return before


@pytest.fixture
def watched(tmp_path: Path, bench_model: Path, broker: Broker) -> Iterator[Watched]:
    config, port = tmp_path / "generated.toml", free_port()
    built = daemon_config(modelfile.load(bench_model).metadata).replace("rate_hz = 200", "rate_hz = 50")
    config.write_text(f"{built}\n[metrics]\nport = {port}\n")
    sections = {
        "surfaces": {"bench": {"model": str(bench_model), "stale_ms": 5000, "degraded_after_s": 1}},
        "modbus_server": {"port": 0},
        "mqtt": {"host": "127.0.0.1", "port": broker.port},
    }
    (tmp_path / "rest.toml").write_text("[[step]]\nseconds = 60\n")
    surfaces = [Surface("bench", "modbus-tcp", tmp_path / "rest.toml")]
    with ForkedLine(tmp_path, SCENES / "bench.toml", bench_model, config, surfaces, sections) as line:
        wait_until(lambda: '"clear"' in httpx2.get(f"{line.url}/contact", trust_env=False, timeout=TIMEOUT_S).text)
        yield Watched(line, port)


def test_a_dead_sensor_is_told_at_every_door_and_so_is_its_return(watched: Watched, broker: Broker) -> None:
    status = broker.subscribe("-t", "beamtouch/bench/status")
    ready = {"surface": "bench", "status": "ready", "channels": []}
    wait_until(lambda: status.of("beamtouch/bench/status")[-1:] == [ready])
    assert watched.ask("/health/ready?health=true").status_code == 200
    assert watched.ask("/surfaces/bench").json()["channels_out"] == {}
    assert "degraded" not in watched.registers()["notes"]
    assert watched.log("WARNING") == []

    alive = watched.set_range([19.0, 20.0])
    wait_until(lambda: "degraded" in watched.ask("/contact").text.partition('"notes"')[2])
    contact = watched.ask("/contact").json()
    assert (contact["quality"], contact["degraded_channels"]) == ("degraded", [DEAD])
    block = watched.registers()
    assert "degraded" in block["notes"]
    assert block["degraded_channels"] == [DEAD]
    summary = watched.ask("/surfaces/bench").json()
    assert "degraded" in summary["notes"]
    assert list(summary["channels_out"]) == [DEAD]
    since = summary["channels_out"][DEAD]["since"]
    assert summary["channels_out"][DEAD] == {"quality": "out-of-range", "since": since}
    assert watched.ask("/health/ready").status_code == 200
    refused = watched.ask("/health/ready?health=true")
    assert (refused.status_code, refused.json()["detail"]) == (503, "bench: Sensors of the surface are out")
    assert f"{DEAD} (out-of-range since {since})" in refused.json()["surfaces"]["bench"]["detail"]
    out = {"surface": "bench", "status": "channels-out", "channels": [DEAD]}
    wait_until(lambda: status.of("beamtouch/bench/status")[-1] == out)
    late = broker.subscribe("-t", "beamtouch/bench/status")
    wait_until(lambda: late.of("beamtouch/bench/status") == [out])
    for text in watched.scrape().values():
        assert f'beamtouch_channel_quality{{channel="{DEAD}",quality="out-of-range",surface="bench"}} 1.0' in ordered(
            text
        )
        assert 'beamtouch_channel_quality{channel="s1",quality="good",surface="bench"} 1.0' in ordered(text)
    assert f'beamtouch_channel_out{{channel="{DEAD}",surface="bench"}} 1.0' in watched.scrape()["service"]
    advice = "(over 1 s); check whether the sensor has moved, or something lies on the beam"
    assert watched.log("WARNING") == [f"surface bench: channel {DEAD} has been out of range since {since} {advice}"]

    watched.set_range(alive)
    wait_until(lambda: watched.ask("/health/ready?health=true").status_code == 200)
    wait_until(lambda: status.of("beamtouch/bench/status")[-1] == ready)
    assert "degraded" not in watched.ask("/contact").json()["notes"]
    back = f"surface bench: channel {DEAD} is good again; it had been out since {since}"
    assert [line for line in watched.log("INFO") if DEAD in line] == [back]
    require_metrics_of_alerts(watched)


def ordered(text: str) -> str:
    """Return metrics with their labels in alphabetical order."""
    return re.sub(r"\{(.*?)\}", lambda found: "{" + ",".join(sorted(found[1].split(","))) + "}", text)


def require_metrics_of_alerts(watched: Watched) -> None:
    """Require that every metric that an alert reads is one of these programs."""
    text = "\n".join(watched.scrape().values())
    types = re.findall(r"^# TYPE (beamtouch\w+) ", text, re.MULTILINE)
    read = set(re.findall(r"\bbeamtouch_\w+", RULES.read_text()))
    assert len(read) > 15
    assert read <= set(types)


def test_promtool_takes_the_alerts_and_they_fire_as_stated() -> None:
    promtool = require("promtool", "prometheus")
    for command in (["check", "rules", RULES], ["test", "rules", RULE_TESTS]):
        done = subprocess.run([promtool, *map(str, command)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
