"""Tables of loads on a beam and on a plane, as text, with other cells."""

from collections.abc import Sequence

Rows = Sequence[Sequence[float | str]]

HEAD = "position_mm,force_n,a_deflection_mm,b_deflection_mm"
ROWS: Rows = [(10, 5, 0.1, 0.3), (60, 5, 0.25, 0.35), (130, 4, 0.3, 0.2), (250, 8, 0.15, 0.4)]
PLANE = "x_mm,y_mm,force_n,a_deflection_mm,b_deflection_mm"
PLANE_ROWS: Rows = [(10, 20, 5, 0.1, 0.3), (60, 90, 5, 0.25, 0.35), (130, 5, 4, 0.3, 0.2), (250, 70, 8, 0.15, 0.4)]


def table(rows: Rows = ROWS, head: str = HEAD) -> str:
    return "\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n"


def changed(row: int, column: int, value: float | str, rows: Rows = ROWS) -> Rows:
    """Return the rows with another cell, counted from 0."""
    new = [list(cells) for cells in rows]
    new[row][column] = value
    return new


def even(count: int, places: int) -> Rows:
    """Return loads at even places, round and round."""
    return [(index % places, 5, 0.1 + 1e-5 * index, 0.2 - 1e-5 * index) for index in range(count)]
