"""The flow of the guide for Node-RED: it asks a route of the service, and its function sorts the answers."""

import json
import subprocess
from typing import Any
from urllib.parse import urlsplit

from service.bench import Bench
from support.pages.pasted import blocks_of
from support.programs.toolchain import need

(FLOW,) = [block.text for block in blocks_of("docs/how-to/node-red.md") if block.word == "json"]
NODES = {node["id"]: node for node in json.loads(FLOW)}
RUN = """
const [code, messages] = JSON.parse(require('fs').readFileSync(0));
console.log(JSON.stringify(messages.map(msg => new Function('msg', code)(msg))));
"""


def sorted_by_the_flow(*messages: dict[str, Any]) -> list[list[dict[str, Any] | None]]:
    """Return what the function of the flow sends to its two ports for each message of the http request node."""
    need("node")
    given = json.dumps([NODES["beamtouch-decide"]["func"], messages])
    done = subprocess.run(["node", "-e", RUN], input=given, capture_output=True, text=True, timeout=60, check=True)
    sent: list[list[dict[str, Any] | None]] = json.loads(done.stdout)
    return sent


def test_the_flow_asks_a_route_of_the_service_and_sorts_its_answers(bench: Bench) -> None:
    asked = NODES["beamtouch-ask"]
    path = urlsplit(asked["url"]).path
    messages: list[dict[str, Any]] = []
    for rows in ([], [[0.0, 0.0, 0.0]] * 10, [[0.5, 0.25, 0.125]] * 10):
        if rows:
            bench.send(*rows, sequence=1 + 10 * len(messages))
        answer = bench.client.request(asked["method"], path)
        messages.append({"statusCode": answer.status_code, "payload": answer.json()})
    away = {"statusCode": "ECONNREFUSED", "payload": "RequestError: connect ECONNREFUSED 127.0.0.1:8420"}

    states = [message["payload"].get("state") for message in messages]
    assert states == [None, "clear", "contact"]
    contact = messages[-1]["payload"]
    assert sorted_by_the_flow(*messages, away) == [
        [None, {"topic": "press-7", "payload": "urn:beamtouch:problem:no-samples"}],
        [None, {"topic": "press-7", "payload": "clear"}],
        [{"topic": "press-7", "payload": {name: contact[name] for name in ("position_mm", "force_n", "notes")}}, None],
        [None, {"topic": "", "payload": "no answer"}],
    ]
