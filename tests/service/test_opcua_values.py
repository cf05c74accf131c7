"""Status codes over OPC UA where there is no contact to judge: every variable says why."""

from datetime import UTC, datetime

import pytest
from asyncua import ua
from asyncua.ua.ua_binary import variant_to_binary

from beamtouch_common.zones import Zone
from beamtouch_models.runtime import State
from beamtouch_models.runtime.metadata import POSITION_OUTPUTS
from beamtouch_service.fields import Field
from beamtouch_service.outputs.opcua.values import values, variable_of
from beamtouch_service.problems import ProblemError
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.surface import Surface
from service.bench import Row, parsed, surface_of, surface_with

NOW_S = 1000.0
TOUCHED: Row = [0.5, 0.25, 0.125, 0.0]
WEDGED: Row = [0.5, 0.25, 0.75, 0.125]
ZONED = SurfaceSection(zones={"gate": Zone(from_mm=120, to_mm=200)})


def codes(surface: Surface, now_s: float = NOW_S) -> dict[str, str]:
    return {name: one.StatusCode.name for name, one in values(surface, now_s, datetime.now(UTC)).items()}


@pytest.mark.promise(
    "docs/how-to/opcua.md",
    "the newest sample is too old",
    "too few channels work, or the model gave no usable answer",
)
@pytest.mark.parametrize(
    ("row", "age_s", "code"),
    [
        ([0.5, 0.25, 0.125], 0.5001, "BadNoCommunication"),
        ([0.2, None, None], 0.0, "BadSensorFailure"),
        ([0.5, 1.0, 0.5], 0.0, "BadSensorFailure"),  # off the beam
    ],
    ids=["stale", "too few channels", "no usable answer"],
)
def test_without_a_contact_every_variable_says_why(row: Row, age_s: float, code: str) -> None:
    surface = surface_of(section=ZONED)
    surface.receive(parsed(row, quality=["missing" if value is None else "good" for value in row]), NOW_S)
    found = codes(surface, NOW_S + age_s)
    assert {"state", "force_n", "zones/gate"} < found.keys()
    assert set(found.values()) == {code}


@pytest.mark.promise("docs/how-to/opcua.md", "the surface has no model, or one of another beam")
def test_a_surface_whose_model_is_missing_or_of_another_beam_has_a_wrong_configuration() -> None:
    surface = surface_of()
    with pytest.raises(ProblemError):
        surface.receive(parsed().model_copy(update={"beam": "beam-2"}), NOW_S)
    for one in (surface, surface_with(None)):
        assert set(codes(one).values()) == {"BadConfigurationError"}


@pytest.mark.promise("docs/how-to/opcua.md", "a force that the model does not estimate, a zone without an answer")
def test_what_a_contact_has_as_null_is_bad_beside_good_values() -> None:
    surface = surface_of(section=ZONED, outputs=POSITION_OUTPUTS)
    surface.receive(parsed([0.5, 0.25, 0.125]), NOW_S)
    found = codes(surface)
    assert {name for name, code in found.items() if code == "BadNoData"} == {"force_n", "force_low_n", "force_high_n"}
    assert {code for name, code in found.items() if "force" not in name} == {"Good"}
    # Two channels check no contact, so no zone has an answer.
    surface.receive(parsed([0.5, 0.25, None], sequence=2, quality=["good", "good", "missing"]), NOW_S)
    found = codes(surface)
    assert (found["zones/gate"], found["position_mm"]) == ("BadNoData", "UncertainSubNormal")


@pytest.mark.parametrize(
    ("rows", "quality", "notes", "code"),
    [
        ([TOUCHED], None, [], "Good"),
        ([TOUCHED], None, ["rate"], "UncertainSubNormal"),
        ([[0.5, 0.25, None, 0.0]], ["good", "good", "missing", "good"], [], "UncertainSubNormal"),
        ([WEDGED] * 9, None, [], "UncertainSubNormal"),
        ([[0.0] * 4], None, [], "Good"),
    ],
    ids=["contact", "note", "a channel is bad", "unexplained", "clear"],
)
def test_only_a_state_of_all_channels_without_a_note_is_good(
    rows: list[Row], quality: list[str] | None, notes: list[str], code: str
) -> None:
    surface = surface_of(channels=4)
    batch = parsed(*rows, quality=quality)
    surface.receive(type(batch).model_validate(batch.model_dump() | {"notes": notes}), NOW_S)
    assert codes(surface)["state"] == code


def test_a_value_has_the_time_of_its_sample_and_without_one_that_of_the_service() -> None:
    now = datetime(2026, 11, 20, 23, 41, tzinfo=UTC)
    surface = surface_of()
    found = values(surface, NOW_S, now)["state"]
    assert (found.SourceTimestamp, found.ServerTimestamp) == (now, now)
    surface.receive(parsed([0.5, 0.25, 0.125]), NOW_S)
    found = values(surface, NOW_S, now)["state"]
    assert found.SourceTimestamp == datetime(2026, 11, 20, 23, 40, 46, 123_000, UTC)
    assert found.ServerTimestamp == now


@pytest.mark.parametrize(
    ("kind", "value", "variant"),
    [
        (int, 2**40, ua.Variant(2**40, ua.VariantType.UInt64)),
        (int | None, 3, ua.Variant(3, ua.VariantType.UInt64)),
        (bool, False, ua.Variant(False, ua.VariantType.Boolean)),
        (bool | None, True, ua.Variant(True, ua.VariantType.Boolean)),
        (float, 0.5, ua.Variant(0.5, ua.VariantType.Double)),
        (float | None, 0.0, ua.Variant(0.0, ua.VariantType.Double)),
        (str | None, "x", ua.Variant("x", ua.VariantType.String)),
        (State, State.CLEAR, ua.Variant("clear", ua.VariantType.String)),
        (list[str], ["a", "b"], ua.Variant("a b", ua.VariantType.String)),
        (dict[str, float], {"gate": 1.0}, ua.Variant('{"gate": 1.0}', ua.VariantType.String)),
    ],
    ids=str,
)
def test_a_field_has_the_type_of_its_values_also_where_it_may_be_missing(
    kind: object, value: object, variant: ua.Variant
) -> None:
    variable = variable_of(Field("figure", kind, "A figure. And more.", lambda _: value, "mm"))
    assert variable.meaning == "A figure [mm]"
    assert variant_to_binary(ua.Variant(variable.of(None), variable.kind)) == variant_to_binary(variant)
    none = variable_of(Field("figure", kind, "A figure.", lambda _: None))
    assert (none.kind, none.of(None)) == (variable.kind, None)
