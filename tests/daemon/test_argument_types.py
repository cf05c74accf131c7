"""Arguments of the commands: addresses, lists of units, of baud rates and of parities, times."""

from argparse import ArgumentTypeError
from collections.abc import Callable

import pytest

from beamtouch_common.errors import InputError
from beamtouch_daemon.argument_types import address_of, bauds, between, numbers, parities, ranges


@pytest.mark.parametrize(
    ("text", "address"),
    [("tcp://192.168.0.20", ("192.168.0.20", 502)), ("tcp://plc:1502", ("plc", 1502)), ("tcp://[::1]:7", ("::1", 7))],
)
def test_an_address_has_port_502_unless_it_states_another(text: str, address: tuple[str, int]) -> None:
    assert address_of(text) == address


def test_what_is_no_address_is_said() -> None:
    with pytest.raises(InputError) as raised:
        address_of("192.168.0.20:502")
    assert str(raised.value) == (
        "'192.168.0.20:502' is not an address; give tcp://HOST[:PORT], such as tcp://192.168.0.20:502"
    )


@pytest.mark.parametrize(
    ("text", "units"),
    [
        ("7", (7,)),
        ("0", (0,)),
        ("255", (255,)),
        ("3-6", (3, 4, 5, 6)),
        ("6-6", (6,)),
        ("20, 3-5,4", (20, 3, 4, 5)),  # in this order, each once
    ],
)
def test_a_list_of_units_may_have_ranges(text: str, units: tuple[int, ...]) -> None:
    assert numbers(text) == units


@pytest.mark.parametrize("text", ["", "256", "250-256", "6-3", "1,,2", "a", "-3", "1000", "2-", "²"])
def test_what_is_no_list_of_units_is_refused(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match="is not a list of unit numbers from 0 to 255, such as 1-16 or 1,2,20"):
        numbers(text)


@pytest.mark.parametrize(
    ("units", "text"),
    [((), ""), ((7,), "7"), ((3, 4), "3-4"), ((1, 2, 3, 255), "1-3, 255"), ((9, 3, 4, 6, 7, 8), "9, 3-4, 6-8")],
)
def test_units_are_shown_as_ranges(units: tuple[int, ...], text: str) -> None:
    assert ranges(units) == text


def test_baud_rates_and_parities_are_each_taken_once_in_their_order() -> None:
    assert bauds("19200, 9600,19200,300,12000000") == (19_200, 9600, 300, 12_000_000)
    assert parities("odd, none,odd") == ("odd", "none")


@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [
        *((bauds, text, "baud rates, such as 9600,19200") for text in ("299", "12000001", "9600,", "-9600", "9600.0")),
        (bauds, "1" * 5000, "baud rates, such as 9600,19200"),  # more digits than Python converts
        (bauds, "९६००", "baud rates, such as 9600,19200"),
        *((parities, text, "parities; choose of none,even,odd") for text in ("", "mark", "even,odd,space")),
    ],
)
def test_what_is_no_list_of_settings_is_refused(
    kind: Callable[[str], tuple[object, ...]], text: str, said: str
) -> None:
    with pytest.raises(ArgumentTypeError) as raised:
        kind(text)
    assert str(raised.value) == f"{text!r} is not a list of {said}"


def test_a_number_is_taken_up_to_both_ends_of_its_range() -> None:
    of_seconds = between(-2.5, 90.0, "seconds")
    assert [of_seconds(text) for text in ("-2.5", "3.25", "90")] == [-2.5, 3.25, 90.0]
    for text in ("-2.6", "90.001", "nan", "inf", "soon"):
        with pytest.raises(ArgumentTypeError) as raised:
            of_seconds(text)
        assert str(raised.value) == f"{text!r} is not a number of seconds from -2.5 to 90"
