"""The bounds of what a request may ask for or send: each is taken, and what is next to it refused."""

import asyncio
import gzip

import pytest
from starlette.requests import Request
from starlette.types import Message

from beamtouch_service.access import Access, Role
from beamtouch_service.api import samples
from beamtouch_service.api.context import Streams
from beamtouch_service.api.errors import pointer
from beamtouch_service.api.samples import MAX_BODY_BYTES, _peer, decompress, read_body
from beamtouch_service.problems import Kind, ProblemError
from beamtouch_service.surfaces.pace import Pace
from service.bench import READ_TOKEN, TOKEN, Bench, batch_of, parsed, surface_with
from service.event_story import TOUCHING


@pytest.mark.parametrize(
    ("path", "is_taken"),
    [
        *[("/events?limit=1", True), ("/events?limit=1000", True), ("/events?limit=0", False)],
        *[("/events?limit=1001", False), ("/events?path=true&limit=50", True), ("/events?path=true&limit=51", False)],
        *[(f"/events?after={'9' * 17}.{'9' * 18}", True), (f"/events?after={'9' * 18}.1", False)],
        *[(f"/events?after=1.{'9' * 19}", False), ("/events?after=.1", False), ("/events?after=1.", False)],
        *[("/surfaces/press-7/calibration-data?limit=1", True), ("/surfaces/press-7/calibration-data?limit=0", False)],
        ("/surfaces/press-7/calibration-data?limit=5000", True),
        ("/surfaces/press-7/calibration-data?limit=5001", False),
    ],
)
def test_a_query_has_bounds(bench: Bench, path: str, is_taken: bool) -> None:
    answer = bench.get(path)
    assert (answer.status_code, "invalid-request" in answer.text) == ((200, False) if is_taken else (422, True))


@pytest.mark.parametrize(
    ("path", "is_taken"),
    [
        *[("/events/1", True), (f"/events/{2**63 - 1}", True), ("/events/0", False), (f"/events/{2**63}", False)],
        *[("/surfaces/press-7/commissionings/1", True), ("/surfaces/press-7/commissionings/0", False)],
        (f"/surfaces/press-7/commissionings/{2**63 - 1}", True),
        (f"/surfaces/press-7/commissionings/{2**63}", False),
    ],
)
def test_a_number_of_the_record_has_bounds(bench: Bench, path: str, is_taken: bool) -> None:
    assert bench.get(path).status_code == (404 if is_taken else 422)


@pytest.mark.parametrize(("interval_ms", "is_taken"), [(20, True), (5000, True), (19, False), (5001, False)])
def test_the_time_between_two_events_of_a_stream_has_bounds(bench: Bench, interval_ms: int, is_taken: bool) -> None:
    bench.app.context.streams.stop()  # a stream that is taken would not end
    for path in ("/stream", "/surfaces/press-7/stream"):
        kind = bench.problem(f"{path}?interval_ms={interval_ms}")
        assert kind == ("stopping" if is_taken else "invalid-request")


@pytest.mark.parametrize(
    ("query", "place"),
    [
        *[("run=c&step=0", None), ("run=c&step=1000", None), (f"run={'c' * 64}&step=1", None)],
        *[("run=c&step=-1", "step"), ("run=c&step=1001", "step"), (f"run={'c' * 65}&step=1", "run")],
    ],
)
def test_a_step_of_a_commissioning_has_bounds(bench: Bench, query: str, place: str | None) -> None:
    answer = bench.post(b"", f"/surfaces/press-7/commissioning/skip?{query}")
    if place is None:
        assert answer.json()["type"] == "urn:beamtouch:problem:no-commissioning"
    else:
        assert answer.json()["errors"][0]["pointer"] == f"#/query/{place}"


@pytest.mark.parametrize(("by", "is_taken"), [("A", True), ("A" * 80, True), ("", False), ("A" * 81, False)])
def test_a_name_of_a_person_has_bounds(bench: Bench, by: str, is_taken: bool) -> None:
    answer = bench.post(b"", f"/surfaces/press-7/commissioning/confirm?run=c&by={by}")
    assert answer.status_code == (404 if is_taken else 422)


LAST = 2**53 - 1
"""The largest whole number that a double holds, as all below it."""
SQUARE = 1e8
"""The square of the largest deviation."""
ONE: dict[str, object] = {"readings": 4, "deflection_mm": [0.5], "quality": ["good"]}
"""Members of a sample of one channel."""


@pytest.mark.parametrize(
    ("taken", "refused"),
    [
        *[({"sequence": value}, {"sequence": wrong}) for value, wrong in ((1, 0), (LAST, LAST + 1))],
        *[({"acquired_unix_us": value}, {"acquired_unix_us": wrong}) for value, wrong in ((0, -1), (LAST, LAST + 1))],
        *[({"readings": value}, {"readings": wrong}) for value, wrong in ((1, 0), (1_000_000, 1_000_001))],
        *[({"zero_mm": [0.0, 1e4]}, {"zero_mm": wrong}) for wrong in ([0.1], [0.1] * 3, [0.1, 10_001.0], [-0.1, 0.1])],
        *[(ONE | {"covariance_mm2": [SQUARE]}, ONE | {"covariance_mm2": [wrong]}) for wrong in (-1e-9, 1.0001e8)],
        (
            {"deflection_mm": [0.5, None, 0.5], "quality": ["good", "stuck", "good"]},
            {"deflection_mm": [0.5, None, 0.5]},
        ),
        ({"quality": ["good"] * 3}, {"quality": ["good"] * 2}),
    ],
)
def test_a_sample_has_bounds(bench: Bench, taken: dict[str, object], refused: dict[str, object]) -> None:
    for members, status in ((refused, 422), (taken, 200)):
        body = batch_of()
        body["samples"][0] |= members
        if members.get("deflection_mm") == [0.5]:
            body["channels"] = ["s1"]
            bench = Bench(surface_with(None))
        assert bench.post(body).status_code == status, members


@pytest.mark.parametrize(
    ("taken", "refused"),
    [
        *[({"newest_age_ms": value}, {"newest_age_ms": wrong}) for value, wrong in ((0.0, -0.1), (1e12, 1.0001e12))],
        *[({"sent_us": value}, {"sent_us": wrong}) for value, wrong in ((0, -1), (LAST, LAST + 1))],
        *[({"oldest": value}, {"oldest": wrong}) for value, wrong in ((1, 0), (LAST, LAST + 1))],
        *[({"noise_mm": [value] * 3}, {"noise_mm": [wrong] * 3}) for value, wrong in ((1e-9, 0.0), (1e4, 10_001.0))],
        ({"noise_mm": [0.1] * 3}, {"noise_mm": [0.1] * 2}),
        ({"earlier": ["boot-0000"] * 64}, {"earlier": ["boot-0000"] * 65}),
        ({"notes": ["rate", "zeros"]}, {"notes": ["rate", "zeros", "rate"]}),
        ({"notes": ["rate"]}, {"notes": ["overload"]}),
        ({"boot_id": "b" * 8}, {"boot_id": "b" * 7}),
        ({"boot_id": "b" * 64}, {"boot_id": "b" * 65}),
        ({"characteristic": "c" * 64}, {"characteristic": "c" * 65}),
        ({"channels": ["s1", "s2", "s3"]}, {"channels": ["s1", "s2", "s2"]}),
        ({"backlog": True, "newest_age_ms": None}, {"backlog": True, "newest_age_ms": 0.0}),
        ({"newest_age_ms": 0.0}, {"newest_age_ms": None}),
        ({"samples": [], "newest_age_ms": None}, {"samples": None}),
    ],
)
def test_a_batch_has_bounds(bench: Bench, taken: dict[str, object], refused: dict[str, object]) -> None:
    for members, status in ((refused, 422), (taken, 200)):
        assert bench.post(batch_of() | members).status_code == status, members


@pytest.mark.parametrize(("channels", "status"), [(64, 200), (65, 422)])
def test_a_batch_has_at_most_64_channels(channels: int, status: int) -> None:
    assert Bench(surface_with(None)).post(batch_of([0.5] * channels)).status_code == status


def test_samples_have_increasing_numbers(bench: Bench) -> None:
    for numbers, status in (((2, 2), 422), ((2, 1), 422), ((1, 2), 200)):
        body = batch_of([0.5, 0.25, 0.125], [0.5, 0.25, 0.125])
        for sample, number in zip(body["samples"], numbers, strict=True):
            sample["sequence"] = number
        assert bench.post(body).status_code == status, numbers


def test_a_body_may_be_as_long_as_the_limit() -> None:
    whole = bytes(MAX_BODY_BYTES)
    assert decompress(gzip.compress(whole), "gzip") == whole
    with pytest.raises(ProblemError) as caught:
        decompress(gzip.compress(whole + b" "), "gzip")
    assert caught.value.problem.members == {"limit_bytes": 1_048_576}
    assert caught.value.headers == {"Connection": "close"}


def test_a_body_of_a_batch_may_be_as_long_as_the_limit(bench: Bench) -> None:
    for more, status in ((0, 400), (1, 413)):
        assert bench.post(b" " * (MAX_BODY_BYTES + more)).status_code == status


def test_a_pointer_is_cut_and_escaped() -> None:
    assert pointer(("samples", 0, "a/b~c")) == "#/samples/0/a~1b~0c"
    assert (len(pointer(("x" * 198,))), len(pointer(("x" * 199,)))) == (200, 200)
    assert pointer(()) == "#"


def peer_of(forwarded: str | None, client: tuple[str, int] | None = ("10.0.0.1", 7)) -> str:
    headers = [] if forwarded is None else [(b"x-forwarded-for", forwarded.encode())]
    return _peer(Request({"type": "http", "headers": headers, "client": client}))


def test_a_batch_comes_from_an_address_or_through_a_proxy_from_the_last_one_that_it_names() -> None:
    assert (peer_of(None), peer_of(None, client=None), peer_of("")) == ("10.0.0.1:7", "unknown", "10.0.0.1:7")
    assert peer_of("1.2.3.4, 5.6.7.8 ") == "5.6.7.8 (through 10.0.0.1:7)"
    assert peer_of("x" * 65) == f"{'x' * 64} (through 10.0.0.1:7)"


def test_so_many_streams_may_be_open_and_none_once_the_service_stops() -> None:
    assert Streams().max_open == 32
    streams = Streams(max_open=2)
    streams.admit()
    streams.admit()
    assert streams.open == 2
    with pytest.raises(ProblemError) as caught:
        streams.admit()
    assert (caught.value.problem.kind, caught.value.headers) == (Kind.TOO_MANY_CLIENTS, {"Retry-After": "5"})
    assert caught.value.problem.detail.startswith("2 streams are open, which is the limit.")
    streams.open = 1
    streams.stop()
    with pytest.raises(ProblemError) as caught:
        streams.admit()
    assert (caught.value.problem.kind, streams.open) == (Kind.STOPPING, 1)


def test_a_stream_says_again_within_a_second_what_has_not_changed(bench: Bench) -> None:
    (surface,) = bench.app.context.registry
    pace = Pace([surface], 0.05, tells_status_at_once=False)
    said = list[bool]()
    for now_s in (1000.0, 1000.899, 1000.901, 1001.8, 1001.802):
        said.append(pace.due(now_s) == [surface])
        pace.note_told(pace.due(now_s), now_s)
    assert said == [True, False, True, False, True]


def test_nothing_is_said_more_often_than_a_client_of_a_stream_asks_for(bench: Bench) -> None:
    """Not even another state: a client on a thin line asks for five seconds."""
    (surface,) = bench.app.context.registry
    pace = Pace([surface], 5.0, tells_status_at_once=False)
    pace.note_told([surface], 1000.0)
    surface.receive(parsed(TOUCHING), 1000.1)
    assert not pace.has_news(surface, 1000.1)
    assert (pace.due(1000.1), pace.due(1004.9)) == ([], [])
    assert 1000.1 + pace.wait_s(1000.1) == pytest.approx(1005.0)
    assert pace.due(1005.0) == [surface]


STRANGER = "This is not a token of the service. Check its token files."
NO_SCHEME = "Send the header `Authorization: Bearer TOKEN` with a token of the service."


@pytest.mark.parametrize(
    ("role", "given", "detail"),
    [
        (Role.WRITE, f"Bearer {TOKEN}", None),
        (Role.WRITE, f"BEARER  {TOKEN} ", None),
        (Role.READ, f"bearer {TOKEN}", None),
        (Role.READ, f"Bearer {READ_TOKEN}", None),
        (Role.OPEN, "", None),
        (Role.WRITE, f"Bearer {READ_TOKEN}", "This is the read token. Use the write token (--write-token-file)."),
        (Role.READ, f"Bearer {TOKEN[:-1]}", STRANGER),
        (Role.READ, f"Basic {TOKEN}", NO_SCHEME),
        (Role.WRITE, TOKEN, NO_SCHEME),
        (Role.READ, None, NO_SCHEME),
    ],
)
def test_a_token_opens_what_its_role_may_and_what_is_wrong_is_said(
    role: Role, given: str | None, detail: str | None
) -> None:
    access = Access.of(TOKEN, READ_TOKEN)
    authorization = None if given is None else given.encode()
    if detail is None:
        access.require(role, authorization)
        return
    with pytest.raises(ProblemError) as caught:
        access.require(role, authorization)
    is_forbidden = detail.startswith("This is the")
    assert (caught.value.problem.kind, caught.value.problem.detail) == (
        Kind.FORBIDDEN if is_forbidden else Kind.UNAUTHORIZED,
        detail,
    )
    assert caught.value.headers == ({} if is_forbidden else {"WWW-Authenticate": 'Bearer realm="beamtouch"'})


def test_a_batch_that_has_arrived_moves_the_histograms_of_its_surface(bench: Bench) -> None:
    bench.post(batch_of(age_ms=3.0))
    metrics = bench.metrics()
    for bound, count in (("0.002", 0), ("0.005", 1)):
        series = f'beamtouch_sample_arrival_age_seconds_bucket{{le="{bound}",surface="press-7"}} {count}.0'
        assert series in metrics
    for name in ("batch", "inference"):
        assert f'beamtouch_{name}_seconds_count{{surface="press-7"}} 1.0' in metrics


class Sender:
    """Sends parts of a body, and then nothing more."""

    def __init__(self, *parts: bytes, is_whole: bool = False, stated: int | None = None) -> None:
        self._parts, self._is_whole = list(parts), is_whole
        headers = [] if stated is None else [(b"content-length", str(stated).encode())]
        self.request = Request({"type": "http", "headers": headers}, self._receive)

    async def _receive(self) -> Message:
        if self._parts:
            part = self._parts.pop(0)
            return {"type": "http.request", "body": part, "more_body": bool(self._parts) or not self._is_whole}
        await asyncio.Event().wait()
        raise AssertionError


@pytest.mark.parametrize(
    ("sender", "kind"),
    [
        (Sender(b"x" * MAX_BODY_BYTES, b"x"), Kind.TOO_LARGE),
        (Sender(b"x", stated=MAX_BODY_BYTES + 1), Kind.TOO_LARGE),
        (Sender(b"x" * MAX_BODY_BYTES), Kind.TOO_SLOW),
        (Sender(b"x", stated=MAX_BODY_BYTES), Kind.TOO_SLOW),
    ],
    ids=["chunked", "stated", "chunked but not too large", "stated but not too large"],
)
@pytest.mark.anyio
async def test_a_body_that_is_too_large_and_does_not_end_is_refused_for_its_size(
    monkeypatch: pytest.MonkeyPatch, sender: Sender, kind: Kind
) -> None:
    monkeypatch.setattr(samples, "LINGER_S", 0.05)
    monkeypatch.setattr(samples, "MAX_BODY_S", 0.05 if kind is Kind.TOO_SLOW else 60.0)
    async with asyncio.timeout(30):
        with pytest.raises(ProblemError) as refusal:
            await read_body(sender.request)
    assert refusal.value.problem.kind is kind


@pytest.mark.anyio
async def test_a_body_of_several_parts_is_read_whole() -> None:
    parts = b"x" * (MAX_BODY_BYTES - 3), b"abc"
    assert await read_body(Sender(*parts, is_whole=True).request) == b"".join(parts)
