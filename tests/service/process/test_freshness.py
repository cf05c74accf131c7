"""How old a contact is said to be, by a real process whose clients are slow."""

from __future__ import annotations

import json
import socket
import time
from typing import TYPE_CHECKING

from service.conftest import TOKEN

if TYPE_CHECKING:
    from pathlib import Path

    from service.conftest import BuildModel, MakeBatch
    from service.process.conftest import StartService

BODY_TAKES_S = 0.5


def test_the_time_that_a_body_takes_makes_its_samples_older(
    start_service: StartService, build_model: BuildModel, token_file: Path, make_batch: MakeBatch
) -> None:
    service = start_service("--model", build_model(), "--write-token-file", token_file, "--stale-ms", "60000")
    body = json.dumps(make_batch(age_ms=100.0)).encode()
    head = (
        f"POST /surfaces/press-7/samples HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {TOKEN}\r\n"
        f"Expect: 100-continue\r\nContent-Length: {len(body)}\r\n\r\n"
    )
    with socket.create_connection(("127.0.0.1", int(service.url.rpartition(":")[2])), timeout=60) as connection:
        connection.sendall(head.encode() + body[:-1])
        # It says so when it begins to read the body, so the head has been seen.
        assert connection.recv(65536).startswith(b"HTTP/1.1 100 ")
        time.sleep(BODY_TAKES_S)
        connection.sendall(body[-1:])
        assert connection.recv(65536).startswith(b"HTTP/1.1 200 ")

    assert service.get("/contact").json()["age_ms"] >= 100 + BODY_TAKES_S * 1e3
