"""Descriptions of the surfaces for Home Assistant (MQTT discovery of devices). Pure."""

import json
import re

from beamtouch_common.commands import version
from beamtouch_common.zones import ZoneState
from beamtouch_models.modelfile import State
from beamtouch_service.outputs.mqtt.messages import OFFLINE, ONLINE, READY, Topics
from beamtouch_service.surfaces.surface import Surface

EXPIRE_S = 3
"""Without a contact for this long, Home Assistant shows the figures as unavailable. One arrives each second."""
_ON_OFF = json.dumps({ZoneState.INSIDE: "ON", ZoneState.OUTSIDE: "OFF"})
"""In a template: the answer for a zone -> what a binary sensor shows. Anything else is unknown."""


def topic(topics: Topics, surface: str) -> str:
    """Return the topic where Home Assistant looks for the description of a surface."""
    return f"homeassistant/device/{_identifier(topics, surface)}/config"


def description(topics: Topics, surface: Surface) -> bytes:
    """Return the description of a surface: its contact, its zones, and whether someone must look at it."""
    contact, identifier = topics.contact(surface.name), _identifier(topics, surface.name)

    def entity(name: str, template: str, **more: object) -> dict[str, object]:
        named = {"name": name.capitalize(), "unique_id": f"{identifier}_{name}"}
        return named | {"value_template": f"{{{{ {template} }}}}"} | more

    def sensor(name: str, template: str, **more: object) -> dict[str, object]:
        # Home Assistant shows `None` as unknown, and so does a problem, which has no such member.
        where = {"platform": "sensor", "state_topic": contact, "expire_after": EXPIRE_S}
        return entity(name, f"value_json.{template}", **where, **more)

    options = [*(state.value for state in State), "problem"]
    figure = {"state_class": "measurement"}
    components = {
        "state": sensor("state", "state | default('problem')", device_class="enum", options=options),
        "position": sensor("position", "position_mm | default(none)", unit_of_measurement="mm", **figure),
        "force": sensor("force", "force_n | default(none)", unit_of_measurement="N", **figure),
        "problem": entity(
            "problem",
            f"'OFF' if value_json.status == '{READY}' else 'ON'",
            platform="binary_sensor",
            device_class="problem",
            state_topic=topics.surface_status(surface.name),
        ),
        **{
            f"zone_{zone}": entity(
                f"zone {zone}",
                f"{_ON_OFF}.get((value_json.zones | default({{}})).get('{zone}'))",
                platform="binary_sensor",
                state_topic=contact,
                expire_after=EXPIRE_S,
            )
            for zone in surface.section.zones
        },
    }
    whole = {
        "device": {"identifiers": [identifier], "name": surface.name, "manufacturer": "Beamtouch"},
        "origin": {"name": "Beamtouch", "sw_version": version()},
        "availability_topic": topics.status,
        "payload_available": ONLINE,
        "payload_not_available": OFFLINE,
        "components": components,
    }
    return json.dumps(whole).encode()


def _identifier(topics: Topics, surface: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]", "_", f"{topics.prefix}_{surface}")
