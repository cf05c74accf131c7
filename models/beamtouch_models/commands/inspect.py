"""`design-sensors inspect`: prints the metadata of a model file."""

import argparse
import json
from dataclasses import asdict
from typing import Any

from beamtouch_models.detection import detection_of
from beamtouch_models.loading import ModelFile, load


def run(options: argparse.Namespace) -> None:
    """Load the model, which checks its golden answers, and print it."""
    show(load(options.model), as_json=options.json)


def show(model: ModelFile, *, as_json: bool) -> None:
    """Print a model as one JSON object or as text."""
    print(json.dumps(describe(model)) if as_json else model.summary())


def describe(model: ModelFile) -> dict[str, Any]:
    """Return all metadata of a model file, for JSON."""
    metadata = model.metadata
    along = detection_of(metadata) if "contact_log_odds" in model.outputs else None
    fields = metadata.model_dump(mode="json", exclude={"golden", "layout", "accuracy", "drawn"})
    return {
        **fields,
        "model": model.identity,
        "positions_mm": [channel.position_mm for channel in metadata.layout],
        "channels": model.channels,
        "noise_mm": metadata.noise.sample_mm,
        "detection": along and asdict(along),
        "outputs": list(model.outputs),
        "lacks": model.lacks,
        "accuracy": {**metadata.accuracy.model_dump(), "ratio": metadata.accuracy.ratio},
        "golden_answers": len(metadata.golden.deflection_mm),
    }
