"""The large figures of the page as a module of JavaScript, from the table of fields."""

import json
from collections.abc import Iterator

from beamtouch_common.outline import BEAM_AXES, PLATE_AXES
from beamtouch_service.surfaces.fields import fields_of

_HEAD = """\
// The large figures, by the number of axes of a surface. `make reference` writes this file from the table of fields.

export const FIGURES = """


def page_fields() -> str:
    """Return the module."""
    figures = {len(axes): list(_figures(axes)) for axes in (BEAM_AXES, PLATE_AXES)}
    return f"{_HEAD}{json.dumps(figures, indent=2, ensure_ascii=False)};\n"


def _figures(axes: tuple[str, ...]) -> Iterator[dict[str, object]]:
    for field in fields_of(axes):
        if field.label:
            figure = field.name.removesuffix(f"_{field.unit.lower()}")
            axis = axes.index(figure) if figure in axes else None
            named: dict[str, object] = {"id": figure, "name": field.name, "ends": field.ends, "axis": axis}
            yield named | {"label": field.label, "unit": field.unit}
