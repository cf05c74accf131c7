"""Wrong input ends in exit 2 and one line that says what to do."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

import onnx
import pytest

from beamtouch_service import cli

if TYPE_CHECKING:
    from pathlib import Path

    from service.conftest import BuildModel
    from service.process.conftest import Command, Process


def refusal(process: Process) -> str:
    output, errors = process.communicate(timeout=60)
    assert (process.returncode, output) == (2, "")
    (line,) = errors.splitlines()
    return line


def refused_here(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    """Run the command in this process: for refusals that come before it listens."""
    assert cli.main(["run", *map(str, arguments)]) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    (line,) = errors.splitlines()
    return line


def test_a_model_cut_in_half(command: Command, build_model: BuildModel) -> None:
    model = build_model()
    content = model.read_bytes()
    model.write_bytes(content[: len(content) // 2])

    line = refusal(command("run", "--port", "0", "--model", model))
    assert line.startswith(f"beamtouch-service: model {model}: damaged or not an ONNX file; rebuild it with")


def test_an_unknown_option_or_no_command(command: Command) -> None:
    assert "--bogus" in refusal(command("run", "--bogus"))
    assert refusal(command("run", "--port", "many")).endswith("see beamtouch-service run --help")
    assert "COMMAND" in refusal(command())


def test_a_model_that_is_not_there(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    line = refused_here(capsys, "--model", tmp_path / "nowhere.onnx")

    assert line.endswith("nowhere.onnx: No such file or directory")


def test_a_model_that_cannot_tell_contact_from_clear(
    capsys: pytest.CaptureFixture[str], build_model: BuildModel
) -> None:
    line = refused_here(capsys, "--model", build_model(outputs=("position_mm",)))

    assert "lacks position_low_mm, position_high_mm, contact_log_odds, misfit)" in line


def test_a_model_that_takes_only_its_own_golden_batch(
    capsys: pytest.CaptureFixture[str], build_model: BuildModel
) -> None:
    path = build_model()
    model = onnx.load(path)
    for value in [*model.graph.input, *model.graph.output]:
        value.type.tensor_type.shape.dim[0].dim_value = 2
    path.write_bytes(model.SerializeToString())

    assert "its graph fails on a single sample" in refused_here(capsys, "--model", path)


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])  # noqa: S104  # that it is refused is the point
def test_the_network_without_tokens(capsys: pytest.CaptureFixture[str], host: str, token_file: Path) -> None:
    line = refused_here(capsys, "--host", host, "--port", "0")
    assert line.endswith("add --write-token-file FILE and --read-token-file FILE, or use 127.0.0.1")

    line = refused_here(capsys, "--host", host, "--port", "0", "--write-token-file", token_file)
    assert line.endswith("a write token and a read token: add --read-token-file FILE, or use 127.0.0.1")


def test_a_host_that_no_host_can_be_and_one_that_may_be_open_to_the_network(capsys: pytest.CaptureFixture[str]) -> None:
    assert "--host: must be the name or address of a host" in refused_here(capsys, "--host", "127.0.0.1:8420")
    assert "no.such.host.invalid is open to the network" in refused_here(capsys, "--host", "no.such.host.invalid")


def test_a_token_file_that_is_not_there_yet_is_no_wrong_input(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    # systemd starts the service again until it is there.
    assert cli.main(["run", "--write-token-file", str(tmp_path / "token")]) == 1
    assert f"token file {tmp_path}/token: No such file or directory" in capsys.readouterr().err


@pytest.mark.parametrize("port", ["-1", "65536"])
def test_a_port_out_of_range(capsys: pytest.CaptureFixture[str], port: str) -> None:
    assert "command line: --port: must be" in refused_here(capsys, "--port", port)


def test_a_wrong_config(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    config = tmp_path / "service.toml"
    config.write_text("[surfaces.press-7]\nmodle = 'm.onnx'\n")

    line = refused_here(capsys, "--config", config)
    assert line.endswith("unknown key surfaces.press-7.modle; did you mean model?")


def test_a_token_file_that_is_empty(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "token").touch()

    line = refused_here(capsys, "--write-token-file", tmp_path / "token")
    assert "empty; write at least 16 random characters to it" in line


@pytest.mark.parametrize("missing", ["fastapi", "uvicorn", "onnxruntime", "numpy", "prometheus_client", "sqlalchemy"])
def test_a_missing_extra(missing: str) -> None:
    program = (
        f"import sys; sys.modules[{missing!r}] = None\n"
        "from beamtouch_service.cli import main; sys.exit(main(['run', '--port', '0']))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)

    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"beamtouch-service: {missing} is not installed; run: pip install 'beamtouch[service]'\n"


def test_check_says_when_a_service_is_open_to_other_machines_without_a_proxy(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    build_model: BuildModel,
    token_file: Path,
    read_token_file: Path,
) -> None:
    config = tmp_path / "service.toml"
    tokens = f'write_token_file = "{token_file}"\nread_token_file = "{read_token_file}"\n'
    surface = f'[surfaces.press-7]\nmodel = "{build_model().name}"\n'

    def check(server: str, *options: str) -> str:
        config.write_text(f"[server]\nport = 0\n{tokens}{server}\n{surface}")
        assert cli.main(["check", "--config", str(config), *options]) == 0
        return capsys.readouterr().out

    assert check('host = "127.0.0.1"').startswith("surface press-7: press-7@")
    assert "warning" not in check('host = "127.0.0.1"')
    assert "warning: no proxy: other machines can hold connections" in check('host = "0.0.0.0"')
    assert "warning" not in check('host = "0.0.0.0"\nproxy = "192.168.1.4"')
    (line, *_) = json.loads(check('host = "0.0.0.0"', "--json"))["warnings"]
    assert line.startswith("no TLS")

    config.write_text(f'[server]\nhost = "0.0.0.0"\n{surface}')
    assert cli.main(["check", "--config", str(config)]) == 2
    assert "is open to the network" in capsys.readouterr().err
