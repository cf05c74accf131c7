"""JSON Schemas of TOML files that people write, for editors: that of a scene, and how any is made."""

from typing import Any

from pydantic import BaseModel

from beamtouch_models.design.scene import Scene

Schema = dict[str, Any]
DIALECT = "https://json-schema.org/draft/2020-12/schema"


def editor_schema(model: type[BaseModel], title: str) -> Schema:
    """Return the JSON Schema of a whole TOML file, as an editor uses it: TOML has no null, and names need no titles."""
    schema: Schema = _without_null(model.model_json_schema())
    return {"$schema": DIALECT} | schema | {"title": title}


def _without_null(part: Any) -> Any:  # noqa: ANN401  # any JSON value
    if isinstance(part, list):
        return [_without_null(item) for item in part]
    if not isinstance(part, dict):
        return part
    cleaned = {
        name: {key: _without_null(schema) for key, schema in value.items()}
        if name in ("properties", "$defs")
        else _without_null(value)
        for name, value in part.items()
        if not (name == "title" and isinstance(value, str))
        and not (name == "default" and (value is None or isinstance(value, dict)))
    }
    choices = [choice for choice in cleaned.get("anyOf", []) if choice != {"type": "null"}]
    if len(choices) == 1 and "anyOf" in cleaned:
        del cleaned["anyOf"]
        return choices[0] | cleaned
    return cleaned | ({"anyOf": choices} if choices else {})


def scene_schema() -> Schema:
    """Return the JSON Schema of a scene."""
    return editor_schema(Scene, "Scene of Beamtouch")
