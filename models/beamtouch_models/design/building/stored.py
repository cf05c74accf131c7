"""The settings that an earlier build has left in a model file, of any version of its format."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import onnx
from google.protobuf.message import DecodeError

from beamtouch_common.names import NAME
from beamtouch_models.errors import ModelFileError
from beamtouch_models.places import Place
from beamtouch_models.runtime import loading
from beamtouch_models.runtime.metadata import METADATA_PREFIX


def stored_in_file(path: Path) -> dict[str, Any]:
    """Return what a model file states; raises ModelFileError if it cannot be read, or as `stored_in`."""
    return stored_in(loading.read(path))


def stored_in(content: bytes) -> dict[str, Any]:
    """Return what the content of a model file states, by its name in the metadata.

    Raises
    ------
    ModelFileError
        It is no model file of this program, or a statement in it is no JSON.
    """
    try:
        entries = [(entry.key, entry.value) for entry in onnx.load_from_string(content).metadata_props]
        own = {key.removeprefix(METADATA_PREFIX): value for key, value in entries if key.startswith(METADATA_PREFIX)}
        stored = {key: json.loads(value) for key, value in own.items()}
    except (DecodeError, TypeError, ValueError, RecursionError):  # protobuf gives bytes for what is no text
        raise ModelFileError("it cannot be read as a model file") from None
    if "layout" not in stored:
        raise ModelFileError("it has no layout of a surface")
    return stored


def scene_in(stored: Mapping[str, Any]) -> tuple[str, str]:
    """Return the scene (TOML) and the name in what a model file states; raises ModelFileError."""
    text, name = stored.get("scene"), stored.get("name")
    if not (isinstance(text, str) and isinstance(name, str) and re.fullmatch(NAME, name)):
        raise ModelFileError("it has no scene with a name")
    return text, name


def positions_in(stored: Mapping[str, Any]) -> tuple[Place, ...]:
    """Return the places of the sensors (channels,) in what a model file states [mm]; raises ModelFileError."""
    try:
        return tuple(_place_in(channel) for channel in stored["layout"])
    except (KeyError, TypeError, ValueError, OverflowError):
        raise ModelFileError("its layout has no positions") from None


def _place_in(channel: Mapping[str, Any]) -> Place:
    along, across = float(channel["position_mm"]), channel.get("across_mm")
    return along if across is None else (along, float(across))
