"""The report of a build as one HTML page: no script, no request, readable in light, in the dark and on paper."""

from html import escape
from importlib.resources import files

from beamtouch_models import charts
from beamtouch_models.building.report import sections
from beamtouch_models.building.report.facts import Facts


def page(facts: Facts) -> str:
    """Return the page as text."""
    metadata = facts.model.metadata
    css = files(__package__).joinpath("style.css").read_text(encoding="utf-8")
    title = f"{metadata.name}: report of a build"
    parts = [
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{escape(title)}</title>',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<style>\n{css}{charts.STYLE}</style>\n</head>\n<body>\n<main>",
        *sections.everything(facts),
        "</main>\n</body>\n</html>\n",
    ]
    return "\n".join(parts)
