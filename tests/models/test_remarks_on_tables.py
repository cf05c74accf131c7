"""What a table of measured loads may have in another unit, is told with its numbers from the stated borders on."""

from typing import Any

import numpy as np
import pytest

from beamtouch_models import Scene, make_scene
from beamtouch_models.design.building.remarks import remarks, weak_spot
from support.surfaces.small_model import model_of

PLACES = np.arange(20.0, 500.0, 55.0)


def scene_of(
    *,
    force_n: float = 4.0,
    most_mm: float = 1.0,
    contact_n: tuple[float, float] = (2.0, 8.0),
    **measured: Any,  # noqa: ANN401
) -> Scene:
    """A scene of loads of a force, under which two sensors show up to `most_mm` under the strongest contact."""
    scale = most_mm * force_n / contact_n[1]
    largest = np.sin(PLACES / 150).max()
    rows = [
        f"{place:g},{force_n:g},{scale * np.sin(place / 150) / largest:.9g},{0.7 * scale * np.cos(place / 400):.9g}"
        for place in PLACES
    ]
    loads = "\n".join(["position_mm,force_n,a_deflection_mm,b_deflection_mm", *rows])
    stated = {"influence": loads, "length_mm": 500} | (measured or {"sensors_mm": {"a": 240.0, "b": 100.0}})
    return make_scene(
        measured=stated,
        contact={"force_n": list(contact_n), "position_mm": [30, 450]},
        sensors={"noise_mm": 1e-7, "range_mm": [1, 900]},
    )


def told(**loads: Any) -> list[str]:  # noqa: ANN401
    return remarks(scene_of(**loads))


@pytest.mark.parametrize(
    ("force_n", "contact_n", "is_told"),
    [(39.0, (2.0, 8.0), False), (41.2345, (2.0, 8.0), True), (2.1, (10.0, 20.0), False), (1.98765, (10.0, 20.0), True)],
)
def test_forces_five_times_those_of_contacts_or_a_fifth_are_in_another_unit(
    force_n: float, contact_n: tuple[float, float], *, is_told: bool
) -> None:
    said = (
        f"the loads of the table have {force_n:.3g} to {force_n:.3g} N, but contact.force_n is {contact_n[0]:g} to "
        f"{contact_n[1]:g} N; if the loads are in g, 100 g weigh 0.981 N; if they are in kg, 1 kg weighs 9.81 N"
    )
    assert told(force_n=force_n, contact_n=contact_n) == [said] * is_told


@pytest.mark.parametrize(("most_mm", "is_told"), [(49.5, False), (50.5432, True)])
def test_a_bend_of_a_tenth_of_the_length_is_in_another_unit(most_mm: float, *, is_told: bool) -> None:
    said = (
        f"by its table, the structure bends by {most_mm:.3g} mm over 500 mm; if the table is in um, divide its "
        "deflections by 1000"
    )
    assert told(most_mm=most_mm) == [said] * is_told


@pytest.mark.parametrize(("most_mm", "is_told"), [(0.0051, False), (0.00491234, True)])
def test_a_bend_of_less_than_five_micrometres_is_in_another_unit(most_mm: float, *, is_told: bool) -> None:
    said = (
        f"by its table, the structure bends by {1e3 * most_mm:.3g} um only; if the table is in m, multiply its "
        "deflections by 1000; if it is in another unit, name it, as s1_deflection_uV/V"
    )
    assert told(most_mm=most_mm) == [said] * is_told


def test_places_that_are_guessed_are_told() -> None:
    """Each sensor is drawn at the load under which it shows most."""
    (said,) = told(curved=False)
    shown = {"a": PLACES[np.sin(PLACES / 150).argmax()], "b": PLACES[np.abs(np.cos(PLACES / 400)).argmax()]}
    places = ", ".join(f"{name} {place:g}" for name, place in sorted(shown.items(), key=lambda each: each[1]))
    assert said.startswith("the table does not say where sensors stand, so each is drawn where it shows most: ")
    assert set(said.removesuffix(" mm").split("most: ")[1].split(" mm;")[0].split(", ")) == set(places.split(", "))


def test_a_further_sensor_is_one_of_the_table_or_is_to_be_measured() -> None:
    """Of two that were measured; where all of them take part, they cannot be placed otherwise."""
    one, two = (weak_spot(model_of(channels=n, min_channels=n).metadata, scene_of()) for n in (1, 2))
    assert one == "one failed sensor ends this surface: it has no other; use more of the sensors that were measured"
    assert two == (
        "one failed sensor ends this surface: all 2 channels must work; measure a further sensor under all loads"
    )


def test_sensors_whose_places_are_not_stated_are_drawn_where_they_show_most() -> None:
    rows = ("20,4,0.1,0.2", "123.456,4,0.4,0.3", "210,4,0.3,0.2", "480,4,0.2,0.5")
    loads = "\n".join(("position_mm,force_n,a_deflection_mm,b_deflection_mm", *rows))
    scene = make_scene(
        measured={"influence": loads, "length_mm": 500},
        contact={"force_n": [2, 8], "position_mm": [30, 450]},
        sensors={"noise_mm": 1e-7, "range_mm": [1, 900]},
    )
    (said,) = [one for one in remarks(scene) if "where sensors stand" in one]
    assert "each is drawn where it shows most: a 123.5, b 480 mm;" in said
