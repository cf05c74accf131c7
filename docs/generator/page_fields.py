"""The large figures of the page and the columns of its events as a module of JavaScript, from the tables of fields."""

import json
from collections.abc import Iterator

from beamtouch_common.outline import BEAM_AXES, PLATE_AXES
from beamtouch_service.record import event_fields_of
from beamtouch_service.surfaces.fields import fields_of

_HEAD = """\
// The figures that the page shows. `make reference` writes this file from the tables of fields.

"""
_PLACE = {f"mean_{BEAM_AXES[0]}_mm": "place"}
"""The field of the column that shows the place on a surface of any number of axes."""


def page_fields() -> str:
    """Return the module."""
    figures = {len(axes): list(_figures(axes)) for axes in (BEAM_AXES, PLATE_AXES)}
    return (
        _HEAD
        + _constant("FIGURES", "The large figures, by the number of axes of a surface.", figures)
        + "\n"
        + _constant("COLUMNS", "The columns of an event, on surfaces of any number of axes.", list(_columns()))
    )


def _constant(name: str, words: str, value: object) -> str:
    return f"/** {words} */\nexport const {name} = {json.dumps(value, indent=2, ensure_ascii=False)};\n"


def _figures(axes: tuple[str, ...]) -> Iterator[dict[str, object]]:
    for field in fields_of(axes):
        if field.label:
            figure = field.name.removesuffix(f"_{field.unit.lower()}")
            axis = axes.index(figure) if figure in axes else None
            named: dict[str, object] = {"id": figure, "name": field.name, "ends": field.ends, "axis": axis}
            yield named | {"label": field.label, "unit": field.unit}


def _columns() -> Iterator[dict[str, str]]:
    # Words stand behind the duration, so it is the last column; the page shows times in s.
    for field in sorted(event_fields_of(), key=lambda field: field.unit == "ms"):
        if field.label:
            yield {
                "name": _PLACE.get(field.name, field.name),
                "label": field.label,
                "unit": field.unit.replace("ms", "s"),
            }
