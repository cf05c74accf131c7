"""Writing of model files, and of any file as a whole."""

from pathlib import Path

import onnx

from beamtouch_models.metadata import Metadata


def to_bytes(model: onnx.ModelProto, metadata: Metadata | None = None) -> bytes:
    """Serialise a graph, with its metadata; the same input gives the same bytes."""
    complete = onnx.ModelProto()
    complete.CopyFrom(model)
    for key, text in sorted((metadata.to_entries() if metadata else {}).items()):
        complete.metadata_props.add(key=key, value=text)
    content: bytes = complete.SerializeToString(deterministic=True)
    return content


def write_whole(path: Path, content: bytes) -> None:
    """Write a file atomically: it appears complete or not at all."""
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
