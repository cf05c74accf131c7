"""`design-sensors inspect`: what a model file says of itself."""

import argparse
import json

from beamtouch_models import modelfile, report


def run(options: argparse.Namespace) -> None:
    """Load the model, golden answers included, and print it."""
    show(modelfile.load(options.model), as_json=options.json)


def show(model: modelfile.ModelFile, *, as_json: bool) -> None:
    """Print a model as one JSON object or as lines for a person."""
    print(json.dumps(report.describe(model)) if as_json else report.summary(model))
