"""What the service is told, and how it says that it was told nonsense."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from pydantic import ValidationError

from beamtouch_common.errors import InputError
from beamtouch_service.config import ConfigFile, Settings, load_settings, read_access
from beamtouch_service.outputs.modbus.section import ModbusServerSection
from beamtouch_service.sections import EventsSection
from wrong_numbers import with_wrong_numbers

EXAMPLE = Path(__file__).parents[2] / "service" / "service.example.toml"


def load(folder: Path, text: str, **options: object) -> Settings:
    path = folder / "service.toml"
    path.write_text(text)
    return load_settings(path, options)


def test_with_nothing_it_listens_on_loopback_and_has_no_surface() -> None:
    settings = load_settings(None, {})

    assert (settings.server.host, settings.server.port, settings.surfaces) == ("127.0.0.1", 8420, {})
    assert read_access(settings.server).write is None


def test_paths_in_a_config_are_relative_to_it(tmp_path: Path) -> None:
    (tmp_path / "token").write_text("correct-horse-battery\n")
    settings = load(
        tmp_path,
        '[server]\nport = 9000\nwrite_token_file = "token"\n'
        '[surfaces.a]\nmodel = "a.onnx"\nstale_ms = 250\n[surfaces.b]\nmodel = "/elsewhere/b.onnx"\n'
        "[surfaces.c]\nunexplained_after_s = 2.5\n",
    )

    assert (settings.server.port, read_access(settings.server).write) == (9000, "correct-horse-battery")
    assert [(name, entry.model, entry.stale_ms) for name, entry in settings.surfaces.items()] == [
        ("a", tmp_path / "a.onnx", 250),
        ("b", Path("/elsewhere/b.onnx"), 500),
        ("c", None, 500),
    ]
    assert [entry.unexplained_after_s for entry in settings.surfaces.values()] == [10, 10, 2.5]


def test_events_and_streams_are_bounded_unless_told_otherwise(tmp_path: Path) -> None:
    settings = load_settings(None, {})
    assert (settings.server.max_streams, settings.events) == (32, EventsSection())
    assert (settings.events.file, settings.events.keep_days, settings.events.max_mb) == (None, 30, 100)

    settings = load(tmp_path, "[server]\nmax_streams = 3\n[events]\nfile = 'events.db'\nkeep_days = 1.5\nmax_mb = 2\n")
    assert (settings.server.max_streams, settings.events.file) == (3, tmp_path / "events.db")
    assert (settings.events.keep_days, settings.events.max_mb) == (1.5, 2)


def test_the_command_line_wins(tmp_path: Path) -> None:
    settings = load(
        tmp_path,
        '[server]\nhost = "::1"\nport = 9000\n[surfaces.a]\nmodel = "a.onnx"\nstale_ms = 250\n',
        host="localhost",
        port=0,
        model="other.onnx",
        stale_ms=100.0,
    )

    assert (settings.server.host, settings.server.port) == ("localhost", 0)
    ((name, entry),) = settings.surfaces.items()
    assert (name, entry.model, entry.stale_ms) == ("a", Path("other.onnx"), 100)


def test_a_model_alone_names_its_surface_itself() -> None:
    ((name, entry),) = load_settings(None, {"model": "m.onnx"}).surfaces.items()

    assert (name, entry.model, entry.stale_ms) == ("", Path("m.onnx"), 500)
    assert entry.unexplained_after_s == 10


def test_the_token_is_not_printed(tmp_path: Path) -> None:
    (tmp_path / "token").write_text("correct-horse-battery\n")
    settings = load_settings(None, {"write_token_file": str(tmp_path / "token")})

    assert "correct-horse" not in repr(settings)
    assert "correct-horse" not in repr(read_access(settings.server))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[server]\nprot = 1\n", "unknown key server.prot; did you mean port?"),
        ("[surfaces.a]\nmodle = 'x'\n", "unknown key surfaces.a.modle"),
        ("[surfaces.'a b']\n", "surfaces.a b"),
        ("[server]\nport = '1'\n", "server.port: must be a whole number"),
        ("[server]\nport = 65536\n", "server.port: must be at most 65535"),
        ("[server]\nhost = ''\n", "server.host"),
        ("[surfaces.a]\nstale_ms = 0\n", "surfaces.a.stale_ms"),
        ("[surfaces.a]\nunexplained_after_s = 0\n", "surfaces.a.unexplained_after_s: must be more than 0"),
        ("[surfaces.a]\nunexplained_after_s = 100000\n", "surfaces.a.unexplained_after_s"),
        ("[surfaces.a]\nstale_ms = nan\n", "surfaces.a.stale_ms: must be a finite number"),
        ("[events]\nkeep_days = 0\n", "events.keep_days"),
        ("[events]\nmax_mb = 0\n", "events.max_mb"),
        ("[server]\nmax_streams = -1\n", "server.max_streams"),
        ("[server]\nmax_streams = -1\n", "server.max_streams: must be at least 0"),
        ("[server]\nmax_streams = 1001\n", "server.max_streams: must be at most 1000"),
        ("[server]\ncertificate_file = 'c.pem'\n", "server.key_file is missing"),
        ("[server\n", "not valid TOML"),
        ("a = " + "[" * 100_000, "not valid TOML"),
        ("a = " + "9" * 5000, "not valid TOML"),
        ("#" * 2**21, "larger than 1 MiB"),
    ],
)
def test_a_wrong_config_is_refused_with_the_place_that_is_wrong(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(InputError) as caught:
        load(tmp_path, text)

    assert complaint in str(caught.value)


def test_a_wrong_option_is_named_as_it_was_typed() -> None:
    with pytest.raises(InputError, match="command line: --stale-ms: must be a finite number"):
        load_settings(None, {"stale_ms": float("nan")})


def test_one_model_is_not_for_several_surfaces(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--model is for a single surface, but the config has a, b"):
        load(tmp_path, "[surfaces.a]\n[surfaces.b]\n", model="m.onnx")


def test_a_config_that_is_not_there_or_not_text_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere.toml: No such file"):
        load_settings(tmp_path / "nowhere.toml", {})
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match=r"binary.toml: not a text file in UTF-8"):
        load_settings(tmp_path / "binary.toml", {})


def test_each_purpose_has_a_token_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "token").write_text("correct-horse-battery\n")
    (tmp_path / "read-token").write_text("another-horse-battery\n")
    text = '[server]\nwrite_token_file = "token"\nread_token_file = "{}"\n'

    access = read_access(load(tmp_path, text.format("read-token")).server)
    assert (access.write, access.read) == ("correct-horse-battery", "another-horse-battery")
    with pytest.raises(InputError, match="token hold the same token; each purpose needs its own token"):
        read_access(load(tmp_path, text.format("token")).server)


def test_the_example_is_a_config(tmp_path: Path) -> None:
    (tmp_path / "token").write_text("correct-horse-battery\n")
    settings = load(tmp_path, EXAMPLE.read_text())

    assert list(settings.surfaces) == ["press-7"]
    assert read_access(settings.server).write == "correct-horse-battery"


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
    taken = []
    for what, wrong in with_wrong_numbers(content):
        try:
            ConfigFile.model_validate(wrong)
        except ValidationError:
            continue
        taken.append(what)
    assert not taken


def test_the_example_shows_the_modbus_server_as_it_is_by_default(tmp_path: Path) -> None:
    assert load_settings(None, {}).outputs == ()
    (by_default,) = load(tmp_path, "[modbus_server]\n").outputs
    _, _, section = EXAMPLE.read_text().partition("# [modbus_server]")
    shown = section.partition("\n\n")[0].replace("\n# ", "\n")

    assert load(tmp_path, f"[modbus_server] # {shown}\n").outputs == (by_default,)
    assert by_default == ModbusServerSection()
    assert tuple(by_default.model_dump().values()) == ("127.0.0.1", 502, "big", 32, 60)


URL = "postgresql://beamtouch:not-for-the-log@db/beamtouch"


def test_a_replica_needs_a_record_that_services_share(tmp_path: Path) -> None:
    settings = load(tmp_path, f"[server]\nreplica = true\n[events]\nurl = '{URL}'\n")
    assert (settings.server.replica, settings.events.url) == (True, URL)
    assert "not-for-the-log" not in repr(settings)
    with pytest.raises(InputError, match=r"server\.replica: .* set events\.url"):
        load(tmp_path, "[server]\nreplica = true\n[events]\nfile = 'events.db'\n")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"file = 'events.db'\nurl = '{URL}'", "both given"),
        ("url = 'mysql://beamtouch:not-for-the-log@db/beamtouch'", "must look like postgresql://"),
        ("url = 'postgresql://beamtouch:not-for-the-log@db'", "must look like postgresql://"),
        (f"url = '{URL}'\nurls = 1", "unknown key events.urls"),
        (f"url = '{URL}'\n[mqtt]\nhost = 'broker'", "as each service would send the events of all"),
    ],
)
def test_a_wrong_address_of_events_is_refused_without_its_password(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        load(tmp_path, f"[events]\n{text}\n")
    assert "not-for-the-log" not in str(caught.value)


def test_a_broker_that_no_host_can_be_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r": mqtt\.host: must be the name or address of a host"):
        load(tmp_path, '[mqtt]\nhost = "broker..plant"\n')


@pytest.mark.parametrize("place", ["server.write_token_file", "events.file", "surfaces.a.model"])
def test_a_path_that_no_file_can_have_is_refused(tmp_path: Path, place: str) -> None:
    table, _, key = place.rpartition(".")
    with pytest.raises(InputError, match=rf"{place}: must be the path of a file "):
        load(tmp_path, f'[{table}]\n{key} = "a\\u0000b"\n')
