"""Accounts, rights and TLS at a real broker, and settings that cannot work."""

import signal
import socket
import subprocess
from pathlib import Path

import pytest

from service.event_story import RESTING, TOUCHING
from service.process.mqtt_line import (
    CONTACT,
    EVENT,
    Line,
    events,
    metric,
    now_batch,
    wait_connected,
    wait_for,
)
from support.network.certificates import make_certificate
from support.network.plain_http import TIMEOUT_S
from support.running.debian_parts import require

PASSWORD = "correct horse battery"  # noqa: S105  # of these tests only


def add_account(line: Line) -> None:
    """Let only the user `press` in, with its password."""
    accounts = line.folder / "accounts"
    program = require("mosquitto_passwd", "mosquitto")
    subprocess.run([program, "-c", "-b", str(accounts), "press", PASSWORD], check=True)
    line.broker.configure(f"password_file {accounts}", anonymous=False)


def restart(line: Line) -> None:
    line.broker.kill()
    line.broker.start()


def test_a_wrong_password_is_one_line_and_the_service_goes_on(line: Line) -> None:
    add_account(line)
    restart(line)
    password = line.folder / "password"
    password.write_text("wrong\n")
    settings = ('username = "press"', 'password_file = "password"')
    service = line.start(*settings)
    wait_for(lambda: line.broker.log.count("not authorised") >= 2)
    service.post(now_batch(TOUCHING, sequence=1))
    assert service.get("/contact").json()["state"] == "contact"
    assert metric(service, "connected") == 0
    _, errors = service.stop(signal.SIGTERM)
    (said,) = [one for one in errors.splitlines() if "MQTT broker 127.0.0.1" in one]
    assert "check mqtt.username and mqtt.password_file" in said
    assert "wrong" not in errors

    password.write_text(PASSWORD + "\n")
    service = line.start(*settings)
    wait_connected(service)
    _, errors = service.stop(signal.SIGTERM)
    assert PASSWORD not in errors


@pytest.mark.parametrize(
    ("answer", "advice"),
    [
        (b"\x20\x02\x00\x01", "it does not speak MQTT 5; use a broker that does"),  # as MQTT 3.1.1 refuses
        (b"\x20\x03\x00\x9d\x00", "it says that the broker has moved; correct mqtt.host"),
        (b"\x20\x00", "are mqtt.host and mqtt.port those of a broker that speaks it?"),
    ],
)
def test_what_is_no_broker_for_the_service_is_a_line_that_says_what_to_do(
    line: Line, answer: bytes, advice: str
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        line.broker.port = listener.getsockname()[1]
        service = line.start()
        listener.settimeout(TIMEOUT_S)
        with listener.accept()[0] as client:
            client.recv(1)  # not before paho has sent its question
            client.sendall(answer)
            wait_for(lambda: "mqtt" in service.get("/health/ready").json().get("missing", {}))
        _, errors = service.stop(signal.SIGTERM)
    (said,) = [one for one in errors.splitlines() if "MQTT broker" in one]
    assert advice in said


@pytest.mark.promise("docs/how-to/mqtt.md", "and one for each new reason of a broker that refuses.")
def test_events_that_the_broker_refuses_wait(line: Line) -> None:
    rights = line.folder / "rights"
    rights.write_text("topic read #\ntopic write beamtouch/status\ntopic write beamtouch/+/contact\n")
    line.broker.configure(f"acl_file {rights}")
    restart(line)
    subscriber = line.broker.subscribe("-t", "beamtouch/#")
    service = line.start()
    wait_connected(service)
    service.post(now_batch(RESTING, TOUCHING, RESTING, sequence=1))
    wait_for(lambda: metric(service, "events_pending") == 1)
    wait_for(lambda: any(one.get("state") == "clear" for one in subscriber.of(CONTACT)))
    assert subscriber.of(EVENT) == []
    # This broker ends the connection after a refusal. The next one lasts.
    wait_for(lambda: line.broker.log.count("New client connected from") >= 3)
    count = len(subscriber.of(CONTACT))
    wait_for(lambda: len(subscriber.of(CONTACT)) > count + 2)
    wait_for(lambda: metric(service, "events_pending") == 1)
    _, errors = service.stop(signal.SIGTERM)
    assert errors.count("refuses events") == 1
    assert "allow this user to write to beamtouch/+/event" in errors

    rights.write_text("topic readwrite #\n")
    restart(line)
    subscriber = line.broker.subscribe("-t", "beamtouch/#")
    service = line.start()
    wait_for(lambda: subscriber.of(EVENT) == events(service))


def test_tls_with_a_client_certificate(line: Line, tmp_path: Path) -> None:
    certificate, key = make_certificate(tmp_path)
    tls = (f"cafile {certificate}", f"certfile {certificate}", f"keyfile {key}", "require_certificate true")
    line.broker.configure(*tls)
    restart(line)
    own = (f'certificate_file = "{certificate}"', f'key_file = "{key}"')
    service = line.start("tls = true", f'ca_file = "{certificate}"', *own)
    wait_connected(service)
    service.post(now_batch(RESTING, TOUCHING, RESTING, sequence=1))
    wait_for(lambda: metric(service, 'messages_total{kind="event"}') == 1)
    service.stop(signal.SIGTERM)

    # The system trusts no such issuer.
    service = line.start("tls = true", *own)
    wait_for(lambda: "certificate verify failed" in service.get("/health/ready").json()["missing"].get("mqtt", ""))
    _, errors = service.stop(signal.SIGTERM)
    (said,) = [one for one in errors.splitlines() if "MQTT broker 127.0.0.1" in one]
    assert "certificate verify failed: self-signed certificate; check mqtt.ca_file" in said


def test_a_certificate_that_is_not_valid_at_this_time_leads_to_the_clock(line: Line, tmp_path: Path) -> None:
    certificate, key = make_certificate(tmp_path, is_expired=True)
    line.broker.configure(f"certfile {certificate}", f"keyfile {key}")
    restart(line)
    service = line.start("tls = true", f'ca_file = "{certificate}"')
    words = "certificate has expired; renew it, or check the clock of this machine"
    wait_for(lambda: words in service.get("/health/ready").json()["missing"].get("mqtt", ""))


def test_a_broker_that_freezes_in_the_handshake_does_not_hold_up_a_stop(line: Line, tmp_path: Path) -> None:
    certificate, key = make_certificate(tmp_path)
    line.broker.configure(f"certfile {certificate}", f"keyfile {key}")
    restart(line)
    line.broker.signal(signal.SIGSTOP)
    service = line.start("tls = true", f'ca_file = "{certificate}"')
    assert service.get("/health/live").status_code == 200
    code, errors = service.stop(signal.SIGTERM)
    assert (code, "ERROR" in errors) == (0, False)
