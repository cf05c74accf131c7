"""Every sentence that a test says it holds stands in its page; `make check` compares the table of them."""

import pytest

from promises import MARK, TESTS, plain, promises

PAGES = sorted({promise.page for promise in promises()})


@pytest.mark.parametrize("page", PAGES)
def test_a_promise_that_a_test_holds_stands_in_its_page(page: str) -> None:
    gone = [f"{one.test}: {one.sentence}" for one in promises() if one.page == page and one.sentence not in plain(page)]

    assert gone == []


def test_every_mark_is_read() -> None:
    """A mark elsewhere than above a function of a file would be in no table."""
    marks = sum(path.read_text(encoding="utf-8").count(f"@{MARK}(") for path in TESTS.rglob("*.py"))

    assert marks == len({(one.test, one.page) for one in promises()}) > 0
