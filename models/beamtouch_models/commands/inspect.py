"""`design-sensors inspect`: prints the metadata of a model file."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from beamtouch_models.commands.options import add_json
from beamtouch_models.printing import Result, show

if TYPE_CHECKING:
    from beamtouch_models.loading import ModelFile


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("model", type=Path, metavar="MODEL", help="model file (.onnx)")
    add_json(parser)


def run(options: argparse.Namespace) -> None:
    """Load the model, which checks its golden answers, and print it."""
    from beamtouch_models.loading import load

    show(describe(load(options.model)), as_json=options.json)


def describe(model: ModelFile) -> Result:
    """Return a model file with all its metadata, as `inspect` and `build` print it."""
    metadata = model.metadata
    dumped = metadata.model_dump(mode="json", exclude={"golden", "layout", "accuracy", "drawn"})
    fields = {
        **dumped,
        "model": model.identity,
        "positions_mm": [channel.position_mm for channel in metadata.layout],
        "channels": model.channels,
        "noise_mm": metadata.noise.sample_mm,
        "outputs": list(model.outputs),
        "lacks": model.lacks,
        "accuracy": {**metadata.accuracy.model_dump(), "ratio": metadata.accuracy.ratio},
        "golden_answers": len(metadata.golden.deflection_mm),
    }
    return Result(fields, [model.summary()])
