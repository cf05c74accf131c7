"""The few HTML elements that the report is made of. Text is escaped here and nowhere else."""

from collections.abc import Iterable, Sequence
from html import escape

from beamtouch_models.charts import Chart, draw


def heading(text: str) -> str:
    """Return the heading of a section."""
    return f"<h2>{escape(text)}</h2>"


def paragraph(text: str, *, quiet: bool = False) -> str:
    """Return a paragraph; a quiet one is an aside."""
    name = ' class="quiet"' if quiet else ""
    return f"<p{name}>{escape(text)}</p>"


def tiles(entries: Iterable[tuple[str, str, str]]) -> str:
    """Return figures that stand out: name, value, and what it means."""
    inner = "".join(
        f"<div><dt>{escape(name)}</dt><dd>{escape(value)}<small>{escape(note)}</small></dd></div>"
        for name, value, note in entries
    )
    return f'<dl class="tiles">{inner}</dl>'


def figure(svg: str, caption: str, *, chart: bool = True) -> str:
    """Return a drawing with its caption."""
    name = ' class="chart-figure"' if chart else ""
    return f"<figure{name}>\n{svg}\n<figcaption>{escape(caption)}</figcaption>\n</figure>"


def chart_figure(chart: Chart, caption: str) -> str:
    """Return a chart with its caption."""
    return figure(draw(chart), caption)


def table(
    caption: str,
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    marked: int | None = None,
    words: Sequence[int] = (),
) -> str:
    """Return a table whose first column names the rows.

    `marked` is the row to stand out; `words` are the columns that hold words and not numbers.
    """
    kind = [' class="words"' if column in words else "" for column in range(len(head))]
    cells = "".join(f'<th scope="col"{name}>{escape(text)}</th>' for text, name in zip(head, kind, strict=True))
    body = []
    for number, (first, *others) in enumerate(rows):
        data = "".join(f"<td{name}>{escape(text)}</td>" for text, name in zip(others, kind[1:], strict=True))
        taken = ' class="taken"' if number == marked else ""
        body.append(f'<tr{taken}><th scope="row">{escape(first)}</th>{data}</tr>')
    return (
        f'<div class="wide"><table><caption>{escape(caption)}</caption>\n<thead><tr>{cells}</tr></thead>\n'
        f"<tbody>\n{chr(10).join(body)}\n</tbody></table></div>"
    )


def details(summary: str, text: str) -> str:
    """Return a text that is folded away."""
    return f"<details><summary>{escape(summary)}</summary><pre>{escape(text)}</pre></details>"
