"""The daemon's client over TLS: a real server, real certificates."""

import asyncio
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from beamtouch_common.errors import FailedError, InputError
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.publish import trust
from beamtouch_daemon.delivery.client import Answer, ServiceClient, UnreachableError, Verdict
from certificates import make_certificate

from . import configs

pytestmark = pytest.mark.anyio

ANSWER = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n{}"


@asynccontextmanager
async def serving(certificate: Path, key: Path) -> AsyncIterator[str]:
    """Run a server that says yes to everything; gives its URL."""

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        await reader.readexactly(2)
        writer.write(ANSWER)
        await writer.drain()
        writer.close()

    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(certificate, key)
    server = await asyncio.start_server(answer, "127.0.0.1", 0, ssl=context)
    async with server:
        yield f"https://127.0.0.1:{server.sockets[0].getsockname()[1]}"


async def test_a_certificate_is_trusted_where_it_is_named_and_nowhere_else(tmp_path: Path) -> None:
    certificate, key = make_certificate(tmp_path)
    (tmp_path / "other").mkdir()
    other, _ = make_certificate(tmp_path / "other")
    both = tmp_path / "both.pem"
    both.write_text(other.read_text() + certificate.read_text())

    async def post(url: str, trusted: Path | None) -> Answer:
        async with ServiceClient(url, "token", trust(trusted) if trusted else None) as client:
            return await client.post_samples("bench", None)

    async with serving(certificate, key) as url:
        assert (await post(url, certificate)).status == 200
        assert (await post(url, both)).status == 200
        for stranger in (None, other):
            with pytest.raises(UnreachableError, match=r"^certificate refused: self-signed certificate$") as caught:
                await post(url, stranger)
            assert "publish.certificate_file" in caught.value.advice


@asynccontextmanager
async def unencrypted() -> AsyncIterator[int]:
    """Run a server that answers everything without TLS; gives its port."""

    async def answer(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(ANSWER)
        writer.close()

    async with await asyncio.start_server(answer, "127.0.0.1", 0) as server:
        yield server.sockets[0].getsockname()[1]


async def refused(url: str, trusted: Path | None = None) -> UnreachableError:
    async with ServiceClient(url, "token", trust(trusted) if trusted else None) as client:
        with pytest.raises(UnreachableError) as caught:
            await client.post_samples("bench", None)
    return caught.value


async def test_a_certificate_for_another_name_is_said_with_the_name(tmp_path: Path) -> None:
    certificate, key = make_certificate(tmp_path, "DNS:beams.example")
    async with serving(certificate, key) as url:
        error = await refused(url, certificate)
    assert str(error) == "certificate refused: IP address mismatch, certificate is not valid for '127.0.0.1'"
    assert error.advice == "publish.url must have a name or address that the certificate states"


async def test_https_without_tls_and_a_refused_connection_are_said(tmp_path: Path) -> None:
    certificate, key = make_certificate(tmp_path)
    async with serving(certificate, key) as url:
        plain = await refused(url.replace("https", "http"))
    gone = await refused(url.replace("https", "http"))
    async with unencrypted() as port:
        bare = await refused(f"https://127.0.0.1:{port}", certificate)
    assert str(plain) == "connection closed"
    assert str(gone) == "Connection refused"
    assert str(bare) == "TLS failed"
    assert "publish.url must begin with http://" in bare.advice


@asynccontextmanager
async def other_program(answer: bytes) -> AsyncIterator[str]:
    """Run a server that answers every request with these bytes; gives its URL."""

    async def run(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(answer)
        writer.close()

    async with await asyncio.start_server(run, "127.0.0.1", 0) as server:
        yield f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"


@pytest.mark.parametrize(
    ("answer", "said"),
    [(b"SSH-2.0-OpenSSH_9.2\r\n", "the answer is not HTTP"), (ANSWER[:-1], "the answer broke off")],
    ids=["no HTTP", "cut"],
)
async def test_an_answer_that_is_none_is_said_in_words(answer: bytes, said: str) -> None:
    async with other_program(answer) as url:
        assert str(await refused(url)) == said


async def test_an_error_of_another_program_is_an_answer_however_deep_its_json_is() -> None:
    body = b"[" * 100_000
    head = b"HTTP/1.1 500 Internal Server Error\r\nContent-Length: %d\r\n\r\n" % len(body)
    async with other_program(head + body) as url, ServiceClient(url, "token") as client:
        answer = await client.post_samples("bench", None)
    assert (answer.verdict, answer.explanation) == (Verdict.LATER, "status 500")


@pytest.mark.parametrize(
    ("content", "error", "said"),
    [
        (None, FailedError, "cannot read .*No such file"),  # it may come later
        (b"", InputError, "no PEM certificate"),
        (b"no PEM", InputError, "no PEM certificate"),
    ],
    ids=["missing", "empty", "something else"],
)
def test_an_invalid_certificate_is_refused_in_one_line(
    tmp_path: Path, content: bytes | None, error: type[Exception], said: str
) -> None:
    path = configs.write(tmp_path, configs.surface(source=configs.serial("/dev/null")))
    path.write_text(path.read_text().replace("[publish]", '[publish]\ncertificate_file = "service.pem"'))
    if content is not None:
        (tmp_path / "service.pem").write_bytes(content)

    with pytest.raises(error, match=rf"^publish\.certificate_file: .*{said}") as caught:
        load_config(path).read_trust()
    assert "\n" not in str(caught.value)


def test_a_certificate_is_found_beside_the_configuration(tmp_path: Path) -> None:
    make_certificate(tmp_path)
    path = configs.write(tmp_path, configs.surface(source=configs.serial("/dev/null")))
    assert load_config(path).read_trust() is None
    path.write_text(path.read_text().replace("[publish]", '[publish]\ncertificate_file = "certificate.pem"'))

    trusted = load_config(path).read_trust()
    assert trusted is not None
    assert len(trusted.get_ca_certs()) == 1
