"""Units and gateways of which some requests fail: what is read all the same, and what is said."""

import asyncio
import json
import re
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager, closing, suppress
from pathlib import Path

import httpx2
import pytest
from prometheus_client.parser import text_string_to_metric_families

from support.network.free_ports import free_port
from support.surfaces import configs

from .devices import Pieces, RefusingUnit, RestingUnit, StampingUnit, rtu_units, tcp_unit
from .lines import terminal
from .process import command, started
from .service import Service, serving

pytestmark = pytest.mark.anyio

LINES = ["tcp", "rtu"]
MEANINGS = {
    5: "exception 5, it needs more time",
    6: "exception 6, device busy",
    10: "exception 10, gateway path unavailable",
    11: "exception 11, gateway",
}
PATIENT_MS = 10_000
"""For a starved machine; every request is answered."""


@asynccontextmanager
async def reached(kind: str, unit: StampingUnit, timeout_ms: float = PATIENT_MS) -> AsyncIterator[str]:
    """A unit behind a socket or on a bus; gives its source."""
    if kind == "tcp":
        async with tcp_unit(unit) as port:
            yield f'kind = "modbus-tcp"\nhost = "127.0.0.1"\nport = {port}\ntimeout_ms = {timeout_ms}'
    else:
        with terminal() as line:
            async with rtu_units(line, {1: unit}):
                yield f"{configs.rtu(line.path)}\ntimeout_ms = {timeout_ms}"


@pytest.mark.promise("docs/how-to/adc-module.md", "if a tenth of the requests fail, it says which and why")
@pytest.mark.parametrize("kind", LINES)
@pytest.mark.parametrize("every", [2, 3])
@pytest.mark.parametrize("exception", list(MEANINGS))
async def test_check_names_a_unit_that_refuses_now_and_then(
    kind: str, every: int, exception: int, tmp_path: Path
) -> None:
    async with reached(kind, RefusingUnit(exception, every)) as source:
        outcome = await command("check", configs.write(tmp_path, configs.surface(source=source)), "--json")
    assert outcome.code == 1
    surface = json.loads(outcome.out)["surfaces"]["bench"]
    assert [channel["quality"] for channel in surface["channels"]] == ["good", "good"]
    (failing,) = surface["failing"]
    failed, asked = map(int, re.findall(r"^(\d+) of (\d+) requests to unit 1 fail: ", failing)[0])
    assert 0.2 < failed / asked < 0.8
    assert f"{MEANINGS[exception]} ({failed}); " in failing
    assert failing in outcome.complaint()
    assert "rate_hz" not in failing


@pytest.mark.promise("docs/how-to/troubleshooting.md", "the same; exit code 1 from a tenth of the requests on")
@pytest.mark.parametrize(("every", "code"), [(25, 0), (11, 0), (10, 1), (8, 1)])
async def test_a_unit_that_refuses_less_than_a_tenth_of_the_requests_is_named_and_good(
    every: int, code: int, tmp_path: Path
) -> None:
    async with reached("tcp", RefusingUnit(6, every)) as source:
        # Four requests make a reading, so that the newest hundred of them are full.
        text = configs.surface(source=source, rate_hz=50.0, registers=(0, 1000, 2000, 3000))
        outcome = await command("check", configs.write(tmp_path, text), "--json")
    (failing,) = json.loads(outcome.out)["surfaces"]["bench"]["failing"]
    assert (outcome.code, "exception 6, device busy" in failing) == (code, True)


@pytest.mark.promise(
    "docs/how-to/troubleshooting.md",
    "A request that is refused is sent again, so readings may be complete all the same.",
)
@pytest.mark.parametrize("kind", LINES)
async def test_the_daemon_reads_on_and_names_it_in_log_and_metrics(kind: str, tmp_path: Path) -> None:
    port = free_port()
    async with reached(kind, RefusingUnit(6, 2)) as source, serving(Service()) as service:
        config = configs.write(tmp_path, configs.surface(source=source, rate_hz=20.0), url=service.url)
        config.write_text(f"{config.read_text()}\n[metrics]\nport = {port}\n")
        async with started("run", config) as daemon:
            await service.until(100)
            metrics = await metrics_of(port)
            outcome = await daemon.stop()
    (line,) = [line for line in outcome.err.splitlines() if "exception 6" in line]
    assert re.search(r"bench: \d+ of \d+ requests to unit 1 fail: exception 6, device busy \(\d+\); stop other", line)
    assert metrics["beamtouch_requests_failed_total", "unit 1", "exception-6"] > 50
    assert metrics["beamtouch_requests_total", "unit 1", ""] > 100
    assert "set rate_hz" not in outcome.err


async def metrics_of(port: int) -> dict[tuple[str, str, str], float]:
    """Return the values of all metrics by name, unit and reason."""
    async with httpx2.AsyncClient(trust_env=False) as client:
        text = (await client.get(f"http://127.0.0.1:{port}/metrics")).text
    return {
        (sample.name, sample.labels.get("unit", ""), sample.labels.get("reason", "")): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


async def test_one_unit_of_several_behind_a_gateway_is_named_and_costs_the_others_nothing(tmp_path: Path) -> None:
    refusing, resting = RefusingUnit(11, 1), RestingUnit()

    class Gateway(StampingUnit):
        def answer(self, request: bytes, wrap: Callable[[bytes], bytes]) -> Pieces:
            return (refusing if request[0] == 2 else resting).answer(request, wrap)

    async with reached("tcp", Gateway()) as source, serving(Service()) as service:
        text = configs.surface(source=source, rate_hz=20.0).replace("register = 1", "register = 1\nunit = 2")
        config = configs.write(tmp_path, text, url=service.url)
        async with started("run", config) as daemon:
            await service.until(80)
            outcome = await daemon.stop()
    refusal = "unit 2 answers with exception 11: gateway: the device does not answer; check supply, wiring and timeout"
    assert f"bench: {refusal}" in outcome.err
    assert "requests to unit 1" not in outcome.err
    assert "rate_hz" not in outcome.err


@pytest.mark.promise(
    "docs/how-to/troubleshooting.md",
    "The log asks for a lower `rate_hz` only if the unit answers, but too slowly.",
)
@pytest.mark.parametrize("kind", LINES)
async def test_requests_that_time_out_now_and_then_lead_to_no_advice_to_lower_the_rate(
    kind: str, tmp_path: Path
) -> None:
    unit = RestingUnit(lambda number, frame: [] if number % 20 == 0 else [(0.0, frame)])
    async with reached(kind, unit, timeout_ms=1000) as source, serving(Service()) as service:
        config = configs.write(tmp_path, configs.surface(source=source, rate_hz=20.0), url=service.url)
        async with started("run", config) as daemon:
            said = await daemon.said(" of 20 readings per second ")
            said += (await daemon.stop()).err
    assert re.search(r"only [\d.]+ of 20 readings per second arrive, as requests fail: means are of", said)
    assert re.search(r"\d+ of \d+ requests to unit 1 fail: no answer \(\d+\); check supply and wiring, or raise", said)
    assert "as a lower rate_hz does not help" in said
    assert "set rate_hz" not in said


@pytest.mark.promise("docs/how-to/troubleshooting.md", "only if the unit answers, but too slowly.")
async def test_a_unit_that_is_only_too_slow_is_still_told_a_rate(tmp_path: Path) -> None:
    unit = RestingUnit(lambda _number, frame: [(0.04, frame)])
    async with reached("tcp", unit) as source, serving(Service()) as service:
        config = configs.write(tmp_path, configs.surface(source=source, rate_hz=100.0), url=service.url)
        async with started("run", config) as daemon:
            said = await daemon.said(" or less")
            assert (await daemon.stop()).code == 0
    assert re.search(r"only [\d.]+ of 100 readings per second could be polled: .* set rate_hz to [\d.]+ or less", said)


@pytest.mark.parametrize("kind", LINES)
@pytest.mark.parametrize("exception", [1, 2, 3, 4])
async def test_a_unit_that_always_refuses_is_an_error_that_says_why(kind: str, exception: int, tmp_path: Path) -> None:
    async with reached(kind, RefusingUnit(exception, 1), timeout_ms=500) as source:
        outcome = await command("check", configs.write(tmp_path, configs.surface(source=source)))
    assert outcome.code == 1
    assert f"bench: unit 1 answers with exception {exception}: " in outcome.complaint()
    assert "supply" not in outcome.complaint()


class Closing:
    """A Modbus TCP server that ends each connection after some answers: at once, or in place of the next answer."""

    def __init__(self, answers: int, *, at_once: bool) -> None:
        self._answers, self._at_once = answers, at_once
        self.connections = 0

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        with closing(writer), suppress(asyncio.IncompleteReadError, ConnectionError):
            for _ in range(self._answers):
                header = await reader.readexactly(6)
                request = await reader.readexactly(6)
                unit, function, count = request[0], request[1], request[5]
                words = bytes([unit, function, 2 * count]) + (20_000).to_bytes(2, "big") * count
                writer.write(header[:4] + len(words).to_bytes(2, "big") + words)
            if not self._at_once:
                await reader.readexactly(12)


@pytest.mark.parametrize("at_once", [True, False], ids=["at once", "in place of an answer"])
@pytest.mark.parametrize("answers", [1, 3])
async def test_a_device_that_ends_its_connections_costs_no_reading(answers: int, at_once: bool, tmp_path: Path) -> None:
    device = Closing(answers, at_once=at_once)
    server = await asyncio.start_server(device.serve, "127.0.0.1", 0)
    async with server:
        port = server.sockets[0].getsockname()[1]
        outcome = await command("check", configs.write(tmp_path, configs.surface(source=configs.tcp(port))), "--json")
    assert outcome.code == 0, outcome
    assert json.loads(outcome.out)["surfaces"]["bench"]["failing"] == []
    assert device.connections > 5


async def test_a_device_that_only_ends_connections_is_said_to_do_so(tmp_path: Path) -> None:
    device = Closing(0, at_once=False)
    server = await asyncio.start_server(device.serve, "127.0.0.1", 0)
    async with server:
        port = server.sockets[0].getsockname()[1]
        outcome = await command("check", configs.write(tmp_path, configs.surface(source=configs.tcp(port))))
    assert outcome.complaint() == f"bench: 127.0.0.1:{port} closes the connection without an answer"


async def test_scan_says_what_to_check_of_a_device_that_only_ends_connections() -> None:
    server = await asyncio.start_server(Closing(0, at_once=True).serve, "127.0.0.1", 0)
    async with server:
        target = f"tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}"
        outcome = await command("scan", target, "--units", "1-2")
    assert outcome.code == 1
    assert f"nothing answers: {target} accepts connections; check the unit numbers" in outcome.err.splitlines()[-1]


async def test_an_answer_with_the_number_of_another_transaction_is_named(tmp_path: Path) -> None:
    unit = RestingUnit(lambda _, frame: [(0.0, b"\x12\x34" + frame[2:])])
    async with reached("tcp", unit, timeout_ms=500) as source:
        outcome = await command("check", configs.write(tmp_path, configs.surface(source=source)))
    assert "bench: unit 1 answers with the transaction number of another request" in outcome.complaint()


@pytest.mark.parametrize("kind", LINES)
@pytest.mark.parametrize("exception", [6, 11])
async def test_scan_finds_all_registers_of_a_unit_that_refuses_each_second_request(kind: str, exception: int) -> None:
    async with AsyncExitStack() as stack:
        unit = RefusingUnit(exception, 2)
        options = ["--units", "1", "--timeout-ms", str(PATIENT_MS), "--json"]
        if kind == "tcp":
            target = f"tcp://127.0.0.1:{await stack.enter_async_context(tcp_unit(unit))}"
        else:
            line = stack.enter_context(terminal())
            await stack.enter_async_context(rtu_units(line, {1: unit}))
            target, options = line.path, [*options, "--baud", "9600", "--parity", "none"]
        outcome = await command("scan", target, *options)
    (found,) = json.loads(outcome.out)["units"]
    assert (found["registers"], found["refusals"]) == (["input", "holding"], [exception])
