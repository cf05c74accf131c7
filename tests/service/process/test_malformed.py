"""Malformed batches by the thousand: a 4xx each, the memory stays, and contacts are answered meanwhile.

BEAMTOUCH_MALFORMED=100000 sends as many; 100 000 take a minute or two.
"""

from __future__ import annotations

import http.client
import os
import random
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import pytest

from processes import resident_mb
from service.conftest import TOKEN, batch_of
from service.malformed import malformed

if TYPE_CHECKING:
    from service.process.conftest import Service

MALFORMED = int(os.environ.get("BEAMTOUCH_MALFORMED", "4000"))
CONNECTIONS = 4
MAX_GROWTH_MB = 30.0


def send(port: int, seed: int, number: int) -> Counter[int]:
    """Send so many on one connection; return how many got each status."""
    chance, statuses = random.Random(seed), Counter[int]()  # noqa: S311 - noise, not secrets
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/json"}
    for _ in range(number):
        connection.request("POST", "/surfaces/press-7/samples", malformed(chance), headers)
        answer = connection.getresponse()
        answer.read()
        statuses[answer.status] += 1
    connection.close()
    return statuses


@pytest.mark.soak
def test_malformed_batches_change_nothing_but_the_counts(fresh: Service) -> None:
    port, asked = int(fresh.url.rpartition(":")[2]), 0
    send(port, 99, 500)  # what is loaded once is loaded now
    before_mb = resident_mb(fresh.process.pid)
    with ThreadPoolExecutor(CONNECTIONS) as pool:
        each = [pool.submit(send, port, seed, MALFORMED // CONNECTIONS) for seed in range(CONNECTIONS)]
        while not all(one.done() for one in each):
            asked += 1
            body = batch_of(sequence=10_000 + asked, boot_id="boot-0002")
            assert fresh.post(body).json()["accepted"] == 1
            assert fresh.get("/contact").json()["sequence"] == 10_000 + asked
    statuses = sum((one.result() for one in each), Counter[int]())
    assert (statuses.total(), set(statuses) <= {400, 413, 422}) == (MALFORMED, True), statuses
    assert resident_mb(fresh.process.pid) - before_mb < MAX_GROWTH_MB
    print(statuses, asked, before_mb, resident_mb(fresh.process.pid))
