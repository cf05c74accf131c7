"""Which tests run in one process: those of modules whose fixtures take long, so that these are made once per run."""

from xdist.scheduler import LoadScopeScheduling

TOGETHER = (
    "common/test_extras.py",
    "daemon/test_asked_service.py",
    "models/test_build_report.py",
    "models/test_calibration.py",
    "models/test_false_alarms.py",
    "models/test_measured_skins.py",
    "models/test_rig.py",
    "models/test_rig_serial.py",
    "models/test_self_calibration.py",
    "models/test_since_touch.py",
    "models/test_small_network.py",
    "models/test_trade.py",
    "models/test_units.py",
    # Pages share a browser; started for each test, it would take longer than most of them. One for all modules would
    # keep its event loop running beside other tests.
    "models/test_pictures.py",
    "process/test_page.py",
    "process/test_page_beam.py",
    "process/test_page_behind_proxies.py",
    "process/test_page_commissioning.py",
    "process/test_page_doubt.py",
    "process/test_page_plate.py",
    "process/test_page_token.py",
    "system/test_images.py",
)


class Scheduling(LoadScopeScheduling):  # type: ignore[misc]  # xdist ships no types
    """Gives each test to whichever process is free, but the modules of `TOGETHER` whole.

    The mark `xdist_group` would say the same, but with pytest 9.2 the scheduler never sees it: the tests of a group
    would be spread over all processes, without an error.
    """

    def _split_scope(self, nodeid: str) -> str:
        module = nodeid.partition("::")[0]
        return module if module.endswith(TOGETHER) else nodeid
