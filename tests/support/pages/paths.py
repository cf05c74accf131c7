"""The points that the path of an SVG drawing goes through."""

import re

NUMBERS = {"M": 2, "m": 2, "L": 2, "l": 2, "H": 1, "h": 1, "V": 1, "v": 1, "a": 7, "z": 0}


def strokes_of(path: str) -> list[list[tuple[float, float]]]:
    """Return the points of each stroke of a path in px; a stroke begins where the pen is set down anew.

    Of an arc, its ends count, and the radius must fit them: it is half of a circle.
    """
    strokes: list[list[tuple[float, float]]] = []
    x = y = 0.0
    for command, stated in re.findall(r"([A-Za-z])([^A-Za-z]*)", path):
        numbers, count = [float(number) for number in re.findall(r"-?[\d.]+", stated)], NUMBERS[command]
        for at in range(0, max(len(numbers), 1), max(count, 1)):
            values = numbers[at : at + count]
            assert len(values) == count
            if command == "z":
                x, y = strokes[-1][0]
            elif command in "Hh":
                x = values[0] + (x if command == "h" else 0)
            elif command in "Vv":
                y = values[0] + (y if command == "v" else 0)
            else:
                dx, dy = values[-2:]
                x, y = (x + dx, y + dy) if command.islower() else (dx, dy)
            if command == "a":
                assert values[0] == values[1] == (dx**2 + dy**2) ** 0.5 / 2
            if command in "Mm":
                strokes.append([(x, y)])
            else:
                strokes[-1].append((x, y))
    return strokes
