"""Two daemons that send samples of one surface to a real service: its log has both addresses."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

import httpx2

from plain_http import TIMEOUT_S
from service.conftest import batch_of
from waiting import wait_until

if TYPE_CHECKING:
    from pathlib import Path

    from service.conftest import BuildModel
    from service.process.conftest import StartService


def test_the_log_names_both_addresses_once(
    start_service: StartService, build_model: BuildModel, token_file: Path
) -> None:
    service = start_service("--model", build_model(), "--write-token-file", token_file, "--stale-ms", "60000")
    headers = {"Authorization": f"Bearer {service.token}"}
    forwarded = [{}, {"X-Forwarded-For": "203.0.113.7, 10.0.0.6"}]
    (name,) = [one["name"] for one in service.get("/surfaces").json()["surfaces"]]
    path, number = f"/surfaces/{name}/samples", 0
    with (
        httpx2.Client(base_url=service.url, headers=headers, trust_env=False, timeout=TIMEOUT_S) as one,
        httpx2.Client(base_url=service.url, headers=headers, trust_env=False, timeout=TIMEOUT_S) as other,
    ):

        def both_send() -> bool:
            nonlocal number
            number += 1
            for boot_id, client, more in zip(("daemon-one", "daemon-two"), (one, other), forwarded, strict=True):
                answer = client.post(path, json=batch_of(sequence=number, boot_id=boot_id), headers=more)
                assert answer.status_code == 200
            words: list[str] = one.get("/contact").json()["notes"]
            return "senders" in words

        wait_until(both_send)
        for _ in range(5):
            both_send()
    code, errors = service.stop(signal.SIGTERM)
    assert code == 0
    (line,) = [line for line in errors.splitlines() if "two daemons" in line]
    assert "WARNING" in line
    said = line.partition(" from ")[2]
    assert "127.0.0.1:" in said.partition(" and from ")[0] + said.partition(" and from ")[2]
    assert "10.0.0.6 (through 127.0.0.1:" in said
    assert "203.0.113.7" not in said
