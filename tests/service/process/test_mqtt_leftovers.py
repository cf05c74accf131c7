"""What a broker keeps of a service: what its configuration has, and nothing of others goes."""

import json
import re
import shlex
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest

from service.bench import PATIENT, BuildModel
from service.event_story import RESTING, TOUCHING
from service.process.broker import Subscriber
from service.process.conftest import Service
from service.process.cutting_relay import cutting_relay, publishes_to
from service.process.mqtt_line import CONTACT, STATUS, Line, events, metric, now_batch, wait_connected, wait_for
from support.running.debian_parts import require
from support.surfaces.small_model import PLATE_OUTPUTS

GUIDE = Path(__file__).parents[3] / "docs" / "how-to" / "mqtt.md"
IMPATIENT = "from beamtouch_service.outputs.mqtt import leftovers; leftovers.ANSWER_S = 0.1"
COMES_BACK = f"{PATIENT}; from beamtouch_service.outputs.mqtt import publisher; publisher.MAX_RETRY_S = 0.5"
"""Code by which a service that loses its broker again and again is back soon."""
DISCOVERY = "home_assistant_discovery = true"


def status(surface: str, prefix: str = "beamtouch") -> str:
    return f"{prefix}/{surface}/status"


def described(surface: str, prefix: str = "beamtouch") -> str:
    return f"homeassistant/device/{prefix}/{surface}/config"


def kept(subscriber: Subscriber) -> dict[str, str]:
    """Return what the broker keeps, by topic, as its subscriber has followed it from the start."""
    newest = {one.topic: one.text for one in subscriber.messages if one.topic.endswith(("/status", "/config"))}
    return {topic: text for topic, text in newest.items() if text}


def devices(subscriber: Subscriber) -> list[dict[str, Any]]:
    return [json.loads(text) for topic, text in kept(subscriber).items() if topic.endswith("/config")]


def change(line: Line, service: Service, *mqtt: str, **how: Any) -> Service:  # noqa: ANN401  # as `Line.start`
    """Stop a service, and start it with another configuration."""
    _, errors = service.stop(signal.SIGTERM)
    assert "ERROR" not in errors
    return line.start(*mqtt, **how)


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    (
        "A surface that you remove or rename is removed at the broker when the service starts with the new "
        "configuration, with its description for Home Assistant. Its events stay on record."
    ),
)
def test_a_surface_that_was_removed_or_renamed_is_gone_at_the_broker(line: Line) -> None:
    subscriber = line.broker.subscribe("-t", "#")
    service = line.start(DISCOVERY, surfaces=["press-7", "press-8"])
    both = {STATUS, *map(status, ("press-7", "press-8")), *map(described, ("press-7", "press-8"))}
    wait_for(lambda: kept(subscriber).keys() == both)
    service.post(now_batch(RESTING, TOUCHING, RESTING, sequence=1), surface="press-8")
    wait_for(lambda: len(subscriber.of("beamtouch/press-8/event")) == 1)
    service = change(line, service, DISCOVERY, surfaces=["press-7", "press-9"])
    renamed = {STATUS, *map(status, ("press-7", "press-9")), *map(described, ("press-7", "press-9"))}
    wait_for(lambda: kept(subscriber).keys() == renamed)
    # Its events stay on record.
    assert [one["surface"] for one in events(service, surface="press-8")] == ["press-8"]
    # The broker has nothing else for those who come now, and the one that stayed was never gone.
    later = line.broker.subscribe("-t", "#")
    wait_for(lambda: kept(later).keys() == renamed)
    assert "" not in subscriber.texts(status("press-7")) + subscriber.texts(described("press-7"))
    # Without discovery, no description.
    service = change(line, service, surfaces=["press-9"])
    wait_for(lambda: kept(subscriber).keys() == {STATUS, status("press-9")})
    _, errors = service.stop(signal.SIGTERM)
    gone = (status("press-7"), described("press-7"), described("press-9"))
    assert [topic in errors for topic in gone] == [True] * 3
    assert errors.count("which this configuration no longer has") == 3


def test_what_was_removed_while_the_broker_was_away_goes_when_it_is_back(line: Line) -> None:
    line.broker.configure("persistence true", f"persistence_location {line.folder}/", "autosave_interval 1")
    line.broker.kill()
    line.broker.start()
    subscriber = line.broker.subscribe("-t", "#")
    service = line.start(DISCOVERY, surfaces=["press-7", "press-8"])
    wait_for(lambda: len(kept(subscriber)) == 5)
    line.broker.signal(signal.SIGTERM)
    service = change(line, service, DISCOVERY)
    line.broker.kill()
    line.broker.start()
    wait_connected(service)
    later = line.broker.subscribe("-t", "#")
    wait_for(lambda: kept(later).keys() == {STATUS, status("press-7"), described("press-7")})


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    "A surface, a zone or the whole discovery that you remove from the configuration goes in Home Assistant too.",
)
def test_home_assistant_is_told_of_a_zone_that_went_and_then_reads_no_more_of_it(line: Line) -> None:
    def zones(*names: str) -> str:
        return "".join(f"\n[surfaces.press-7.zones.{name}]\nfrom_mm = 0\nto_mm = 100\n" for name in names)

    subscriber = line.broker.subscribe("-t", described("press-7"))
    service = line.start(DISCOVERY, sections=zones("feed", "Exit"))
    wait_for(lambda: len(subscriber.messages) == 1)
    before = subscriber.messages[0].content["components"]
    assert [before[name]["name"] for name in ("zone_feed", "zone_Exit")] == ["Zone feed", "Zone Exit"]
    service = change(line, service, DISCOVERY, sections=zones("Exit"))
    wait_for(lambda: len(subscriber.messages) == 4)
    removing, *newest = (one.content["components"] for one in subscriber.messages[1:])
    # A component with nothing but its platform is removed, and the next description omits it: so it is documented.
    assert removing == newest[0] | {"zone_feed": {"platform": "binary_sensor"}}
    assert newest == [{name: one for name, one in before.items() if name != "zone_feed"}] * 2
    # Nothing is left to remove.
    change(line, service, DISCOVERY, sections=zones("Exit"))
    wait_for(lambda: len(subscriber.messages) == 5)


@pytest.mark.promise(
    "docs/how-to/mqtt.md", "If a surface gets a model with other axes, its sensors change while the service runs."
)
def test_home_assistant_is_told_of_the_axes_of_a_model_that_comes_later(line: Line, build_model: BuildModel) -> None:
    subscriber = line.broker.subscribe("-t", described("press-7"))
    line.start(DISCOVERY)
    wait_for(lambda: len(subscriber.messages) == 1)
    before = subscriber.messages[0].content["components"]
    build_model(outputs=PLATE_OUTPUTS)  # in the place of the beam
    wait_for(lambda: len(subscriber.messages) == 3)
    removing, newest = (one.content["components"] for one in subscriber.messages[1:])
    assert newest.keys() == before.keys() - {"position"} | {"x", "y"}
    assert removing == newest | {"position": {"platform": "sensor"}}


@pytest.mark.promise("docs/how-to/mqtt.md", "There, `_`, `.` and `/` of the two names are `__u`, `__d` and `__s`")
def test_names_and_prefixes_that_look_alike_are_devices_of_their_own(line: Line) -> None:
    subscriber = line.broker.subscribe("-t", "#")
    names = ["press.7", "press_7", "press-7", "Press-7", "press__d7", "-", "a" * 64]
    prefixes = ["hall/1", "hall_1", "hall.1", "hall", "1"]
    for prefix in prefixes:
        line.start(DISCOVERY, f'prefix = "{prefix}"', surfaces=[f'"{name}"' for name in names])
    wait_for(lambda: len(devices(subscriber)) == len(names) * len(prefixes))
    found = devices(subscriber)
    identifiers = [one["device"]["identifiers"][0] for one in found]
    unique = [component["unique_id"] for one in found for component in one["components"].values()]
    assert (len(set(identifiers)), len(set(unique))) == (len(found), 4 * len(found))
    # Home Assistant takes no other topics.
    topics = [topic for topic in kept(subscriber) if topic.endswith("/config")]
    allowed = re.compile(r"homeassistant/device(/[a-zA-Z0-9_-]+){1,2}/config")
    assert [topic for topic in topics if not allowed.fullmatch(topic)] == []
    # Each is read where it is written.
    assert {one["availability_topic"].removesuffix("/status") for one in found} == set(prefixes)
    read = {one["components"]["problem"]["state_topic"] for one in found}
    wait_for(lambda: read <= kept(subscriber).keys())


@pytest.mark.promise("docs/how-to/mqtt.md", "so a service removes only what it has retained itself.")
@pytest.mark.parametrize(
    ("first", "second", "also"),
    [
        (['prefix = "hall"'], ['prefix = "hall/1"'], []),
        (['prefix = "hall"'], ['prefix = "hall_1"'], []),
        (['prefix = "hall"', 'client_id = "one"'], ['prefix = "hall"', 'client_id = "two"'], ["hall/status"]),
        (['prefix = "hall"'], ['prefix = "hall/press-7"'], ["hall/press-7/status"]),
    ],
    ids=["below", "alike", "shared", "a-surface-of-the-other"],
)
def test_a_service_removes_nothing_of_another_one_and_says_if_both_write_to_one_topic(
    line: Line, first: list[str], second: list[str], also: list[str]
) -> None:
    subscriber = line.broker.subscribe("-t", "#")
    services = [
        line.start(DISCOVERY, *first, surfaces=["press-7"]),
        line.start(DISCOVERY, *second, surfaces=["press-8"]),
    ]
    # Of each a description, a status, and that of its surface; some are one topic.
    wait_for(lambda: len(kept(subscriber)) == 6 - len(also))
    everything = kept(subscriber).keys()
    # The first one starts anew, beside the second and without it.
    services[0] = change(line, services[0], DISCOVERY, *first, surfaces=["press-7"])
    wait_connected(services[0])
    said = [services[1].stop(signal.SIGKILL)[1]]
    services[0] = change(line, services[0], DISCOVERY, *first, surfaces=["press-7"])
    wait_connected(services[0])
    services.append(line.start(DISCOVERY, *second, surfaces=["press-8"]))
    wait_connected(services[2])
    assert kept(subscriber).keys() == everything
    assert not [one for one in subscriber.messages if one.topic.endswith("/config") and not one.text]
    said += [services[place].stop(signal.SIGTERM)[1] for place in (0, 2)]
    assert [topic for topic in everything if f"writes to {topic}, too" in "".join(said)] == also


@pytest.mark.promise(
    "docs/how-to/mqtt.md",
    "A user that may not read is named in the log: what you remove from the configuration then stays at the broker.",
)
def test_a_user_that_may_not_read_is_a_line_that_says_what_stays(line: Line) -> None:
    rights = line.folder / "rights"
    rights.write_text("topic write #\n")
    line.broker.configure(f"acl_file {rights}")
    line.broker.kill()
    line.broker.start()
    service = line.start(DISCOVERY, code=IMPATIENT)
    # A contact is sent each second.
    wait_for(lambda: metric(service, 'messages_total{kind="contact"}') >= 3)
    _, errors = service.stop(signal.SIGTERM)
    assert errors.count("may not read beamtouch/status; allow it, or what you remove here stays there") == 1


def test_a_broker_that_ends_the_connection_of_who_may_not_read_still_gets_contacts(line: Line) -> None:
    subscriber = line.broker.subscribe("-t", "#")
    with cutting_relay(line.broker.port) as port:
        service = line.start(DISCOVERY, port=port, code=COMES_BACK)
        wait_connected(service)
        service.post(now_batch(TOUCHING, sequence=1))
        wait_for(lambda: any(one.get("state") == "contact" for one in subscriber.of(CONTACT)))
        wait_for(lambda: described("press-7") in kept(subscriber))
        _, errors = service.stop(signal.SIGTERM)
    topics = (STATUS, status("+"), described("+"))
    assert [errors.count(f"may not read {topic} (it ends the connection); allow it") for topic in topics] == [1, 1, 1]


def test_a_broker_that_ends_the_connection_of_who_may_not_remove_still_gets_contacts(line: Line) -> None:
    subscriber = line.broker.subscribe("-t", "#")
    service = line.start(DISCOVERY, surfaces=["press-7", "press-8"])
    wait_for(lambda: len(kept(subscriber)) == 5)
    with cutting_relay(line.broker.port, publishes_to("press-8")) as port:
        service = change(line, service, DISCOVERY, port=port, code=COMES_BACK)
        wait_connected(service)
        service.post(now_batch(TOUCHING, sequence=1))
        wait_for(lambda: any(one.get("state") == "contact" for one in subscriber.of(CONTACT)))
        _, errors = service.stop(signal.SIGTERM)
    said = "which is of no surface any more; remove it there"
    topics = (status("press-8"), described("press-8"))
    assert [errors.count(f"messages to {topic} (it ends the connection), {said}") for topic in topics] == [1, 1]


@pytest.mark.promise("docs/how-to/mqtt.md", "Stop the service before you change these, and remove it there")
def test_the_command_of_the_guide_removes_all_of_a_service_and_nothing_of_others(line: Line) -> None:
    words = re.search(r"^\$ (mosquitto_sub .* --remove-retained .*)$", GUIDE.read_text(), re.MULTILINE)
    assert words is not None
    subscriber = line.broker.subscribe("-t", "#")
    others = line.start(DISCOVERY, 'prefix = "hall"')
    service = line.start(DISCOVERY, surfaces=["press-7", "press_8"])
    wait_for(lambda: len(kept(subscriber)) == 8)
    service.stop(signal.SIGTERM)
    program, *typed = shlex.split(words[1].replace("broker.example", "127.0.0.1").replace("-W 5", "-W 1"))
    subprocess.run([require(program, "mosquitto-clients"), "-p", str(line.broker.port), *typed], check=False)
    wait_for(lambda: kept(subscriber).keys() == {"hall/status", "hall/press-7/status", described("press-7", "hall")})
    others.stop(signal.SIGTERM)
