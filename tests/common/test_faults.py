"""The list of faults that tests must catch fits the tree; `make faults` tries them."""

from fault_list import ROOT, read_faults


def test_the_list_of_faults_fits_the_tree() -> None:
    faults = read_faults()
    assert len({fault.promise for fault in faults}) == len(faults)
    tests = {test.partition("::")[0] for fault in faults for test in fault.tests}
    assert [test for test in sorted(tests) if not (ROOT / test).is_file()] == []
    assert [fault for fault in faults if fault.before == fault.after] == []
