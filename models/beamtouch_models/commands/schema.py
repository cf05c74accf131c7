"""`design-sensors schema`: the JSON Schema of a scene, for editors."""

import argparse
import json

from beamtouch_models.printing import Result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add no arguments: there is one schema, and it is JSON."""


def run(_options: argparse.Namespace) -> Result:
    """Return the schema."""
    from beamtouch_models.scene.schema import scene_schema

    schema = scene_schema()
    return Result(schema, [json.dumps(schema, indent=1, ensure_ascii=False)])
