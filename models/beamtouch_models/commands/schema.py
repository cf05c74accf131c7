"""`design-sensors schema`: the JSON Schema of a scene, for editors."""

import argparse
import json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add no arguments: there is one schema, and it is JSON."""


def run(_options: argparse.Namespace) -> None:
    """Print the schema."""
    from beamtouch_models.scene.schema import scene_schema

    print(json.dumps(scene_schema(), indent=1, ensure_ascii=False))
