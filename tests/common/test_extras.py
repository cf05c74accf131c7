"""A machine with a single extra of the distribution: each module that its command needs can be imported."""

import subprocess
import sys
from functools import cache
from importlib.metadata import packages_distributions, requires

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

IMPORTS = """
import importlib, pkgutil, sys
from importlib.abc import MetaPathFinder

class Absent(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name.partition(".")[0] in {absent!r}:
            raise ModuleNotFoundError(name, name=name)

sys.meta_path.insert(0, Absent())
package = importlib.import_module({package!r})
for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
    if not found.name.startswith({without!r}) and not found.name.endswith("__main__"):
        importlib.import_module(found.name)
        print(found.name)
"""

MODBUS_SERVER = ("beamtouch_service.outputs.modbus.requests", "beamtouch_service.outputs.modbus.server")
"""What needs pymodbus."""
MQTT, OPCUA = ("beamtouch_service.outputs.mqtt.",), ("beamtouch_service.outputs.opcua.",)
"""What needs a client or a server of these: whole folders. `outputs` imports their sections, which need none."""


DISTRIBUTIONS = cache(packages_distributions)
"""Those of each module that is installed; it takes a second to ask."""


def needed(distribution: str, extras: frozenset[str]) -> set[str]:
    """Return the distributions that an installation brings, itself included."""
    found: dict[str, frozenset[str]] = {}
    ahead = [(canonicalize_name(distribution), extras)]
    while ahead:
        name, wanted = ahead.pop()
        if name in found and wanted <= found[name]:
            continue
        found[name] = found.get(name, frozenset()) | wanted
        for text in requires(name) or ():
            requirement = Requirement(text)
            markers = [{"extra": extra} for extra in wanted or {""}]
            if requirement.marker is None or any(map(requirement.marker.evaluate, markers)):
                ahead.append((canonicalize_name(requirement.name), frozenset(requirement.extras)))
    return set(found)


@pytest.mark.parametrize(
    ("extra", "package", "without"),
    [
        ("daemon", "beamtouch_daemon", ()),
        ("service", "beamtouch_service", (*MODBUS_SERVER, *MQTT, *OPCUA)),
        ("service,modbus-server", "beamtouch_service.outputs", (*MQTT, *OPCUA)),
        ("service,mqtt", "beamtouch_service.outputs", (*MODBUS_SERVER, *OPCUA)),
        ("service,opcua", "beamtouch_service.outputs", (*MODBUS_SERVER, *MQTT)),
        ("design", "beamtouch_models", ("beamtouch_models.rig",)),
        ("rig", "beamtouch_models.rig", ()),
    ],
)
def test_a_command_needs_its_own_extra_only(extra: str, package: str, without: tuple[str, ...]) -> None:
    there = needed("beamtouch", frozenset(extra.split(",")))
    absent = {
        module
        for module, distributions in DISTRIBUTIONS().items()
        if not there & {canonicalize_name(name) for name in distributions}
    }
    assert {"pytest", "fastapi" if extra == "daemon" else "aiohttp"} <= absent
    code = IMPORTS.format(absent=absent, package=package, without=without)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("\n") > 1
