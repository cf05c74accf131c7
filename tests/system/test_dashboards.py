"""The dashboards of `deploy/grafana`: each query is answered by a Prometheus that watches a line with faults."""

import json
import subprocess
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx2
import pytest
import tomli_w

from line import Surface
from support.network.free_ports import free_port
from support.network.plain_http import NO_TLS, TIMEOUT_S
from support.programs.forked_line import ForkedLine
from support.running.debian_parts import require
from support.running.waiting import wait_until
from support.surfaces.example_scenes import SCENES

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]

DEPLOY = Path(__file__).parents[2] / "deploy"
DASHBOARDS = sorted((DEPLOY / "grafana").glob("*.json"))
SCRIPT = """
[[step]]
seconds = 1
[[step]]
seconds = 2
position_mm = 150
force_n = 10
"""
ZONES = {"left": {"from_mm": 0.0, "to_mm": 200.0}}
VARIABLES = {"$surface": "bench", "$__rate_interval": "5s"}
ONLY_UNDER_OTHER_FAULTS = {
    ("plant", "beamtouch_part_failing == 1"),
    ("plant", "beamtouch_source_missing == 1"),
    ("plant", "beamtouch_model_refused == 1"),
    ("sensors", 'max by (channel, bound, unit) (beamtouch_zero_change{surface=~"$surface"})'),
    ("sensors", 'beamtouch_source_missing{surface=~"$surface"} == 1'),
    ("sensors", 'beamtouch_rate_wrong{surface=~"$surface"} == 1'),
    ("sensors", 'beamtouch_line_thin{surface=~"$surface"} == 1'),
    ("sensors", 'beamtouch_boots_refused{surface=~"$surface"} > 0'),
}
"""What the faults of this line may leave empty. That these metrics exist is checked with those of the alerts."""


@dataclass
class Watched:
    """What Prometheus has seen of a line."""

    url: str
    begin: float

    def is_ready(self) -> bool:
        """Return whether Prometheus answers queries."""
        try:
            return httpx2.get(f"{self.url}/-/ready", verify=NO_TLS, timeout=TIMEOUT_S).status_code == 200
        except httpx2.HTTPError:
            return False

    def series(self, expression: str) -> dict[tuple[str, ...], list[float]]:
        """Return the values since the beginning by the values of the labels."""
        for name, value in VARIABLES.items():
            expression = expression.replace(name, value)
        asked: dict[str, str | float] = {"query": expression, "start": self.begin, "end": time.time(), "step": 1}
        answer = httpx2.get(f"{self.url}/api/v1/query_range", params=asked, verify=NO_TLS, timeout=TIMEOUT_S).json()
        assert answer["status"] == "success", answer
        return {
            tuple(value for name, value in sorted(one["metric"].items()) if name != "__name__"): [
                float(value) for _, value in one["values"]
            ]
            for one in answer["data"]["result"]
        }


def panels(dashboard: str) -> dict[str, list[str]]:
    """Return the expressions of each panel by its title."""
    board = json.loads((DEPLOY / "grafana" / f"{dashboard}.json").read_text())
    return {panel["title"]: [target["expr"] for target in panel["targets"]] for panel in board["panels"]}


def prometheus_of(folder: Path, service: str, daemon_port: int) -> tuple[subprocess.Popen[bytes], str]:
    """Start a Prometheus that asks both programs each second, with the alerts; returns it with its address."""
    port = free_port()
    config = {
        "global": {"scrape_interval": "1s", "evaluation_interval": "1s"},
        "rule_files": [str(DEPLOY / "beamtouch.rules.yml")],
        "scrape_configs": [
            {"job_name": "beamtouch-service", "static_configs": [{"targets": [service.removeprefix("http://")]}]},
            {"job_name": "beamtouch-daemon", "static_configs": [{"targets": [f"127.0.0.1:{daemon_port}"]}]},
        ],
    }
    (folder / "prometheus.yml").write_text(json.dumps(config))
    program = require("prometheus", "prometheus")
    words = (f"--config.file={folder / 'prometheus.yml'}", f"--storage.tsdb.path={folder / 'series'}")
    with (folder / "prometheus.log").open("w") as log:
        process = subprocess.Popen([program, *words, f"--web.listen-address=127.0.0.1:{port}"], stderr=log)
    return process, f"http://127.0.0.1:{port}"


@contextmanager
def watched(folder: Path, bench_model: Path) -> Iterator[Watched]:
    """Give a line whose broker is not there, whose second sensor loses its cable, and whose daemon then ends."""
    require("prometheus", "prometheus")
    begin, daemon_port = time.time(), free_port()
    (folder / "script.toml").write_text(SCRIPT)
    config = tomllib.loads(bench_model.with_suffix(".toml").read_text())
    (folder / "built.toml").write_text(tomli_w.dumps({**config, "metrics": {"port": daemon_port}}))
    surface = {"model": str(bench_model), "degraded_after_s": 1.0, "unexplained_after_s": 0.5, "zones": ZONES}
    sections = {"surfaces": {"bench": surface}, "mqtt": {"host": "127.0.0.1", "port": free_port()}}
    options = ("--no-ringing", "--fault", "lost:20@8..12", "--fault", "unplugged:s2@15..")
    rig = Surface("bench", "modbus-tcp", folder / "script.toml", options)
    with ForkedLine(folder, SCENES / "bench.toml", bench_model, folder / "built.toml", [rig], sections) as line:
        process, url = prometheus_of(folder, line.url, daemon_port)
        seen = Watched(url, begin)
        try:

            def is_shown(dashboard: str, title: str, wanted: float) -> bool:
                httpx2.get(f"{line.url}/contact", verify=NO_TLS, timeout=TIMEOUT_S)
                return any(wanted in values for values in seen.series(panels(dashboard)[title][0]).values())

            wait_until(seen.is_ready)
            wait_until(lambda: is_shown("sensors", "Out", 1.0), 90)
            line.end("daemon")
            wait_until(lambda: is_shown("plant", "Without an answer", 1.0), 60)
            wait_until(lambda: is_shown("plant", "Programs", 0.0), 60)
            yield seen
        finally:
            process.terminate()
            process.wait(30)


SHOWN = [
    ("sensors", "Out", "s2", 1.0),
    ("sensors", "Quality", "saturated", 1.0),
    ("plant", "Sensors out", None, 1.0),
    ("surface", "Notes", "degraded", 1.0),
    ("plant", "Parts that are missing", "mqtt", 1.0),
    ("plant", "Programs", "beamtouch-daemon", 0.0),
    ("plant", "Problems", "stale", 1.0),
    ("surface", "Problem", "stale", 1.0),
    ("plant", "Without an answer", None, 1.0),
    ("plant", "With a contact", None, 1.0),
    ("surface", "Zones", "inside", 1.0),
]
"""Dashboard, panel, a label and its value at some time."""


@pytest.mark.soak
def test_each_query_has_an_answer_and_each_fault_is_shown(tmp_path: Path, bench_model: Path) -> None:
    with watched(tmp_path, bench_model) as seen:
        empty = {
            (path.stem, expression)
            for path in DASHBOARDS
            for expressions in panels(path.stem).values()
            for expression in expressions
            if not seen.series(expression)
        }
        assert empty <= ONLY_UNDER_OTHER_FAULTS
        for dashboard, title, label, value in SHOWN:
            found = seen.series(panels(dashboard)[title][0])
            assert [labels for labels, values in found.items() if label in (None, *labels) and value in values], title
        (expression,) = panels("sensors")["Requests without an answer"]
        (rates,) = seen.series(expression).values()
        assert max(rates) > 0


@pytest.mark.parametrize("dashboard", [path.stem for path in DASHBOARDS])
def test_a_dashboard_has_what_grafana_needs(dashboard: str) -> None:
    board = json.loads((DEPLOY / "grafana" / f"{dashboard}.json").read_text())
    assert (board["uid"], board["title"]) == (f"beamtouch-{dashboard}", f"Beamtouch: {dashboard}")
    assert len({panel["id"] for panel in board["panels"]}) == len(board["panels"])
    taken = set[tuple[int, int]]()
    for panel in board["panels"]:
        place = panel["gridPos"]
        cells = {(place["x"] + x, place["y"] + y) for x in range(place["w"]) for y in range(place["h"])}
        assert not taken & cells
        assert max(x for x, _ in cells) < 24
        taken |= cells
        assert panel["description"]
