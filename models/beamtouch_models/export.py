"""Model files as bytes."""

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
