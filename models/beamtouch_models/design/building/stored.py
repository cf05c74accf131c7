"""What an earlier build has left in a model file, of any version of its format."""

from pathlib import Path

import onnx
from google.protobuf.message import DecodeError

from beamtouch_models.errors import ModelFileError
from beamtouch_models.runtime import loading
from beamtouch_models.runtime.metadata import METADATA_PREFIX


def entries_of(path: Path) -> dict[str, str]:
    """Return the metadata of a model file; raises ModelFileError if it cannot be read, or as `entries_in` does."""
    return entries_in(loading.read(path))


def entries_in(content: bytes) -> dict[str, str]:
    """Return the metadata in the content of a model file: JSON by name, without the prefix of the names.

    Raises
    ------
    ModelFileError
        It is the content of something else.
    """
    try:
        stored = onnx.load_from_string(content).metadata_props
    except DecodeError:
        raise ModelFileError("it cannot be read as a model file") from None
    entries = {entry.key.removeprefix(METADATA_PREFIX): entry.value for entry in stored}
    if "layout" not in entries:
        raise ModelFileError("it has no layout of a surface")
    return entries
