"""The daemon's client: what keeps an answer away is said in words; over TLS with real certificates."""

import asyncio
import re
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

import pytest

from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.publish import trust
from beamtouch_daemon.delivery.client import (
    INVALID_REQUEST,
    NEVER_ACCEPTED,
    OTHER_BEAM,
    TOO_LARGE,
    ServiceAnswer,
    ServiceClient,
    UnreachableError,
    Verdict,
)
from beamtouch_daemon.delivery.readiness import calibration_on, contact_on
from beamtouch_service.problems import Kind
from beamtouch_service.samples import Batch
from support.network.certificates import make_certificate
from support.surfaces import configs

pytestmark = pytest.mark.anyio

ANSWER = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}"
DEEP = b"[" * 100_000


@dataclass(frozen=True)
class Certificates:
    """Two certificates for this machine, one for another, and a file with both of the first."""

    own: tuple[Path, Path]
    other: tuple[Path, Path]
    foreign: tuple[Path, Path]
    both: Path


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Certificates:
    folders = [tmp_path_factory.mktemp(name) for name in ("own", "other", "foreign")]
    own, other = make_certificate(folders[0]), make_certificate(folders[1])
    both = folders[0] / "both.pem"
    both.write_text(other[0].read_text() + own[0].read_text())
    return Certificates(own, other, make_certificate(folders[2], "DNS:beams.example"), both)


@asynccontextmanager
async def answering(
    answer: bytes = ANSWER, certificate: tuple[Path, Path] | None = None, wait_s: float = 0.0
) -> AsyncIterator[str]:
    """Run a server that answers every request with these bytes after a while; gives its host and port."""

    async def run(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        read = await reader.read(65_536)
        while read.startswith(b"POST") and b"{}" not in read and b"gzip" not in read:
            read += await reader.read(65_536)
        await asyncio.sleep(wait_s)
        writer.write(answer)
        writer.close()

    context = None
    if certificate is not None:
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        context.load_cert_chain(*certificate)
    async with await asyncio.start_server(run, "127.0.0.1", 0, ssl=context) as server:
        yield f"127.0.0.1:{server.sockets[0].getsockname()[1]}"


async def post(url: str, trusted: Path | None = None) -> ServiceAnswer:
    async with ServiceClient(url, "token", trust(trusted) if trusted else None) as client:
        return await client.post_samples("bench", None)


async def unreachable(url: str, trusted: Path | None = None) -> UnreachableError:
    while True:
        with pytest.raises(UnreachableError) as caught:
            await post(url, trusted)
        if str(caught.value) != "timeout":  # as on a starved machine
            return caught.value


@pytest.mark.promise(
    "docs/how-to/two-hosts.md",
    "The daemon accepts the certificate only if `publish.url` has a name or address that it states.",
)
@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "Certificates to trust with https (PEM); default: those of the system.",
)
async def test_a_certificate_is_trusted_where_it_is_named_and_nowhere_else(certificates: Certificates) -> None:
    own, _ = certificates.own
    async with answering(certificate=certificates.own) as address:
        for trusted in (own, certificates.both):
            assert (await post(f"https://{address}", trusted)).status == 200
        for stranger in (None, certificates.other[0]):
            error = await unreachable(f"https://{address}", stranger)
            assert str(error) == "certificate refused: self-signed certificate"
            assert "publish.certificate_file" in error.advice
        plain = await unreachable(f"http://{address}")
        assert str(plain) == "connection closed"
    assert str(await unreachable(f"http://{address}")) == "Connection refused"
    async with answering(certificate=certificates.foreign) as address:
        error = await unreachable(f"https://{address}", certificates.foreign[0])
    assert str(error) == "certificate refused: IP address mismatch, certificate is not valid for '127.0.0.1'"
    assert error.advice == "publish.url must have a name or address that the certificate states"
    async with answering() as address:
        bare = await unreachable(f"https://{address}", own)
    assert str(bare) == "TLS failed"
    assert "publish.url must begin with http://" in bare.advice


@pytest.mark.parametrize(
    ("answer", "said"),
    [(b"SSH-2.0-OpenSSH_9.2\r\n", "the answer is not HTTP"), (ANSWER[:-1], "the answer broke off")],
    ids=["no HTTP", "cut"],
)
async def test_an_answer_that_is_none_is_said_in_words(answer: bytes, said: str) -> None:
    async with answering(answer) as address:
        assert str(await unreachable(f"http://{address}")) == said


async def test_an_error_of_another_program_is_an_answer_however_deep_its_json_is() -> None:
    head = b"HTTP/1.1 500 Internal Server Error\r\nContent-Length: %d\r\n\r\n" % len(DEEP)
    async with answering(head + DEEP) as address:
        answer = await post(f"http://{address}")
    assert (answer.verdict, answer.explanation) == (Verdict.LATER, "status 500")


def test_a_certificate_is_found_beside_the_configuration(tmp_path: Path, certificates: Certificates) -> None:
    path = configs.write(tmp_path, configs.surface())
    assert load_config(path).read_trust() is None
    path.write_text(path.read_text().replace("[publish]", '[publish]\ncertificate_file = "certificate.pem"'))
    (tmp_path / "certificate.pem").write_text(certificates.own[0].read_text())
    trusted = load_config(path).read_trust()
    assert trusted is not None
    assert len(trusted.get_ca_certs()) == 1


def test_the_types_of_problems_are_those_of_the_service() -> None:
    assert Kind.OTHER_BEAM.type_uri == OTHER_BEAM
    never = {Kind.TOO_LARGE: TOO_LARGE, Kind.INVALID_REQUEST: INVALID_REQUEST}
    assert {Kind.MALFORMED_JSON.type_uri, *(kind.type_uri for kind in never)} == {*never.values()} | NEVER_ACCEPTED
    assert all(kind.type_uri == uri for kind, uri in never.items())


RECEIPT = b'{"accepted": 1, "repeated": 0, "durable": null, "expected": null, "stale_ms": 500}'


@pytest.mark.parametrize(
    ("verdict", "status", "content"),
    [
        *((Verdict.TAKEN, status, RECEIPT) for status in (200, 299)),
        *((Verdict.LATER, status, RECEIPT) for status in (199, 300)),
        *((Verdict.LATER, status, b"") for status in (200, 399, 408, 429, 500, 503)),
        *((Verdict.REFUSED, status, b"") for status in (400, 401, 404, 407, 409, 428, 430, 499)),
        *((Verdict.SMALLER, status, b"") for status in (413,)),
        *((Verdict.SMALLER, status, b'{"type": "%s"}' % INVALID_REQUEST.encode()) for status in (422, 503)),
        *((Verdict.REFUSED, status, b'{"type": "%s"}' % OTHER_BEAM.encode()) for status in (409, 503)),
    ],
)
def test_an_answer_means_for_a_batch_what_its_problem_says_or_else_its_status(
    verdict: Verdict, status: int, content: bytes
) -> None:
    assert ServiceAnswer(status, content).verdict is verdict


def test_of_an_explanation_the_first_400_characters_are_said() -> None:
    answers = [ServiceAnswer(503, b'{"detail": "%s"}' % (b"x" * length)) for length in (400, 401)]
    assert [answer.explanation for answer in answers] == [f"status 503: {'x' * 400}"] * 2


def answer_of(body: str, status: str = "200 OK") -> bytes:
    """Return what a server answers with this JSON."""
    return f"HTTP/1.1 {status}\r\nContent-Length: {len(body)}\r\n\r\n{body}".encode()


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (answer_of('{"state": "clear", "position_mm": null, "force_n": null}'), ""),
        (answer_of('{"state": "contact", "position_mm": 99.6, "force_n": 3.5678}'), "a contact of 3.57 N at 100 mm"),
        (answer_of('{"state": "contact", "position_mm": 99.6, "force_n": null}'), "a contact at 100 mm"),
        (
            answer_of('{"state": "unexplained", "position_mm": null, "force_n": null}'),
            "something that it cannot explain",
        ),
        (answer_of("{}", "503 Service Unavailable"), None),
        (ANSWER[:-1], None),
    ],
    ids=["clear", "contact", "no force", "unexplained", "a problem", "cut"],
)
async def test_what_the_service_sees_is_said_in_words(answer: bytes, said: str | None) -> None:
    async with answering(answer) as address, ServiceClient(f"http://{address}", "token") as client:
        while (found := await contact_on(client, "bench")) is None and said is not None:
            pass  # a starved machine takes longer than the client waits
    assert found == said


@pytest.mark.parametrize(
    ("answer", "is_calibrated"),
    [
        (answer_of('{"calibration": null}'), False),
        (answer_of('{"calibration": {"loads": 9}}'), True),
        (answer_of("{}"), None),
        (ANSWER[:-1], None),
    ],
    ids=["no", "yes", "a problem", "cut"],
)
async def test_whether_the_model_is_calibrated_is_asked(answer: bytes, is_calibrated: bool | None) -> None:
    async with answering(answer) as address, ServiceClient(f"http://{address}", "token") as client:
        while (found := await calibration_on(client, "bench")) is None and is_calibrated is not None:
            pass  # a starved machine takes longer than the client waits
    assert found is is_calibrated


async def test_a_name_that_nobody_knows_is_said_in_words() -> None:
    assert str(await unreachable("http://no-such-host.invalid")) == "no such host is known"


async def test_what_is_no_answer_has_advice_only_if_something_is_to_be_changed() -> None:
    async with answering(b"SSH-2.0-OpenSSH_9.2\r\n") as address:
        assert (await unreachable(f"http://{address}")).advice == "is publish.url the address of another program?"
    async with answering(ANSWER[:-1]) as address:
        assert (await unreachable(f"http://{address}")).advice == ""
    async with answering(b"") as address:
        closed = await unreachable(f"http://{address}/")
    assert (str(closed), closed.advice) == ("connection closed", "")


async def test_the_debug_log_shows_each_request_and_its_answer(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("DEBUG", "beamtouch_daemon.delivery")
    begin_s = monotonic()
    async with answering(b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 2\r\n\r\n{}", wait_s=0.05) as address:
        await post(f"http://{address}")
        async with ServiceClient(f"http://{address}", "token") as client:
            with pytest.raises(UnreachableError):
                await client.post_samples("bench", Batch(boot_id="boot-0001", channels=["s1"], samples=[]), 0.02)
    at_most_ms = (monotonic() - begin_s) * 1e3
    await unreachable(f"http://{address}")
    url = f"POST http://{address}/surfaces/bench/samples"
    asked, answered, _, late, again, lost = caplog.messages[:6]
    assert asked == again == f"{url} with 2 bytes"
    found = re.fullmatch(rf"{re.escape(url)}: status 503 after (\d+\.\d) ms \(status 503\)", answered)
    assert found is not None
    assert 50 <= float(found[1]) <= at_most_ms
    found = re.fullmatch(rf"{re.escape(url)}: no answer after (\d+) ms: timeout", late)
    assert found is not None
    assert 20 <= float(found[1]) <= at_most_ms
    assert re.fullmatch(rf"{re.escape(url)}: no answer after \d+ ms: Connection refused", lost)


async def test_what_was_not_sent_of_a_request_that_was_given_up_is_never_sent() -> None:
    begun, given_up, ends = asyncio.Event(), asyncio.Event(), asyncio.Queue[Exception | None]()

    async def run(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        begun.set()
        await given_up.wait()
        try:
            while await reader.read(65_536):
                pass
            ends.put_nowait(None)
        except ConnectionResetError as error:
            ends.put_nowait(error)
        writer.close()

    async with await asyncio.start_server(run, "127.0.0.1", 0) as server:
        url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
        async with ServiceClient(url, "token") as client:
            batch = Batch(boot_id="boot-0001", channels=["s1"], samples=[])
            for patience_s in (0.5, 5.0, 50.0):  # a busy machine may not even connect within the first
                if not begun.is_set():
                    with pytest.raises(UnreachableError):
                        await client.post_samples("bench", batch, patience_s)
            given_up.set()
            assert isinstance(await ends.get(), ConnectionResetError)
