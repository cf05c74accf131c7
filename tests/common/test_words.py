"""Small things as people read them: spans of time, units, differences, values of objects, names and outlines."""

from dataclasses import dataclass, field

import pytest
from pydantic import TypeAdapter, ValidationError

from beamtouch_common.digits import Rounded, decimals_of, digits, rounded
from beamtouch_common.hosts import host_name, tcp_address
from beamtouch_common.names import name_like
from beamtouch_common.outline import Outline, Span, axes_of, kind_of, names_of
from beamtouch_common.spans import apart, are_apart, span
from beamtouch_common.units import Unit, direction_of, fine, fine_unit, plain


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.0, "0 s"),
        (119.0, "119 s"),
        (120.0, "2 minutes"),
        (7199.0, "120 minutes"),
        (7200.0, "2 hours"),
        (172_799.0, "48 hours"),
        (172_800.0, "2 days"),
        (10 * 86_400.0, "10 days"),
        (-7200.0, "-2 hours"),
    ],
)
def test_a_span_has_the_largest_unit_of_which_there_are_two(seconds: float, text: str) -> None:
    assert span(seconds) == text


def test_clocks_are_apart_from_a_minute_on() -> None:
    assert [are_apart(seconds) for seconds in (60.0, 60.5, -60.0, -61.0)] == [False, True, False, True]
    assert (apart(7200.0), apart(-150.0)) == ("2 hours ahead of", "2 minutes behind")


def test_small_lengths_are_in_um_and_other_small_values_in_their_unit() -> None:
    assert (fine_unit("mm"), fine_unit("uV/V")) == (("um", 1000.0), ("uV/V", 1.0))
    assert (fine(0.0123456, "mm"), fine(1.23456, "uV/V"), fine(1.23456, "N", 2)) == ("12.3 um", "1.23 uV/V", "1.2 N")
    assert (direction_of("mm"), direction_of("uV/V")) == (-1.0, 1.0)
    assert (plain("\u00b5m"), plain("\u03bcm"), plain("mm")) == ("um", "um", "mm")


@pytest.mark.parametrize(
    ("smallest", "decimals"), [(25.0, 0), (1.0, 0), (0.9, 1), (0.1, 1), (0.02, 2), (2e-6, 6), (1e-9, 6), (0.0, 6)]
)
def test_a_number_has_the_decimals_that_show_the_smallest_change(smallest: float, decimals: int) -> None:
    assert decimals_of(smallest) == decimals


@pytest.mark.parametrize(
    ("value", "count", "text"),
    [(1e-6, 3, "0.000001"), (9_999_000.0, 4, "9999000"), (9_999_900.0, 4, "1e+07"), (0.00012, 4, "0.00012")],
)
def test_numbers_are_plain_up_to_ten_million_and_down_to_a_millionth(value: float, count: int, text: str) -> None:
    assert digits(value, count) == text


@dataclass(repr=False)
class Seen(Rounded):
    """An object with a list that is too long, and a field that it does not show."""

    first: float
    rest: list[float]
    hidden: int = field(default=5, repr=False)


def test_the_text_of_an_object_has_four_digits_and_eight_entries_of_a_list() -> None:
    assert repr(Seen(1.23456, [0.5] * 8)) == f"Seen(first=1.235, rest=[{', '.join(['0.5'] * 8)}])"
    assert repr(Seen(2, [0.5] * 9)) == f"Seen(first=2, rest=[{', '.join(['0.5'] * 8)}, ... 9 in all])"
    assert rounded({"a": (1.23456, "b")}) == "{'a': (1.235, 'b')}"


def test_an_interval_is_widened_on_each_side_by_its_own_half() -> None:
    assert Span(10.0, 8.0, 13.0).widened(2.0) == (6.0, 16.0)


def test_outlines_in_words_and_what_lies_on_them() -> None:
    beam, plate = Outline.of_beam(400.5), Outline({"x": 400.0, "y": 300.0})
    assert (str(beam), str(plate)) == ("a beam of 400.5 mm", "a plate of 400 by 300 mm")
    assert (axes_of(1), axes_of(2)) == (("position",), ("x", "y"))
    assert (kind_of(["position"]), kind_of(["x", "y"])) == ("beam", "plate")
    assert names_of("force", "n") == ("force_n", "force_low_n", "force_high_n")
    assert beam.clip("position", -3.0, 500.0) == (0.0, 400.5)
    assert plate.clip("y", 7.0, 299.0) == (7.0, 299.0)
    on = Span(0.0, -5.0, 0.0)
    assert plate.find_miss({"x": on, "y": Span(310.0, 300.0, 320.0)}) is None  # each reaches a rim
    assert plate.find_miss({"x": Span(-3.0, -5.0, -0.1), "y": on}) == "x"
    assert plate.find_miss({"x": on, "y": Span(310.0, 300.1, 320.0)}) == "y"


def test_a_name_resembles_a_text() -> None:
    assert name_like("..Press 7/left", "model") == "Press-7-left"
    assert (name_like("...", "model"), name_like("", "model")) == ("model", "model")
    assert name_like("a" * 80, "model") == "a" * 64


@pytest.mark.parametrize("text", ["localhost", "192.168.0.20", "fe80::1", "a-b.example", "[::1]"[1:-1]])
def test_names_and_addresses_of_hosts_are_taken(text: str) -> None:
    assert host_name(text) == text


@pytest.mark.parametrize("text", ["", "a b", "a:80", "tcp://a", "a/b", "a,b", "a..b", "a\tb", "a@b", "a?", "a#", "[a]"])
def test_what_is_no_host_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="must be the name or address of a host"):
        host_name(text)


def test_an_address_of_tcp_has_a_host_and_may_have_a_port() -> None:
    assert tcp_address("tcp://10.0.0.7:502") == ("10.0.0.7", 502)
    assert tcp_address("tcp://plc/") == ("plc", None)
    for text in ("udp://plc:502", "tcp://plc:502/x", "tcp://plc:502?x=1", "tcp://plc:0", "plc:502"):
        with pytest.raises(ValueError, match="must be tcp://HOST:PORT"):
            tcp_address(text)
    with pytest.raises(ValueError, match="name or address of a host"):
        tcp_address("tcp://:502")


@pytest.mark.parametrize(
    ("unit", "size"), [("nm", "1e-06"), ("um", "0.001"), ("cm", "10"), ("m", "1000"), ("\u03bcm", "0.001")]
)
def test_another_unit_of_a_length_is_refused_with_its_size(unit: str, size: str) -> None:
    name = plain(unit)
    with pytest.raises(ValidationError, match=f"lengths are in mm, not {name}; one {name} is {size} mm"):
        TypeAdapter(Unit).validate_python(unit)


@pytest.mark.parametrize(("unit", "taken"), [("mm", "mm"), ("\u00b5V/V", "uV/V"), ("%", "%"), ("a" * 16, "a" * 16)])
def test_a_unit_has_up_to_sixteen_letters(unit: str, taken: str) -> None:
    assert TypeAdapter(Unit).validate_python(unit) == taken
    with pytest.raises(ValidationError):
        TypeAdapter(Unit).validate_python(unit + "a" * 16)
