"""A machine with a single extra of the distribution: the extra brings what the modules of its command import."""

import sys
from functools import cache
from importlib.metadata import packages_distributions, requires

import grimp
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

MODBUS_SERVER = ("beamtouch_service.outputs.modbus.requests", "beamtouch_service.outputs.modbus.server")
"""What needs pymodbus."""
MQTT, OPCUA = ("beamtouch_service.outputs.mqtt.",), ("beamtouch_service.outputs.opcua.",)
"""What needs a client or a server of these: whole folders. `outputs` imports their sections, which need none."""
DISTRIBUTIONS = cache(packages_distributions)
"""Those of each module that is installed; it takes a second to ask."""
OPTIONAL = {"distributed"}
"""What a module asks for only if an option needs it, and names its extra."""
PACKAGES = tuple(f"beamtouch_{name}" for name in ("daemon", "service", "models", "protocol", "common"))


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


@cache
def imports() -> grimp.ImportGraph:
    """Return which module imports which; it takes seconds to read all of them."""
    return grimp.build_graph(
        *PACKAGES, include_external_packages=True, exclude_type_checking_imports=True, cache_dir=None
    )


def imported(package: str, without: tuple[str, ...]) -> set[str]:
    """Return the modules of other distributions that a package imports anywhere, also through our other packages."""
    graph = imports()
    names = [name for name in graph.modules if f"{name}.".startswith(f"{package}.") and not name.startswith(without)]
    ahead, seen = [name for name in names if not name.endswith("__main__")], set[str]()
    while ahead:
        module = ahead.pop()
        if module not in seen and module.startswith(PACKAGES):
            parent = module.rpartition(".")[0]
            ahead += [*graph.find_modules_directly_imported_by(module), *([parent] if parent else [])]
        seen.add(module)
    return {name for name in seen if not name.startswith(PACKAGES)} - sys.stdlib_module_names - OPTIONAL


def missing(extra: str, package: str, without: tuple[str, ...]) -> set[str]:
    """Return the modules that a package imports and its extra does not bring."""
    there, distributions = needed("beamtouch", frozenset(extra.split(","))), DISTRIBUTIONS()
    found = imported(package, without)
    return {name for name in found if not there & set(map(canonicalize_name, distributions[name]))}


@pytest.mark.parametrize(
    ("extra", "package", "without"),
    [
        ("daemon", "beamtouch_daemon", ()),
        ("service", "beamtouch_service", (*MODBUS_SERVER, *MQTT, *OPCUA)),
        ("service,modbus-server", "beamtouch_service.outputs", (*MQTT, *OPCUA)),
        ("service,mqtt", "beamtouch_service.outputs", (*MODBUS_SERVER, *OPCUA)),
        ("service,opcua", "beamtouch_service.outputs", (*MODBUS_SERVER, *MQTT)),
        ("design", "beamtouch_models", ("beamtouch_models.lab.rig",)),
        ("rig", "beamtouch_models.lab.rig", ()),
    ],
)
def test_a_command_needs_its_own_extra_only(extra: str, package: str, without: tuple[str, ...]) -> None:
    assert imported(package, without)
    assert missing(extra, package, without) == set()


def test_the_servers_and_clients_of_a_service_have_extras_of_their_own() -> None:
    assert missing("service", "beamtouch_service", ("-",)) == {"asyncua", "cryptography", "paho", "pymodbus"}
