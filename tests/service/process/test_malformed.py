"""Malformed batches by the thousand: a 4xx each, the memory stays, and contacts are answered meanwhile.

BEAMTOUCH_MALFORMED=100000 sends as many; 100 000 take a minute or two.
"""

import http.client
import json
import math
import os
import random
import threading
import time
from pathlib import Path
from typing import Any

from processes import resident_mb
from service.conftest import BuildModel

from .conftest import StartService

MALFORMED = int(os.environ.get("BEAMTOUCH_MALFORMED", "4000"))
CONNECTIONS = 4
MAX_GROWTH_MB = 30.0

STRANGE: list[Any] = [
    *(None, True, "", "x" * 1000, -1, 2**53, 2**64, 10**400, 1e308, -0.5, math.nan, math.inf, -math.inf),
    *([], {}, [[]], {"a": {}}, [None] * 100, "\ud800", "\0"),
]


def good(sequence: int) -> dict[str, Any]:
    sample = {
        "sequence": sequence,
        "acquired_unix_us": 1_700_000_000_000_000 + sequence,
        "deflection_mm": [0.5, 0.25, 0.125],
        "quality": ["good", "good", "good"],
    }
    return {"boot_id": "malformed-1", "channels": ["s1", "s2", "s3"], "newest_age_ms": 1.0, "samples": [sample]}


def malformed(chance: random.Random) -> bytes:
    """Return a body that no service may take."""
    body = good(1 + chance.randrange(1000))
    kind = chance.randrange(8)
    if kind == 0:
        del body[chance.choice(list(body))]
    elif kind == 1:
        body[chance.choice(["boot_id", "channels", "newest_age_ms", "samples"])] = chance.choice(STRANGE)
        body["samples"] = body["samples"] or [None]  # none at all is a question
    elif kind == 2:
        key = chance.choice(["sequence", "acquired_unix_us", "deflection_mm", "quality"])
        body["samples"][0][key] = chance.choice(STRANGE)
    elif kind == 3:
        body["channels"] = chance.choice([["s1"], ["a", "b", "c"], ["s1", "s1", "s2"], ["s1", "s2", "s3", "s4"]])
    elif kind == 4:
        body["samples"] *= 2  # the same number twice
    elif kind == 5:
        depth = chance.choice([10, 1000, 100_000])
        return b"[" * depth + b"]" * depth
    elif kind == 6:
        text = json.dumps(body).encode()
        return text[: chance.randrange(len(text))]
    else:
        return chance.randbytes(chance.randrange(2000))
    return json.dumps(body).encode()


def send(port: int, token: str, seed: int, number: int, statuses: dict[int, int]) -> None:
    """Send so many on one connection."""
    chance = random.Random(seed)  # noqa: S311 - noise, not secrets
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    for _ in range(number):
        connection.request("POST", "/surfaces/press-7/samples", malformed(chance), headers)
        answer = connection.getresponse()
        answer.read()
        statuses[answer.status] = statuses.get(answer.status, 0) + 1
    connection.close()


def test_malformed_batches_change_nothing_but_the_counts(
    start_service: StartService, build_model: BuildModel, token_file: Path, tmp_path: Path
) -> None:
    config = tmp_path / "service.toml"
    config.write_text(
        f'[server]\nwrite_token_file = "{token_file.resolve()}"\n'
        f'[surfaces.press-7]\nmodel = "{build_model()}"\nstale_ms = 60000\n'
    )
    service = start_service("--config", config)
    port = int(service.url.rpartition(":")[2])
    assert service.post(good(1)).is_success
    found: list[dict[int, int]] = [{} for _ in range(CONNECTIONS)]
    send(port, service.token, 99, 500, {})  # what is loaded once is loaded now
    before_mb = resident_mb(service.process.pid)
    threads = [
        threading.Thread(target=send, args=(port, service.token, seed, MALFORMED // CONNECTIONS, found[seed]))
        for seed in range(CONNECTIONS)
    ]
    for thread in threads:
        thread.start()
    asked = 1
    while any(thread.is_alive() for thread in threads):
        asked += 1
        assert service.post(good(asked)).json()["accepted"] == 1
        contact = service.get("/contact").json()
        assert (contact["state"], contact["position_mm"], contact["sequence"]) == ("contact", 150.0, asked)
        time.sleep(0.02)
    for thread in threads:
        thread.join()
    statuses = {status: sum(one.get(status, 0) for one in found) for one in found for status in one}
    assert sum(statuses.values()) == MALFORMED
    assert set(statuses) <= {400, 413, 422}, statuses
    assert resident_mb(service.process.pid) - before_mb < MAX_GROWTH_MB
    assert asked > 5
    print(statuses, asked, before_mb, resident_mb(service.process.pid))
