"""The files of `deploy/`: alerts, and the configuration of a service that is one of several."""

import json
import re
import subprocess
import tomllib
from pathlib import Path
from types import NoneType
from typing import get_args

import pytest
import yaml  # type: ignore[import-untyped]  # it comes with mkdocs

from beamtouch_service.config import load_settings
from beamtouch_service.record import EventAnswer
from beamtouch_service.record.forecast import describe_kept_days
from beamtouch_service.record.writing.transactions import Transactions
from beamtouch_service.sections import EventsSection
from service.postgres import PASSWORD, Postgres
from support.running.debian_parts import require

FOLDER = Path(__file__).parents[2] / "deploy"
UNIT = FOLDER / "beamtouch-service@.service"
RULES = FOLDER / "beamtouch.rules.yml"
DOCS = FOLDER.parent / "docs"


def test_the_password_comes_from_a_file_that_a_group_may_read(
    postgres: Postgres, events_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = load_settings(FOLDER / "service.toml", {}).events.url
    assert url is not None
    assert "Environment=PGSERVICEFILE=" in UNIT.read_text()
    # As systemd 254 and later pass a credential.
    file = tmp_path / "pg_service.conf"
    file.write_text(f"[beamtouch]\npassword={PASSWORD}\n")
    file.chmod(0o440)
    monkeypatch.setenv("PGSERVICEFILE", str(file))
    here = url.replace("127.0.0.1/beamtouch", f"127.0.0.1:{postgres.port}/{events_url.rpartition('/')[2]}")
    transactions = Transactions(EventsSection(url=here))
    assert transactions.healths() == {}
    transactions.close()


@pytest.mark.promise(
    "docs/how-to/time-series.md",
    "it names members that an event has",
)
def test_telegraf_reads_members_that_an_event_has() -> None:
    (consumer,) = tomllib.loads((FOLDER / "telegraf.conf").read_text())["inputs"]["mqtt_consumer"]
    (parser,) = consumer["json_v2"]
    paths = [one["path"] for kind in ("tag", "field") for one in parser[kind]]
    members = EventAnswer.model_fields
    assert {*paths, parser["timestamp_path"]} <= set(members)
    optional = {one["path"] for one in parser["field"] if one.get("optional")}
    assert optional == {path for path in paths if NoneType in get_args(members[path].annotation)}


@pytest.mark.promise("docs/how-to/containers.md", "does the same for `docker compose` and `podman-compose`")
@pytest.mark.parametrize("name", ["daemon", "service"])
def test_the_compose_file_starts_what_the_unit_of_podman_starts(name: str) -> None:
    composed = yaml.safe_load((FOLDER / "containers" / "compose.yaml").read_text())["services"][name]
    lines = (FOLDER / "containers" / f"beamtouch-{name}.container").read_text().splitlines()
    unit = [line.partition("=")[::2] for line in lines if "=" in line and not line.startswith("#")]
    stated = dict(unit)
    assert stated["Image"] == composed["image"]
    assert stated["Exec"].split() == composed["command"]
    assert (stated["Network"], stated["ReadOnly"]) == (composed["network_mode"], str(composed["read_only"]).lower())
    assert ([stated["DropCapability"].upper()], composed["security_opt"]) == (
        composed["cap_drop"],
        [f"no-new-privileges:{stated['NoNewPrivileges']}"],
    )
    volumes = [
        value.removeprefix("beamtouch-").replace("/etc/beamtouch:", "./etc:", 1)
        for key, value in unit
        if key == "Volume"
    ]
    assert volumes == composed["volumes"]
    assert stated["Secret"].endswith(f"target={composed['secrets'][0]}")
    check = [*json.loads(stated.get("HealthCmd", "[]"))]
    assert (["CMD", *check] if check else []) == composed.get("healthcheck", {}).get("test", [])
    memory = stated.get("PodmanArgs", "").removeprefix("--memory=") or None
    assert memory == composed.get("mem_limit")


@pytest.mark.promise("docs/how-to/containers.md", "writes units of containers that you describe to it")
@pytest.mark.parametrize("name", ["daemon", "service"])
def test_the_containers_described_for_an_older_podman_are_those_of_the_units(name: str) -> None:
    page = (DOCS / "how-to" / "containers.md").read_text().replace("\\\n", " ")
    (common,) = re.findall(r'^\$ options="(.*)"$', page, re.MULTILINE)
    (described,) = re.findall(rf"^\$ sudo podman create --name beamtouch-{name} (.*)$", page, re.MULTILINE)
    lines = (FOLDER / "containers" / f"beamtouch-{name}.container").read_text().splitlines()
    unit = [line.partition("=")[::2] for line in lines if "=" in line and not line.startswith("#")]
    stated = dict(unit)
    options, image, command = described.replace("$options", common).partition(stated["Image"])
    assert image
    assert command.split() == stated["Exec"].split()
    words = options.split()
    # A flag has no value, and --volume comes twice.
    flags = [word for word in words if word == "--read-only"]
    assert flags == ["--read-only"] * (stated["ReadOnly"] == "true")
    words.remove("--read-only")
    given = sorted(zip(words[::2], words[1::2], strict=True))
    expected = [("--volume", value) for key, value in unit if key == "Volume"]
    expected += [("--network", stated["Network"]), ("--cap-drop", stated["DropCapability"])]
    expected += [("--secret", stated["Secret"])]
    expected += [("--security-opt", "no-new-privileges")] * (stated["NoNewPrivileges"] == "true")
    expected += [("--sdnotify", "container")] * (stated["Notify"] == "true")
    memory = stated.get("PodmanArgs")
    expected += [("--memory", memory.removeprefix("--memory="))] if memory else []
    assert given == sorted(expected)


def test_prometheus_takes_the_configuration_of_the_page_and_asks_often_enough(
    tmp_path: Path,
) -> None:
    (block,) = re.findall(r"^```yaml\n(global:.*?)^```", (DOCS / "reference" / "metrics.md").read_text(), re.M | re.S)
    config = yaml.safe_load(block)
    # Grafana takes rates over a minute at least, as its data source assumes 15 s between two scrapes.
    assert config["global"]["scrape_interval"] == "15s"
    jobs = {one["job_name"] for one in config["scrape_configs"]}
    assert jobs == set(re.findall(r"job=\"([\w-]+)\"", RULES.read_text()))
    (tmp_path / "beamtouch-read-token").write_text("reading-horse-battery-staple")
    (tmp_path / RULES.name).write_text(RULES.read_text())
    (tmp_path / "prometheus.yml").write_text(block.replace("/etc/prometheus", str(tmp_path)))
    promtool = require("promtool", "prometheus")
    command = [promtool, "check", "config", str(tmp_path / "prometheus.yml")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_record_of_several_services_keeps_a_contact_each_2_s_for_its_days() -> None:
    events = load_settings(FOLDER / "service.toml", {}).events
    assert describe_kept_days(events)[0] == {"busy_days": events.keep_days}


@pytest.mark.promise(
    "deploy/README.md",
    "alerts for Prometheus, also for a single service",
)
def test_promtool_takes_the_alerts_and_they_fire_as_stated() -> None:
    promtool = require("promtool", "prometheus")
    for command in (["check", "rules", RULES], ["test", "rules", Path(__file__).with_name("beamtouch.rules.test.yml")]):
        done = subprocess.run([promtool, *map(str, command)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("file", [RULES, *sorted((FOLDER / "grafana").glob("*.json"))], ids=lambda file: file.name)
def test_alerts_and_dashboards_read_only_metrics_that_there_are(file: Path) -> None:
    """The reference comes from the programs; the metrics of MQTT are in its guide."""
    tables = [(DOCS / page).read_text() for page in ("reference/metrics.md", "how-to/mqtt.md")]
    documented = {name for text in tables for name in re.findall(r"^\| `(beamtouch_\w+)` \|", text, re.MULTILINE)}
    read = {name.removesuffix("_bucket") for name in re.findall(r"\bbeamtouch_\w+", file.read_text())}
    assert len(read) > 8
    assert read <= documented
