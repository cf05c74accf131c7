"""`design-sensors inspect`: prints the metadata of a model file."""

import argparse
import json

from beamtouch_models import loading
from beamtouch_models.building import description


def run(options: argparse.Namespace) -> None:
    """Load the model, which checks its golden answers, and print it."""
    show(loading.load(options.model), as_json=options.json)


def show(model: loading.ModelFile, *, as_json: bool) -> None:
    """Print a model as one JSON object or as text."""
    print(json.dumps(description.describe(model)) if as_json else model.summary())
