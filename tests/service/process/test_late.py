"""What may come later, when the service starts: it starts, says what is missing, and uses it when it comes."""

import socket
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from service.bench import BuildModel, batch_of
from service.event_story import RESTING, TOUCHING
from service.process.broker import Broker
from service.process.conftest import CLI, Command, Process, Service, StartService, service_of
from service.process.modbus_service import ask
from support.network.host_names import host_names_in
from support.running.waiting import wait_until


def complaint(process: Process) -> str:
    """Return the line that says what the service tries again."""
    assert process.stderr is not None
    return next(line for line in process.stderr if "trying again" in line)


def missing(service: Service) -> set[str]:
    """Return what the metrics call missing."""
    lines = service.get("/metrics").text.splitlines()
    return {line.split('"')[1] for line in lines if line.startswith("beamtouch_missing{") and line.endswith(" 1.0")}


def test_a_port_that_is_taken_is_waited_for(command: Command, token_file: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        process = command("run", "--port", str(taken.getsockname()[1]), "--write-token-file", token_file)
        line = complaint(process)
    assert "[server]: port" in line
    assert "in use; stop the program that listens there, or choose another port with --port" in line
    assert service_of(process, "").get("/health/live").status_code == 200


def test_a_name_that_does_not_resolve_is_waited_for(tmp_path: Path, token_file: Path, read_token_file: Path) -> None:
    names, pipe = host_names_in(tmp_path), subprocess.PIPE
    tokens = ("--write-token-file", str(token_file), "--read-token-file", str(read_token_file))
    run = (sys.executable, *CLI, "run", "--host", "gateway.plant", "--port", "0", *tokens)
    with subprocess.Popen((*names.prefix, *run), stdout=pipe, stderr=pipe, text=True) as process:
        try:
            assert "host 'gateway.plant' does not resolve" in complaint(process)
            names.add("gateway.plant", "127.0.0.1")
            assert service_of(process, "").get("/health/live").status_code == 200
        finally:
            process.kill()


@pytest.mark.parametrize("section", ["server", "opcua"])
def test_nothing_listens_beyond_loopback_when_a_name_leads_there_only_later(tmp_path: Path, section: str) -> None:
    names, pipe = host_names_in(tmp_path), subprocess.PIPE
    names.add("gateway.plant", "127.0.0.1")
    with ExitStack() as open_until_end:
        taken = open_until_end.enter_context(socket.create_server(("127.0.0.1", 0)))
        port = taken.getsockname()[1]
        config = tmp_path / "service.toml"
        own = "" if section == "server" else "[server]\nport = 0\n"
        config.write_text(f'{own}[{section}]\nhost = "gateway.plant"\nport = {port}\n')
        run = (*names.prefix, sys.executable, *CLI, "run", "--config", str(config))
        process = open_until_end.enter_context(subprocess.Popen(run, stdout=pipe, stderr=pipe, text=True))
        open_until_end.callback(process.kill)
        assert f"port {port} on 127.0.0.1: in use" in complaint(process)
        names.move("gateway.plant", "0.0.0.0")  # noqa: S104  # what must not happen
        assert f"port {port} on 0.0.0.0: in use" in complaint(process)
        taken.close()
        assert "0.0.0.0 is open to the network, which requires" in complaint(process)
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port))
        names.move("gateway.plant", "127.0.0.1")
        wait_until(lambda: accepts(port))


def accepts(port: int) -> bool:
    """Return whether something listens on a port of this machine."""
    with socket.socket() as line:
        return line.connect_ex(("127.0.0.1", port)) == 0


@pytest.mark.promise("docs/reference/metrics.md", "whose address, broker or record is not there")
def test_what_is_missing_is_named_and_used_when_it_comes(
    start_press: StartService, build_model: BuildModel, tmp_path: Path
) -> None:
    broker, record = Broker(tmp_path), tmp_path / "mount" / "events.db"
    model = build_model()
    absent = model.with_name("later.onnx")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        service = start_press(
            model=model,
            sections=f'[events]\nfile = "{record}"\n[modbus_server]\nport = {port}\n'
            f'[mqtt]\nhost = "127.0.0.1"\nport = {broker.port}\n'
            f'[surfaces.press-8]\nmodel = "{absent}"\nstale_ms = 60000\n',
        )
        receipt = service.post(batch_of(RESTING, TOUCHING, RESTING) | {"oldest": 1}).json()
        # The other surface goes on, and its sender keeps the samples for the record.
        assert (receipt["durable"], receipt["expected"]) == (None, None)
        assert service.get("/surfaces/press-7/contact").json()["state"] == "clear"
        assert service.get("/events").status_code == 503
        wait_until(lambda: missing(service) == {"events", "modbus_server", "mqtt"})
        problem = service.get("/health/ready")
        assert problem.status_code == 503
        assert set(problem.json()["missing"]) == {"events", "modbus_server", "mqtt"}
        assert f"port {port} on 127.0.0.1: in use" in problem.json()["missing"]["modbus_server"]
        assert "unable to open database file" in problem.json()["missing"]["events"]
        assert "refused" in problem.json()["missing"]["mqtt"]
        no_model = service.get("/surfaces/press-8/contact").json()
        assert no_model["type"].endswith("no-model")
        assert f"{absent}: No such file or directory" in no_model["detail"]

    record.parent.mkdir()
    absent.write_bytes(model.read_bytes())
    broker.start()
    try:
        wait_until(lambda: missing(service) == set())
        wait_until(lambda: service.get("/surfaces/press-8/contact").json()["type"].endswith("no-samples"))
        with socket.create_connection(("127.0.0.1", port)) as connection:
            assert len(ask(connection, 0, 40)) == 40
        wait_until(lambda: service.get("/events").status_code == 200)
        log = batch_of(RESTING, TOUCHING, RESTING) | {"oldest": 1, "backlog": True, "newest_age_ms": None}
        wait_until(lambda: service.post(log).json()["expected"] == 4)
        wait_until(lambda: [event["end"] for event in service.get("/events").json()["events"]] == ["lift"])
        assert set(service.get("/health/ready").json()["surfaces"]) == {"press-8"}
        assert service.get("/health/ready").json()["missing"] == {}
    finally:
        broker.close()
    assert record.stat().st_size > 0
