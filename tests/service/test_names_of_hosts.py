"""Which names of a request are the service's own, as pure functions."""

import pytest
from fastapi.testclient import TestClient

from beamtouch_service.access import Access
from beamtouch_service.api.app import create_app
from beamtouch_service.own_names import OwnNames
from beamtouch_service.problems import Kind, ProblemError
from service.bench import Bench

NAMES = OwnNames(["Plant.example.", "press"])


def is_own(host: bytes) -> bool:
    try:
        NAMES.require([(b"accept", b"elsewhere.example"), (b"host", host)])
    except ProblemError as error:
        return error.problem.kind is not Kind.OTHER_NAME
    return True


@pytest.mark.parametrize(
    "host",
    [
        *(b"", b"localhost", b"localhost:8420", b"a.localhost", b"press", b"PRESS.:8420", b"press-hall"),
        *(b"plant.example", b"PLANT.example.:80", b"127.0.0.1", b"127.0.0.1:8420", b"10.0.0.7"),
        *(b"[::1]:8420", b"[fe80::1%eth0]:8420"),
    ],
)
def test_addresses_names_without_a_dot_and_those_of_the_configuration_are_its_own(host: bytes) -> None:
    assert is_own(host)


@pytest.mark.parametrize(
    "host",
    [
        *(b"elsewhere.example", b"plant.example.elsewhere.example", b"a.plant.example", b"localhost.example"),
        *(b"127.0.0.1.elsewhere.example", b"notlocalhost.", b"x.notlocalhost", b"\xff", b"[", b":8420", b"."),
    ],
)
def test_every_other_name_is_foreign(host: bytes) -> None:
    # A name without a dot is nobody's outside, whatever it ends with.
    assert is_own(host) is (host == b"notlocalhost.")


def test_a_request_without_a_name_passes() -> None:
    NAMES.require([(b"accept", b"elsewhere.example")])


def test_a_refusal_repeats_the_begin_of_the_name_and_says_what_to_do() -> None:
    with pytest.raises(ProblemError) as caught:
        NAMES.require([(b"host", b"\xff" + b"a.b" * 50)])
    shown = "\ufffd" + ("a.b" * 50)[:99]
    assert caught.value.problem.detail == (
        f"This service does not go by the name {shown!r}. Ask for its address or for localhost; if the name is right, "
        "add it to server.names. With a read token, any name will do."
    )


@pytest.mark.parametrize(("host", "status"), [("localhost", 200), ("plant.example", 200), ("elsewhere.example", 421)])
def test_a_request_for_a_foreign_name_is_refused_before_its_route(host: str, status: int) -> None:
    app, loop = create_app([], Access.of(), names=NAMES), Bench.event_loop
    assert loop is not None
    client = TestClient(app)
    client.portal = loop
    answer = client.get("/health/live", headers={"Host": host})
    loop.call(app.context.recorder.close)
    assert answer.status_code == status
    assert answer.headers["cache-control"] == "no-store"
