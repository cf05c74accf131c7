"""Registers of real surfaces, filled at the moment of reading."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

from beamtouch_models import modelfile
from beamtouch_service.outputs.modbus.blocks import Blocks, NoSuchRegisterError
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.surface import Surface
from contact_registers import FIGURES, decoded, expected, number

if TYPE_CHECKING:
    from pathlib import Path

    from beamtouch_service.outputs.modbus.section import WordOrder

    from .conftest import BuildModel

Parse = Callable[..., Batch]
NOW_S = 1000.0
CHANNELS = ["s1", "s2", "s3"]
TOUCH, CLEAR, ODD = [0.2, 0.3, 0.3], [0.0, 0.0, 0.0], [0.2, 0.2, 0.4]


def surface_of(path: Path, name: str = "press-7") -> Surface:
    return Surface(name, modelfile.load(path))


def block(surface: Surface, now_s: float = NOW_S, word_order: WordOrder = "big") -> list[int]:
    return Blocks([surface], word_order).read(0, 50, now_s)


@pytest.fixture
def surface(build_model: BuildModel) -> Surface:
    return surface_of(build_model())


@pytest.mark.parametrize("word_order", ["big", "little"])
@pytest.mark.parametrize("row", [TOUCH, CLEAR, ODD, [2.4, 0.1, 0.05], [0.2, None, 0.3]])
def test_a_block_says_what_the_contact_says(
    surface: Surface, parse_batch: Parse, word_order: WordOrder, row: list[float | None]
) -> None:
    quality = ["good" if value is not None else "missing" for value in row]
    surface.receive(parse_batch(*[row] * 4, sequence=2**32 + 70_000, quality=quality), NOW_S)

    words = block(surface, NOW_S + 0.0123, word_order)
    contact: dict[str, Any] = surface.contact(NOW_S + 0.0123).model_dump(mode="json")
    assert decoded(words, CHANNELS, word_order) == expected(contact | {"sequence": 70_003})
    assert words[4] == 13
    assert words[42:] == [0] * 8


def test_the_channel_that_contradicts_the_others_has_its_bit(build_model: BuildModel, parse_batch: Parse) -> None:
    surface = surface_of(build_model(channels=4))
    surface.receive(parse_batch([0.0] * 4, *[[0.5, 0.25, 0.75, 0.125]] * 60), NOW_S)
    assert surface.contact(NOW_S).notes == ["check-s3"]

    words = block(surface)
    assert (words[2], words[3], words[22:26]) == (3, 0, [0b100, 0, 0, 0])


def test_each_quality_has_its_bits_in_the_order_of_the_model(build_model: BuildModel, parse_batch: Parse) -> None:
    surface = surface_of(build_model(channels=40, min_channels=1))
    bad = {0: "out-of-range", 15: "saturated", 16: "stuck", 39: "missing"}
    names = [f"s{place + 1}" for place in range(40)]
    row = [0.01] * 39 + [None]
    # The batch has another order than the model.
    quality = [bad.get(place, "good") for place in range(40)]
    surface.receive(parse_batch(row[::-1], channels=names[::-1], quality=quality[::-1]), NOW_S)

    words = block(surface)
    assert words[26:30] == [1, 0, 0, 0]
    assert words[30:34] == [1 << 15, 0, 0, 0]
    assert words[34:38] == [0, 1, 0, 0]
    assert words[38:42] == [0, 0, 1 << 7, 0]


def test_a_surface_that_is_stale_gives_no_figure_and_no_bit(surface: Surface, parse_batch: Parse) -> None:
    surface.receive(parse_batch(*[[0.2, None, 0.3]] * 3, quality=["good", "missing", "good"]), NOW_S)
    fresh, at_limit, stale = block(surface), block(surface, NOW_S + 0.5), block(surface, NOW_S + 0.5001)

    assert fresh[2] == at_limit[2] == 2
    assert (at_limit[4], at_limit[8:20]) == (500, fresh[8:20])
    assert (stale[2], stale[3], stale[5]) == (18, 0, 0)
    assert {number(stale[offset : offset + 2], ">f") for offset in FIGURES.values()} == {None}
    assert stale[22:50] == [0] * 28
    assert block(surface, NOW_S + 1e6)[4] == 65_535


def test_a_surface_without_an_answer_says_why(build_model: BuildModel, parse_batch: Parse) -> None:
    without_model, without_samples = Surface("a", None), surface_of(build_model())
    too_few, unusable = surface_of(build_model()), surface_of(build_model())
    without_model.receive(parse_batch(TOUCH, sequence=9), NOW_S)
    too_few.receive(parse_batch([0.2, None, None], quality=["good", "missing", "missing"]), NOW_S)
    unusable.receive(parse_batch([0.5, 1.0, 0.5]), NOW_S)

    found = [block(one) for one in (without_model, without_samples, too_few, unusable)]
    assert [words[2] for words in found] == [16, 17, 19, 20]
    assert [words[4] for words in found] == [0, 65_535, 0, 0]
    assert [words[7] for words in found] == [9, 0, 1, 1]
    assert [words[38] for words in found] == [0, 0, 0b110, 0]
    for words in found:
        assert {number(words[offset : offset + 2], ">f") for offset in FIGURES.values()} == {None}


def test_the_heartbeat_counts_tenths_of_a_second(surface: Surface) -> None:
    assert [block(surface, second)[1] for second in (12.3, 12.4, 6553.5, 6553.6)] == [123, 124, 65_535, 0]


def test_a_read_over_borders_holds_each_block_as_it_is(build_model: BuildModel, parse_batch: Parse) -> None:
    first, second = surface_of(build_model(), "a"), Surface("b", None)
    first.receive(parse_batch(TOUCH), NOW_S)
    blocks = Blocks([first, second, first], "big")
    whole = blocks.read(0, 150, NOW_S)

    assert whole == block(first) + block(second) + block(first)
    for address, count in ((0, 1), (8, 2), (9, 1), (49, 2), (45, 100), (50, 50), (99, 51), (149, 1)):
        assert blocks.read(address, count, NOW_S) == whole[address : address + count]


@pytest.mark.parametrize(("address", "count"), [(100, 1), (99, 2), (0, 101), (65_535, 1), (65_535, 125)])
def test_an_address_of_no_surface_is_refused(surface: Surface, address: int, count: int) -> None:
    with pytest.raises(NoSuchRegisterError):
        Blocks([surface, surface], "big").read(address, count, NOW_S)


def test_surfaces_that_are_added_leave_the_others_where_they_are(build_model: BuildModel) -> None:
    one, two, three = (surface_of(build_model(), name) for name in ("z", "b", "a"))
    assert Blocks([one, two, three], "big").read(0, 100, NOW_S) == Blocks([one, two], "big").read(0, 100, NOW_S)
