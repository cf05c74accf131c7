"""The kinds of files that people write, told apart by their tables."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

_TABLES = {
    "a scene": {"beam", "contact", "sensors", "requirements", "environment"},
    "a configuration of the daemon": {"publish", "metrics"},
    "a configuration of the service": {"server", "events", "modbus_server", "mqtt"},
    "a script of the rig": {"step"},
}
"""Tables that only one kind has."""
_SURFACE_KEYS = {
    "a configuration of the daemon": {"source", "channels", "rate_hz"},
    "a configuration of the service": {"model", "stale_ms"},
}
"""Keys of [surfaces.NAME] that only one kind has."""


def mistaken_kind(kind: type[BaseModel], content: Mapping[str, Any]) -> str:
    """Return what a file is and what to give instead, if it is clearly of another kind; else an empty text.

    Parameters
    ----------
    kind : the pydantic model by which the file is read
    content : its tables
    """
    fields = set(kind.model_fields)
    expected = next((name for name, tables in _TABLES.items() if tables & fields), "")
    found = [name for name in _TABLES if _speaks_for(name, content)]
    if not expected or len(found) != 1 or expected in found:
        return ""
    return f"this is {found[0]}; give {expected}"


def _speaks_for(name: str, content: Mapping[str, Any]) -> bool:
    surfaces = content.get("surfaces")
    keys = (
        {key for table in surfaces.values() if isinstance(table, Mapping) for key in table}
        if isinstance(surfaces, Mapping)
        else set()
    )
    return bool(_TABLES[name] & set(content) or _SURFACE_KEYS.get(name, set()) & keys)
