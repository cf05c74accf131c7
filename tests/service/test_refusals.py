"""The command: wrong input ends in exit code 2 and one line that says what to do."""

import json
import os
import subprocess
import sys
from binascii import crc_hqx
from collections.abc import Callable
from pathlib import Path

import onnx
import pytest

from beamtouch_models import cli as design_sensors
from beamtouch_service import cli
from service.bench import READ_TOKEN, TOKEN
from support.network.certificates import make_certificate
from support.programs.in_process import Command, command_of
from support.running.debian_parts import require
from support.surfaces.small_model import content_of, write_model


@pytest.fixture
def service(capsys: pytest.CaptureFixture[str]) -> Command:
    """The command, run in this process: for what ends before it listens."""
    return command_of(cli.main, capsys)


@pytest.fixture
def refused(service: Command) -> Callable[..., str]:
    """A function that runs a command and returns the one line with which it is refused."""

    def refuse(*arguments: object, code: int = 2) -> str:
        done = service(*arguments)
        assert (done.returncode, done.stdout) == (code, ""), done.stderr
        (line,) = done.stderr.splitlines()
        return line

    return refuse


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("run --port -1", "command line: --port: must be"),
        ("run --host 127.0.0.1:8420", "--host: must be the name or address of a host"),
        ("run --host no.such.host.invalid", "no.such.host.invalid is open to the network"),
        ("run --key-file key.pem", "certificate_file is missing"),
    ],
)
def test_a_wrong_option_is_one_line(refused: Callable[..., str], words: str, complaint: str) -> None:
    assert complaint in refused(*words.split())


@pytest.mark.promise("docs/reference/http.md", "An address beyond loopback requires a read and a write token.")
@pytest.mark.promise(
    "docs/reference/service-configuration.md",
    "Addresses beyond loopback require a write token and a read token.",
)
@pytest.mark.promise(
    "docs/how-to/two-hosts.md",
    "A service that listens beyond loopback refuses to start without both tokens.",
)
@pytest.mark.parametrize("host", ["0.0.0.0", "::"])  # noqa: S104  # that it is refused is the point
def test_the_network_without_tokens(refused: Callable[..., str], host: str, token_file: Path) -> None:
    line = refused("run", "--host", host, "--port", 0)
    assert line.endswith("add --write-token-file FILE and --read-token-file FILE, or use 127.0.0.1")
    line = refused("run", "--host", host, "--port", 0, "--write-token-file", token_file)
    assert line.endswith("a write token and a read token: add --read-token-file FILE, or use 127.0.0.1")


@pytest.mark.promise("docs/how-to/upgrade.md", "says in one line why a service would refuse a file.")
def test_a_model_that_cannot_be_served_is_refused_by_run_and_check(refused: Callable[..., str], tmp_path: Path) -> None:
    path = tmp_path / "press-7.onnx"
    whole = content_of()
    fixed = onnx.load_from_string(whole)
    for value in [*fixed.graph.input, *fixed.graph.output]:
        value.type.tensor_type.shape.dim[0].dim_value = 2
    for content, complaint in {
        whole[: len(whole) // 2]: "damaged or not an ONNX file; rebuild it with",
        b"hello": "damaged or not an ONNX file",
        content_of(outputs=("position_mm",)): "lacks position_low_mm, position_high_mm, contact_log_odds, misfit)",
        fixed.SerializeToString(): "its graph fails on a single sample",
        bytes(5_000_000): "it is larger than 4 MiB",
    }.items():
        path.write_bytes(content)
        line = refused("run", "--model", path)
        assert line.startswith(f"beamtouch-service: model {path}: ")
        assert complaint in line
        assert refused("check", path) == line
    os.mkfifo(tmp_path / "pipe.onnx")
    for command in (("run", "--model"), ("check",)):
        assert "it is not a regular file" in refused(*command, tmp_path / "pipe.onnx"), "nobody ever writes to it"


def test_check_says_what_a_model_is(service: Command, bench_model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = service("check", bench_model).stdout
    assert "s1 68, s2 156, s3 244, s4 332 mm" in text
    assert "the graph gives the" in text
    assert design_sensors.main(["inspect", str(bench_model)]) == 0
    assert capsys.readouterr().out == text
    said = json.loads(service("check", "--json", bench_model).stdout)
    assert len(said["positions_mm"]) == len(said["channels"]) == 4


def test_a_file_that_may_come_later_is_no_wrong_input(refused: Callable[..., str], tmp_path: Path) -> None:
    """The service manager starts the service again until it is there."""
    line = refused("run", "--write-token-file", tmp_path / "token", code=1)
    assert f"token file {tmp_path}/token: No such file or directory" in line
    (tmp_path / "token").touch()
    line = refused("run", "--write-token-file", tmp_path / "token")
    assert "empty; write at least 16 random characters to it" in line


def test_certificates_of_clients_may_come_later(refused: Callable[..., str], tmp_path: Path) -> None:
    own, key = make_certificate(tmp_path, key_kind=("rsa:2048",))
    text = f'[opcua]\ncertificate_file = "{own}"\nkey_file = "{key}"\ntrusted_folder = "later"\n'
    (tmp_path / "service.toml").write_text(text)
    line = refused("run", "--port", 0, "--config", tmp_path / "service.toml", code=1)
    assert f"{tmp_path}/later: no certificates of clients in it" in line


def test_a_certificate_that_will_not_do(refused: Callable[..., str], certificate: tuple[Path, Path]) -> None:
    pem, key = certificate
    pair = ("run", "--port", 0, "--certificate-file")
    assert "not a PEM certificate and its key" in refused(*pair, key, "--key-file", pem)
    assert "nowhere.pem: No such file" in refused(*pair, pem.with_name("nowhere.pem"), "--key-file", key, code=1)


URL = "postgresql://beamtouch:not-for-the-log@db/beamtouch"
BROKER = '[mqtt]\nhost = "b"\n'
ZONES = "".join(f"[surfaces.a.zones.z{number}]\nfrom_mm = 0\nto_mm = 9\n" for number in range(7))
SURFACES = "\n".join(f"[surfaces.press-{number}]" for number in range(1093))


@pytest.mark.promise(
    "deploy/README.md",
    "Messages never contain the URL.",
    "`[mqtt]` and `[opcua]` are refused together with `events.url`, because each service would send the events of all.",
)
@pytest.mark.promise("docs/how-to/mqtt.md", "`[mqtt]` is refused together with `events.url`")
@pytest.mark.promise("docs/how-to/opcua.md", "Services that share a database refuse `[opcua]`")
@pytest.mark.promise("docs/reference/service-configuration.md", "Needs `events.url`.")
@pytest.mark.promise("docs/reference/registers.md", "the service does not start")
@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[server]\ncertificate_file = 'c.pem'\n", "server.key_file is missing"),
        ("[server]\nreplica = true\n[events]\nfile = 'events.db'\n", "server.replica: all replicas need one record"),
        ("[server]\nwrite_token_file = 'token'\nread_token_file = 'token'\n", "each purpose needs its own token"),
        ("[server]\nwrite_token_file = 'named'\nadmin_token_file = 'named-too'\n", "the same name, hall; each token"),
        ("[server]\nread_token_file = 'own'\n", "own: the name Service is that of the service itself on the trail"),
        ("[server]\ntrusted_proxies = ['proxy.example']\n", "server.trusted_proxies[0]: expected an address such as"),
        ("[events]\nfile = 'lines'\n", "lines: file is not a database; set events.file to one that the service can"),
        ("[events]\nurl = 'mysql://beamtouch:not-for-the-log@db/beamtouch'\n", "must look like postgresql://"),
        ("[events]\nurl = 'postgresql://beamtouch:not-for-the-log@db'\n", "must look like postgresql://"),
        ("[events]\nurl = 'postgresql://beamtouch:a@not-for-the-log@db/b'\n", "in a password, write @ as %40"),
        ("[events]\nurl = 'postgresql://beamtouch:not-for-the-log@db:port/b'\n", "events.url cannot be read; it looks"),
        (f"[events]\nurl = '{URL}'\nurls = 1\n", "unknown key events.urls"),
        (f"[events]\nurl = '{URL}'\n{BROKER}", "as each service would send the events of all"),
        (f"[events]\nurl = '{URL}'\n[opcua]\n", "as each service would send the events of all"),
        ("[modbus_server]\nword_order = 'middle'\n", "modbus_server.word_order"),
        (f"[modbus_server]\nport = 0\n{SURFACES}\n", "the addresses of Modbus hold 1092 surfaces, but there are 1093"),
        (ZONES, "surfaces.a.zones: must have at most 6"),
        ('[opcua]\ncertificate_file = "a.pem"\n', "key_file is missing"),
        ('[opcua]\ntrusted_folder = "clients"\n', "trusted_folder has no effect"),
        ('[opcua]\nusername = "scada"\n', "password_file is missing"),
        ("[opcua]\ninterval_ms = 1\n", "opcua.interval_ms"),
        (
            '[opcua]\nhost = "0.0.0.0"\n',
            "[opcua]: 0.0.0.0 is open to the network, which requires a certificate and a user: "
            "add certificate_file and key_file and username and password_file, or use 127.0.0.1",
        ),
        ("[mqtt]\nport = 1883\n", "mqtt.host is missing; add it"),
        (f'{BROKER}prefix = "a/+"\n', "mqtt.prefix: must match the pattern"),
        (f'{BROKER}ca_file = "ca.pem"\n', "mqtt: ca_file has no effect without TLS; set tls = true"),
        (f'{BROKER}tls = true\nkey_file = "k"\n', "mqtt: certificate_file is missing; a client certificate needs"),
        (f'{BROKER}tls = true\nca_file = "token"\n', "token: not PEM; set mqtt.ca_file to"),
        (f'{BROKER}tls = true\ncertificate_file = "token"\nkey_file = "token"\n', "are not a PEM certificate"),
        (f'{BROKER}password_file = "token"\n', "mqtt: password_file has no effect without a user; set username"),
        (f'{BROKER}username = "u"\npassword_file = "lines"\n', "lines: not one line of text; write the password"),
    ],
)
def test_a_wrong_config_is_refused_with_the_place_that_is_wrong(
    refused: Callable[..., str], tmp_path: Path, text: str, complaint: str
) -> None:
    (tmp_path / "token").write_text(TOKEN)
    (tmp_path / "named").write_text(f"hall {TOKEN}")
    (tmp_path / "named-too").write_text(f"hall {READ_TOKEN}")
    (tmp_path / "own").write_text(f"hall {TOKEN}\nService {READ_TOKEN}")
    (tmp_path / "lines").write_text("one\ntwo\n" * 200)
    (tmp_path / "service.toml").write_text(text)
    line = refused("run", "--port", 0, "--config", tmp_path / "service.toml")
    assert complaint in line
    assert "not-for-the-log" not in line


@pytest.mark.promise(
    "docs/reference/events.md",
    "A damaged file stays as it is: the log names the reason, and a service that starts refuses it.",
)
def test_a_damaged_record_is_refused_and_stays_as_it_is(refused: Callable[..., str], tmp_path: Path) -> None:
    damaged = b"SQLite format 3\x00" + bytes(range(256)) * 64
    (tmp_path / "events.db").write_bytes(damaged)
    (tmp_path / "service.toml").write_text('[events]\nfile = "events.db"\n')
    line = refused("run", "--port", 0, "--config", tmp_path / "service.toml")
    assert f"{tmp_path}/events.db: " in line
    assert [(one.name, one.read_bytes()) for one in tmp_path.glob("events.db*")] == [("events.db", damaged)]


def test_one_model_is_not_for_several_surfaces(refused: Callable[..., str], tmp_path: Path) -> None:
    (tmp_path / "service.toml").write_text("[surfaces.a]\n[surfaces.b]\n")
    line = refused("run", "--config", tmp_path / "service.toml", "--model", "m.onnx")
    assert "--model is for a single surface, but the config has a, b" in line


@pytest.mark.promise("docs/how-to/opcua.md", "The key must be an RSA key, as OPC UA needs.")
@pytest.mark.parametrize(
    ("certificate_file", "key_file", "words"),
    [
        ("key.pem", "key.pem", "key.pem: not a PEM or DER certificate"),
        ("certificate.pem", "certificate.pem", "certificate.pem: not a PEM or DER private key without a passphrase"),
        ("certificate.pem", "key.pem", "key.pem: not an RSA key, which the security policies of OPC UA need"),
        ("certificate.pem", "other.key", "other.key: not the key of"),
    ],
)
def test_certificates_that_no_opc_ua_client_could_use(
    refused: Callable[..., str], certificate: tuple[Path, Path], certificate_file: str, key_file: str, words: str
) -> None:
    folder = certificate[0].parent
    other = [require("openssl", "openssl"), "genrsa", "-out", str(folder / "other.key"), "2048"]
    subprocess.run(other, check=True, capture_output=True)
    config = folder / "service.toml"
    config.write_text(f'[opcua]\ncertificate_file = "{certificate_file}"\nkey_file = "{key_file}"\n')
    assert words in refused("run", "--port", 0, "--config", config)


@pytest.mark.parametrize(
    ("library", "section", "advice"),
    [
        ("paho", 'mqtt]\nhost = "b"', "[mqtt] needs paho; run: pip install 'beamtouch[service,mqtt]'"),
        (
            "pymodbus",
            "modbus_server]\nport = 0",
            "[modbus_server] needs pymodbus; run: pip install 'beamtouch[service,modbus-server]'",
        ),
        (
            "psycopg",
            "events]\nurl = 'postgresql://beamtouch@127.0.0.1/beamtouch'",
            "events.url needs psycopg; run: pip install 'beamtouch[postgresql]'",
        ),
    ],
)
def test_a_missing_library_of_a_section_names_the_extra(
    service: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, library: str, section: str, advice: str
) -> None:
    # A part of the library that another test has imported would be found without the library.
    for module in [name for name in sys.modules if name.startswith(("beamtouch_service.outputs.m", f"{library}."))]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, library, None)  # as if it were not installed
    (tmp_path / "service.toml").write_text(f"[{section}\n")
    done = service("run", "--port", 0, "--config", tmp_path / "service.toml")
    assert (done.returncode, done.stdout, done.stderr.splitlines()[-1]) == (2, "", f"beamtouch-service: {advice}")


def test_a_missing_library_of_the_service_names_the_extra() -> None:
    program = "import sys; sys.modules['fastapi'] = None\nfrom beamtouch_service.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", program, "run", "--port", "0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "beamtouch-service: fastapi is not installed; run: pip install 'beamtouch[service]'\n"


@pytest.mark.promise(
    "docs/reference/http.md",
    (
        "A service that listens beyond loopback and names no proxy (`server.proxy`) says so when it starts; "
        "`beamtouch-service check --config FILE` says so before."
    ),
)
@pytest.mark.promise("docs/how-to/two-hosts.md", "says when a service is open to other machines and names no proxy.")
def test_check_warns_of_what_is_open_to_others(
    service: Command, tmp_path: Path, token_file: Path, read_token_file: Path
) -> None:
    config = tmp_path / "service.toml"
    tokens = f'write_token_file = "{token_file}"\nread_token_file = "{read_token_file}"\n'
    surface = f'[surfaces.press-7]\nmodel = "{write_model(tmp_path).name}"\n'

    def check(server: str, *options: str, more: str = "") -> str:
        config.write_text(f"[server]\nport = 0\n{tokens}{server}\n{surface}{more}")
        done = service("check", "--config", config, *options)
        assert done.returncode == 0
        return done.stdout

    assert check('host = "127.0.0.1"').startswith("surface press-7: press-7@")
    assert "warning" not in check('host = "127.0.0.1"')
    assert "warning: no proxy: other machines can hold connections" in check('host = "0.0.0.0"')
    assert "warning" not in check('host = "0.0.0.0"\nproxy = "192.168.1.4"')
    (line, *_) = json.loads(check('host = "0.0.0.0"', "--json"))["warnings"]
    assert line.startswith("no TLS")
    assert "no token protects the Modbus TCP server" in check("", more="[modbus_server]\nport = 0\n")


@pytest.mark.promise("docs/how-to/opcua.md", "Without a user and a `trusted_folder`, everyone on the machine can read")
@pytest.mark.parametrize(
    ("keys", "is_open"),
    [
        ((), True),
        (("certificate_file = 'certificate.pem'", "key_file = 'key.pem'"), True),
        (("certificate_file = 'certificate.pem'", "key_file = 'key.pem'", "trusted_folder = 'clients'"), False),
        (("username = 'scada'", "password_file = 'password'"), False),
    ],
    ids=["nothing", "certificate", "trusted clients", "user"],
)
def test_check_warns_of_an_opc_ua_server_that_everyone_reads(
    service: Command, tmp_path: Path, read_token_file: Path, keys: tuple[str, ...], is_open: bool
) -> None:
    make_certificate(tmp_path, key_kind=("rsa:2048",))
    (tmp_path / "clients").mkdir()
    make_certificate(tmp_path / "clients", key_kind=("rsa:2048",))[1].unlink()
    (tmp_path / "password").write_text("a long password\n")
    lines = ("[server]", "port = 0", f"read_token_file = '{read_token_file}'", "[opcua]", *keys)
    (tmp_path / "service.toml").write_text("\n".join(lines))
    done = service("check", "--config", tmp_path / "service.toml")
    assert done.returncode == 0, done.stderr
    assert ("neither a user nor trusted certificates protect the OPC UA server" in done.stdout) is is_open


@pytest.mark.promise(
    "docs/reference/service-configuration.md", "Addresses beyond loopback require a certificate and a user."
)
@pytest.mark.parametrize(
    ("host", "keys", "missing"),
    [
        ("host = '127.0.0.1'", (), ""),
        ("host = '0.0.0.0'", ("user",), "add certificate_file and key_file, or use 127.0.0.1"),
        ("host = '0.0.0.0'", ("certificate",), "add username and password_file, or use 127.0.0.1"),
        ("host = '0.0.0.0'", ("certificate", "trusted"), "add username and password_file, or use 127.0.0.1"),
        ("host = '::'", ("user",), "add certificate_file and key_file, or use 127.0.0.1"),
        ("host = 'no-such-host.invalid'", ("user",), "add certificate_file and key_file, or use 127.0.0.1"),
        ("host = '0.0.0.0'", ("certificate", "user"), ""),
    ],
)
def test_beyond_loopback_opc_ua_requires_a_certificate_and_a_user(
    service: Command, tmp_path: Path, host: str, keys: tuple[str, ...], missing: str
) -> None:
    make_certificate(tmp_path, key_kind=("rsa:2048",))
    (tmp_path / "clients").mkdir()
    make_certificate(tmp_path / "clients", key_kind=("rsa:2048",))[1].unlink()
    (tmp_path / "password").write_text("a long password\n")
    lines = {
        "certificate": "certificate_file = 'certificate.pem'\nkey_file = 'key.pem'",
        "trusted": "trusted_folder = 'clients'",
        "user": "username = 'scada'\npassword_file = 'password'",
    }
    config = tmp_path / "service.toml"
    config.write_text("\n".join(["[opcua]", host, *(lines[key] for key in keys)]))
    done = service("check", "--config", config)
    if missing:
        (line,) = done.stderr.splitlines()
        assert (done.returncode, line.endswith(missing)) == (2, True), line
    else:
        assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.promise(
    "docs/reference/registers.md",
    "Two names may have the same identity; `beamtouch-service check` then says which to rename.",
)
def test_check_names_surfaces_whose_blocks_no_controller_can_tell_apart(service: Command, tmp_path: Path) -> None:
    names = ("press-898", "press-3264", "press-1")
    assert crc_hqx(names[0].encode(), 0) == crc_hqx(names[1].encode(), 0)
    surfaces = "".join(f"[surfaces.{name}]\n" for name in names)
    (tmp_path / "service.toml").write_text(f"[server]\nport = 0\n[modbus_server]\nport = 0\n{surfaces}")
    done = service("check", "--config", tmp_path / "service.toml")
    (line,) = [line for line in done.stdout.splitlines() if "identity" in line]
    assert line.startswith("warning: surfaces press-898 and press-3264 have the same Modbus identity")
