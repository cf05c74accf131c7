"""What the service is told by its configuration and its options."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from pydantic import ValidationError

from beamtouch_service.config import ConfigFile, Settings, load_settings, read_access
from beamtouch_service.outputs.modbus.section import ModbusServerSection
from beamtouch_service.outputs.mqtt.section import MqttSection
from beamtouch_service.outputs.opcua.section import OpcUaSection
from beamtouch_service.sections import EventsSection, ServerSection, SurfaceSection
from support.surfaces.wrong_numbers import with_wrong_numbers

EXAMPLE = Path(__file__).parents[2] / "service" / "service.example.toml"


def load(folder: Path, text: str, **options: object) -> Settings:
    path = folder / "service.toml"
    path.write_text(text)
    return load_settings(path, options)


def test_with_nothing_it_listens_on_loopback_and_has_no_surface() -> None:
    settings = load_settings(None, {})
    assert (settings.server.host, settings.server.port, settings.surfaces) == ("127.0.0.1", 8420, {})
    assert (settings.server.max_streams, settings.events, settings.outputs) == (32, EventsSection(), ())
    assert (settings.events.file, settings.events.keep_days, settings.events.largest_mb) == (None, 30, 100)
    assert read_access(settings.server).write == {}


def test_paths_in_a_config_are_relative_to_it(tmp_path: Path) -> None:
    (tmp_path / "token").write_text("correct-horse-battery\n")
    (tmp_path / "read-token").write_text("another-horse-battery\n")
    settings = load(
        tmp_path,
        '[server]\nport = 9000\nmax_streams = 3\nwrite_token_file = "token"\nread_token_file = "read-token"\n'
        "[events]\nfile = 'events.db'\nkeep_days = 1.5\nmax_mb = 2\n"
        '[surfaces.a]\nmodel = "a.onnx"\nstale_ms = 250\n[surfaces.b]\nmodel = "/elsewhere/b.onnx"\n'
        "[surfaces.c]\nunexplained_after_s = 2.5\n",
    )
    assert (settings.server.port, settings.server.max_streams) == (9000, 3)
    events = settings.events
    assert (events.file, events.keep_days, events.largest_mb) == (tmp_path / "events.db", 1.5, 2)
    surfaces = settings.surfaces.items()
    assert [(name, entry.model, entry.stale_ms, entry.unexplained_after_s) for name, entry in surfaces] == [
        ("a", tmp_path / "a.onnx", 250, 10),
        ("b", Path("/elsewhere/b.onnx"), 500, 10),
        ("c", None, 500, 2.5),
    ]
    access = read_access(settings.server)
    assert access.write == {"write": "correct-horse-battery"}
    assert (access.read, access.admin) == ({"read": "another-horse-battery"}, {})
    assert "horse" not in repr(settings) + repr(access)


def test_the_command_line_wins(tmp_path: Path) -> None:
    text = '[server]\nhost = "::1"\nport = 9000\n[surfaces.a]\nmodel = "a.onnx"\nstale_ms = 250\n'
    settings = load(tmp_path, text, host="localhost", port=0, model="other.onnx", stale_ms=100.0)
    assert (settings.server.host, settings.server.port) == ("localhost", 0)
    ((name, entry),) = settings.surfaces.items()
    assert (name, entry.model, entry.stale_ms) == ("a", Path("other.onnx"), 100)
    # Without a config, the model names its surface itself.
    ((name, entry),) = load_settings(None, {"model": "m.onnx"}).surfaces.items()
    assert (name, entry.model, entry.stale_ms) == ("", Path("m.onnx"), 500)


NUMBERS = """
[server]
port = 8420
max_streams = 10
[events]
keep_days = 30
max_mb = 100
[surfaces.bench]
stale_ms = 500
unexplained_after_s = 60
"""


def test_only_a_number_is_a_number() -> None:
    content = tomllib.loads(NUMBERS)
    ConfigFile.model_validate(content)
    for _, wrong in with_wrong_numbers(content):
        with pytest.raises(ValidationError):
            ConfigFile.model_validate(wrong)


def test_the_example_is_a_config_and_shows_the_modbus_server_as_it_is_by_default(tmp_path: Path) -> None:
    (tmp_path / "token").write_text("correct-horse-battery\n")
    settings = load(tmp_path, EXAMPLE.read_text())
    assert list(settings.surfaces) == ["press-7"]
    assert read_access(settings.server).write == {"write": "correct-horse-battery"}
    _, _, section = EXAMPLE.read_text().partition("# [modbus_server]")
    shown = section.partition("\n\n")[0].replace("\n# ", "\n")
    (by_default,) = load(tmp_path, f"[modbus_server] # {shown}\n").outputs
    assert by_default == ModbusServerSection()
    assert tuple(by_default.model_dump().values()) == ("127.0.0.1", 502, "big", 32, 60)


KEYS = {
    "server.port": (0, 65535),
    "server.max_streams": (0, 1000),
    "events.keep_days": (0.001, 36_500.0),
    "events.max_mb": (1, 1e6),
    "surfaces.a.stale_ms": (0.001, 60_000.0),
    "surfaces.a.unexplained_after_s": (0.001, 86_400.0),
    "surfaces.a.degraded_after_s": (0.001, 86_400.0),
    "modbus_server.port": (0, 65535),
    "modbus_server.max_clients": (1, 4096),
    "modbus_server.idle_s": (0.1, 86_400.0),
    "mqtt.port": (1, 65535),
    "mqtt.max_rate_hz": (1.0, 200.0),
    "opcua.port": (1, 65535),
    "opcua.interval_ms": (10.0, 10_000.0),
}
"""Key -> the least and the largest value; what must be positive may be as small as one likes."""


def with_key(key: str, value: float) -> ConfigFile:
    *tables, name = key.split(".")
    content: dict[str, object] = {name: value}
    for table in reversed(tables):
        content = {table: content | ({"host": "broker"} if table == "mqtt" else {})}
    return ConfigFile.model_validate(content)


@pytest.mark.parametrize("key", KEYS)
def test_a_number_of_the_configuration_has_bounds(key: str) -> None:
    least, largest = KEYS[key]
    for value in (least, largest):
        with_key(key, value)
    below, above = (0.0, largest * 1.0001) if least == 0.001 else (least - 1, largest + 1)
    for value in (below, above):
        with pytest.raises(ValidationError, match=r"(greater|less) than"):
            with_key(key, value)


def test_a_surface_has_defaults() -> None:
    section = SurfaceSection()
    assert (section.stale_ms, section.unexplained_after_s, section.degraded_after_s) == (500.0, 10.0, 10.0)
    assert (section.model, section.zones) == (None, {})


@pytest.mark.parametrize(
    ("key", "taken", "refused"),
    [
        ("prefix", "a" * 200, "a" * 201),
        ("prefix", "Hall_1/line-2.b", "hall/"),
        ("client_id", "x" * 200, "x" * 201),
        ("client_id", " one ~", "\u00e9"),
        ("host", "broker-2", ""),
    ],
)
def test_a_name_at_a_broker_has_bounds(key: str, taken: str, refused: str) -> None:
    assert getattr(MqttSection.model_validate({"host": "broker", key: taken}), key) == taken
    with pytest.raises(ValidationError):
        MqttSection.model_validate({"host": "broker", key: refused})


def test_outputs_have_defaults() -> None:
    mqtt, opcua = MqttSection(host="broker"), OpcUaSection()
    assert (mqtt.prefix, mqtt.client_id, mqtt.max_rate_hz, mqtt.tls) == ("beamtouch", None, 20.0, False)
    assert (mqtt.send_recorded_events, mqtt.home_assistant_discovery) == (False, False)
    assert (opcua.host, opcua.port, opcua.interval_ms) == ("127.0.0.1", 4840, 100.0)


def test_a_service_has_at_most_32_names_and_trusted_proxies() -> None:
    assert len(ServerSection(trusted_proxies=["10.0.0.5"] * 32).trusted_proxies) == 32
    with pytest.raises(ValidationError):
        ServerSection(trusted_proxies=["10.0.0.5"] * 33)
    assert len(ServerSection(names=["a"] * 32).names) == 32
    with pytest.raises(ValidationError):
        ServerSection(names=["a"] * 33)
