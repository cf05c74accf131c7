"""A batch may come compressed: it is bounded as it unfolds, and what is not whole is refused in one line."""

import gzip
import json
import tracemalloc
import zlib

import httpx2
import pytest

from beamtouch_service.api.samples import MAX_BODY_BYTES
from service.bench import TOKEN, Bench, batch_of, kind

BATCH = json.dumps(batch_of([0.5, 0.25, 0.125])).encode()
ZIPPED = gzip.compress(BATCH)


def post(bench: Bench, body: bytes, encoding: str) -> httpx2.Response:
    headers = {"Authorization": f"Bearer {TOKEN}", "Content-Encoding": encoding}
    return bench.client.post("/surfaces/press-7/samples", content=body, headers=headers)


@pytest.mark.promise("docs/reference/samples.md", "The body is JSON, as it is or with `Content-Encoding: gzip`")
@pytest.mark.parametrize(
    ("body", "encoding"), [(ZIPPED, "gzip"), (ZIPPED, " GZIP"), (ZIPPED, "x-gzip"), (BATCH, "identity"), (BATCH, "")]
)
def test_a_batch_may_be_compressed(bench: Bench, body: bytes, encoding: str) -> None:
    assert post(bench, body, encoding).json()["accepted"] == 1
    assert bench.contact()["sequence"] == 1


@pytest.mark.parametrize(
    "body",
    [
        b"",
        BATCH,
        ZIPPED[:-1],
        ZIPPED[:40],
        ZIPPED[:-8] + bytes(8),  # another checksum
        ZIPPED + ZIPPED,
        ZIPPED + b" ",
        zlib.compress(BATCH),
    ],
    ids=["empty", "plain", "cut", "cut early", "damaged", "twice", "more", "deflate"],
)
def test_a_body_that_is_not_one_whole_stream_is_refused(bench: Bench, body: bytes) -> None:
    answer = post(bench, body, "gzip")
    assert (answer.status_code, kind(answer)) == (400, "malformed-encoding")
    assert "send it as it is, or without Content-Encoding" in answer.json()["detail"]
    assert bench.problem() == "no-samples"


@pytest.mark.parametrize("encoding", ["br", "deflate", "zstd", "gzip, gzip"])
def test_another_encoding_is_refused_and_the_right_one_is_named(bench: Bench, encoding: str) -> None:
    answer = post(bench, BATCH, encoding)
    assert (answer.status_code, kind(answer)) == (415, "unknown-encoding")
    assert answer.headers["accept-encoding"] == "gzip"


@pytest.mark.promise("docs/reference/http.md", "1 MiB, also decompressed")
def test_what_unfolds_beyond_the_limit_is_refused_before_it_is_there(bench: Bench) -> None:
    """Half a megabyte stands for a hundred."""
    bomb = gzip.compress(bytes(100 * MAX_BODY_BYTES), compresslevel=1)
    assert len(bomb) < MAX_BODY_BYTES
    assert post(bench, gzip.compress(bytes(MAX_BODY_BYTES)), "gzip").status_code == 400  # no JSON, but not too large
    tracemalloc.start()
    try:
        answer = post(bench, bomb, "gzip")
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert (answer.status_code, kind(answer)) == (413, "too-large")
    assert "also decompressed" in answer.json()["detail"]
    assert peak_bytes < 8 * MAX_BODY_BYTES
