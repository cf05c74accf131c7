"""Parts of the reference that come from the programs are as the programs make them: a page shows each change."""

from collections.abc import Callable

import pytest

import facts
from helps import registers
from stubs import python_interface
from support.pages.pasted import ROOT


@pytest.mark.parametrize(
    ("page", "made"),
    [
        ("docs/how-to/opcua.md", facts.opcua_variables),
        ("docs/reference/metrics.md", facts.metrics),
        ("docs/reference/python.md", python_interface),
        ("docs/reference/registers.md", registers),
    ],
)
def test_a_page_has_the_part_as_the_program_makes_it(page: str, made: Callable[[], str]) -> None:
    assert " ".join(made().split()) in " ".join((ROOT / page).read_text().split())
