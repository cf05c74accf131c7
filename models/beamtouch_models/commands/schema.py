"""`design-sensors schema`: the JSON Schema of a scene, for editors."""

import argparse
import json

from beamtouch_models.design.printing import Result
from beamtouch_models.design.scene.schema import scene_schema


def run(_options: argparse.Namespace) -> Result:
    """Return the schema."""
    schema = scene_schema()
    return Result(schema, [json.dumps(schema, indent=1, ensure_ascii=False)])
