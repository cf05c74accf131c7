"""Descriptions of the surfaces for Home Assistant (MQTT discovery of devices). Pure."""

import json

from beamtouch_common.commands import version
from beamtouch_common.zones import ZoneState
from beamtouch_models.runtime import State
from beamtouch_service.outputs.mqtt.messages import OFFLINE, ONLINE, READY, Topics
from beamtouch_service.surfaces.fields import fields_of
from beamtouch_service.surfaces.surface import Surface

EXPIRE_S = 3
"""Without a contact for this long, Home Assistant shows the figures as unavailable. One arrives each second."""
_ON_OFF = json.dumps({ZoneState.INSIDE: "ON", ZoneState.OUTSIDE: "OFF"})
"""In a template: the answer for a zone -> what a binary sensor shows. Anything else is unknown."""
_ESCAPES = str.maketrans({"_": "__u", ".": "__d", "/": "__s"})
"""Home Assistant takes letters, digits, "_" and "-" in topics. Two names never become the same."""


def topic(topics: Topics, surface: str) -> str:
    """Return the topic where Home Assistant looks for the description of a surface; `+` stands for every surface.

    The prefix has a level of its own, so that a service can subscribe to its own descriptions alone.
    """
    return f"homeassistant/device/{topics.prefix.translate(_ESCAPES)}/{surface.translate(_ESCAPES)}/config"


def description(topics: Topics, surface: Surface) -> bytes:
    """Return the description of a surface: its contact, its zones, and whether someone must look at it."""
    contact, identifier = topics.contact(surface.name), _identifier(topics, surface.name)

    def entity(name: str, template: str, **more: object) -> dict[str, object]:
        named = {"name": f"{name[0].upper()}{name[1:]}", "unique_id": f"{identifier}_{name}"}
        return named | {"value_template": f"{{{{ {template} }}}}"} | more

    def sensor(name: str, template: str, **more: object) -> dict[str, object]:
        # Home Assistant shows `None` as unknown, and so does a problem, which has no such member.
        where = {"platform": "sensor", "state_topic": contact, "expire_after": EXPIRE_S}
        return entity(name, f"value_json.{template}", **where, **more)

    options = [*(state.value for state in State), "problem"]
    figure = {"state_class": "measurement"}
    components = {
        "state": sensor("state", "state | default('problem')", device_class="enum", options=options),
        **{
            one.entity: sensor(one.entity, f"{one.name} | default(none)", unit_of_measurement=one.unit, **figure)
            for one in fields_of(surface.axes)
            if one.entity
        },
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


def without(described: bytes, gone: dict[str, str]) -> bytes:
    """Return a description that also removes components: a component without more than its platform goes.

    `gone` are the platforms of these components by their name. The description itself must follow: one that still
    names them would be read again each time that Home Assistant starts.
    """
    whole = json.loads(described)
    whole["components"] |= {name: {"platform": platform} for name, platform in gone.items()}
    return json.dumps(whole).encode()


def find_gone(before: bytes, described: bytes) -> dict[str, str]:
    """Return the platforms of the components that a description no longer has, by their name."""
    old, new = components(before), components(described)
    return {name: platform for name, platform in old.items() if name not in new}


def components(described: bytes) -> dict[str, str]:
    """Return the platforms of the components of a description by their name; none of a text that is something else."""
    try:
        found = json.loads(described)["components"]
        return {name: one["platform"] for name, one in found.items() if len(one) > 1}
    except (ValueError, TypeError, LookupError, AttributeError):
        return {}


def _identifier(topics: Topics, surface: str) -> str:
    return "_".join(name.translate(_ESCAPES) for name in (topics.prefix, surface))
