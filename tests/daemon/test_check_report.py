"""What `check` says of readings that came: digits, complaints, causes, and what limits the readings."""

from dataclasses import replace
from pathlib import Path

import pytest

from beamtouch_daemon.commands.check import ChannelCheck, SurfaceCheck, _as_json, _channels, _lines, _readings_of
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.measuring.byte_orders import find_byte_orders
from beamtouch_daemon.sources.reading import Reading
from beamtouch_service.samples import Quality

from .surfaces import surface_of

SERIAL = {"kind": "serial", "port": "/dev/x"}
GOOD = ChannelCheck("s1", 20_345.0, 2.4655, 0.0345, Quality.GOOD, 4, "mm")
MISSING = ChannelCheck("s2", None, None, None, Quality.MISSING, 4, "mm")
FULL = ChannelCheck("s3", 65_535.0, -2.0535, 4.5535, Quality.SATURATED, 4, "mm")
FAR = replace(FULL, channel="s4", quality=Quality.OUT_OF_RANGE)
BENCH = SurfaceCheck("bench", Path("daemon.toml"), (GOOD,))


@pytest.mark.parametrize(
    ("surface", "readings"),
    [
        (surface_of(rate_hz=200.0), 30),
        (surface_of(rate_hz=10.0), 30),
        (surface_of(rate_hz=9.5), 28),  # 3 s
        (surface_of(rate_hz=0.1), 1),
        (surface_of(source=SERIAL), 1),
    ],
)
def test_a_unit_that_is_polled_is_read_so_often_that_failing_requests_show(surface: Surface, readings: int) -> None:
    assert _readings_of(surface) == readings


def test_lengths_have_the_decimals_of_a_count_or_of_the_noise() -> None:
    reading = Reading(0.0, (20_345.2, None, 65_535.0))
    first, second, third = _channels(surface_of(3), {"s1": 2.6}, reading)
    assert (first.counts, first.gap_mm, first.deflection_mm, first.quality) == (20_345.2, 2.4655, 0.1345, Quality.GOOD)
    assert (second.counts, second.gap_mm, second.deflection_mm) == (None, None, None)
    assert (second.quality, third.quality, third.deflection_mm) == (Quality.MISSING, Quality.SATURATED, 4.5535)
    assert (first.decimals, first.unit) == (4, "mm")
    (noisy, *_) = _channels(surface_of(3, noise_mm=0.02), {}, reading)
    assert (noisy.gap_mm, noisy.deflection_mm, noisy.decimals) == (2.47, 0.03, 2)


@pytest.mark.parametrize(
    ("check", "complaints"),
    [
        (BENCH, []),
        (
            replace(BENCH, channels=(GOOD, MISSING, FULL, replace(MISSING, channel="s9"), FAR)),
            [
                "s4 out-of-range: the gap is outside range_mm; take everything off the beam, or correct the "
                "characteristic",
                "s3 saturated: the counts stand at an end, or near 0 as without a cable; check the wiring, and "
                "counts_range",
                "s2, s9 missing: the device sent no value, NaN or more than 1e12; check unit, register (from 0), type, "
                "byte_order",
            ],
        ),
        (
            replace(BENCH, channels=(), error="no device", observed="not a byte came", refusal="No."),
            ["no device; not a byte came", "No."],
        ),
        (
            replace(BENCH, byte_orders=("CDAB", "DCBA")),
            ['with byte_order = "CDAB" or "DCBA" the values would be good; correct byte_order of the source'],
        ),
        (replace(BENCH, failing=("3 of 30 fail", "9 of 30 fail")), []),
        (
            replace(BENCH, failing=("3 of 30 fail", "9 of 30 fail"), is_unreliable=True),
            ["3 of 30 fail", "9 of 30 fail"],
        ),
    ],
)
def test_what_prevents_readings_or_samples_is_complained_of(check: SurfaceCheck, complaints: list[str]) -> None:
    assert list(check.complaints()) == complaints


@pytest.mark.parametrize(
    ("check", "awaited"),
    [
        (BENCH, ""),
        (replace(BENCH, channels=(GOOD, FULL)), ""),
        (replace(BENCH, channels=(GOOD, MISSING), refusal="No."), "not all channels arrive"),
        (replace(BENCH, refusal="No."), "No."),
        (replace(BENCH, channels=(), error="no device", observed="text"), "no device"),
    ],
)
def test_what_may_still_come_is_waited_for(check: SurfaceCheck, awaited: str) -> None:
    assert check.awaited == awaited


NOT_TARED = (
    "bench: not tared: the rest gaps are those of the configuration; run beamtouch-daemon tare, with nothing on "
)


def test_the_table_has_the_unit_in_its_head_and_below_it_what_limits_the_readings() -> None:
    check = replace(
        BENCH,
        channels=(GOOD, MISSING),
        is_tared=False,
        limits=("Old ones pass.",),
        failing=("3 of 30 fail",),
        doubt="?",
    )
    head, first, second, *texts = _lines([check], with_files=False)
    assert head.split() == ["surface", "channel", "counts", "gap", "mm", "deflection", "mm", "quality"]
    assert first.split() == ["bench", "s1", "20345", "2.4655", "0.0345", "good"]
    assert second.split() == ["bench", "s2", "-", "-", "-", "missing"]
    for title, figure in (("counts", "20345"), ("gap mm", "2.4655"), ("deflection mm", "0.0345")):
        assert head.index(title) + len(title) == first.index(figure) + len(figure)  # numbers stand to the right
    assert head.index("quality") == first.index("good") == second.index("missing")
    assert texts == ["bench: Old ones pass.", "bench: 3 of 30 fail", f"{NOT_TARED}the beam", "bench: ?"]
    assert [*_lines([replace(check, is_unreliable=True)], with_files=False)][4].startswith("bench: not tared")


def test_several_units_stand_behind_the_figures_and_several_files_in_a_column() -> None:
    field = replace(GOOD, channel="m1", gap_mm=45.25, deflection_mm=-3.5, decimals=2, unit="uT")
    hall = SurfaceCheck("hall", Path("hall.toml"), (field,))
    head, *rows = _lines([BENCH, hall], with_files=True)
    assert head.split() == ["surface", "channel", "counts", "gap", "deflection", "quality", "file"]
    assert rows[0].split() == ["bench", "s1", "20345", "2.4655", "mm", "0.0345", "mm", "good", "daemon.toml"]
    assert rows[1].split() == ["hall", "m1", "20345", "45.25", "uT", "-3.50", "uT", "good", "hall.toml"]
    (head, _) = _lines([hall], with_files=False)
    assert head.split() == ["surface", "channel", "counts", "value", "uT", "deflection", "uT", "quality"]


def test_the_json_of_a_surface_has_all_channels_and_what_the_service_said() -> None:
    check = replace(BENCH, channels=(GOOD, MISSING), doubt="?", failing=("3 of 30 fail",), limits=("Old.",))
    content = _as_json(check, asked=True)
    first = {"channel": "s1", "counts": 20_345, "gap_mm": 2.4655, "deflection_mm": 0.0345, "quality": "good"}
    second = {"channel": "s2", "counts": None, "gap_mm": None, "deflection_mm": None, "quality": "missing"}
    assert content == {
        "file": "daemon.toml",
        "error": None,
        "channels": [first | {"unit": "mm"}, second | {"unit": "mm"}],
        "limits": ("Old.",),
        "tared": True,
        "failing": ("3 of 30 fail",),
        "service": "takes samples",
        "doubt": "?",
    }
    assert _as_json(replace(check, refusal="No."), asked=True)["service"] == "No."
    assert _as_json(check, asked=False)["service"] is None
    absent = _as_json(replace(check, channels=(), error="no device", observed="text"), asked=False)
    assert (absent["error"], absent["channels"]) == ("no device; text", [])


FLOATS = {"type": "f32", "gain_mm_per_count": 1.0, "offset_mm": 0.0}


def test_the_byte_order_with_which_most_values_are_gaps_is_found() -> None:
    exchanged = [2.3e-41, 2.3e-41, 2.3e-41]  # 0x0000 0x4020, of which the words are those of 2.5
    surface = surface_of(3, FLOATS)
    assert find_byte_orders(surface, exchanged) == ["CDAB"]
    assert find_byte_orders(surface, [*exchanged[:2], 7e8]) == ["CDAB"]  # two of three
    assert find_byte_orders(surface, [exchanged[0], 7e8, None]) == []  # one of two
    assert find_byte_orders(surface, [exchanged[0], None, None]) == ["CDAB"]
    assert find_byte_orders(surface, [*exchanged[:2], 2.5]) == []  # one is good as it is
    assert find_byte_orders(surface, [None, None, None]) == []


def test_byte_orders_are_sought_only_of_modbus_and_of_values_in_several_registers() -> None:
    assert find_byte_orders(surface_of(2), [0.0, 0.0]) == []
    assert find_byte_orders(surface_of(2, source=SERIAL), [0.0, 0.0]) == []
