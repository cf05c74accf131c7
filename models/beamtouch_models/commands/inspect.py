"""`design-sensors inspect`: prints the metadata of a model file."""

import argparse

from beamtouch_models.design.printing import Result
from beamtouch_models.runtime.loading import ModelFile, load


def run(options: argparse.Namespace) -> Result:
    """Load the model, which checks its golden answers, and return it."""
    return describe(load(options.model))


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
