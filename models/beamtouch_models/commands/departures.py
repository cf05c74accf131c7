"""Fitted departures in words, for the commands that fit them."""

from beamtouch_models.arrays import Floats
from beamtouch_models.metadata import Departures, Metadata


def departures_in_words(metadata: Metadata, found: Departures, errors: dict[str, Floats]) -> dict[str, str]:
    """Return each kind of departure with its standard errors, as text.

    Parameters
    ----------
    metadata : the model, for the names of its channels
    found : the departures
    errors : their standard errors by kind, in the units of the departures
    """
    names = [channel.name for channel in metadata.layout]

    def each(values: list[float], spread: Floats, factor: float = 1.0, centre: float = 0.0) -> str:
        return ", ".join(
            f"{name} {(value - centre) * factor:+.2f} +- {error * factor:.2f}"
            for name, value, error in zip(names, values, spread, strict=True)
        )

    shown = {
        "rigidity": f"{(found.rigidity - 1) * 100:+.2f} +- {errors['rigidity'][0] * 100:.2f} %",
        "gain": f"{each(found.gain, errors['gain'], 100.0, 1.0)} %",
        "position": f"{each(found.position_offset_mm, errors['position'])} mm",
        "curve": f"{found.curve_per_mm:+.4f} +- {errors['curve'][0]:.4f} per mm",
        "offset": f"{each(found.offset_mm, errors['offset'], 1e3)} um",
    }
    if "fixity" in errors:
        ends = zip(found.fixity, errors["fixity"], strict=True)
        left, right = (f"{value:.3f} +- {error:.3f}" for value, error in ends)
        shown["fixity"] = f"left {left}, right {right}"
    return shown
