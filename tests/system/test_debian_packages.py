"""The Debian packages that `make deb` has built: what they hold, and what they ask of a machine."""

import re
import subprocess
from dataclasses import dataclass
from email import message_from_string
from email.message import Message
from importlib.metadata import distributions
from pathlib import Path

import pytest
from packaging.utils import canonicalize_name

from support.programs.toolchain import made_once, run
from support.running.debian_parts import give_up, require

ROOT = Path(__file__).parents[2]
BUILT = ROOT / "build" / "deb"
DEBIAN = ROOT / "packaging" / "debian"
EXTRAS = ["daemon", "service"]
MAX_MIB = {"daemon": 30, "service": 70}
"""Largest size of a package: a gateway fetches the daemon's over a slow line."""
NEEDED = {"daemon": {"pymodbus", "pyserial"}, "service": {"paho-mqtt", "onnxruntime", "psycopg", "pymodbus"}}
"""Distributions that a source or a section of the configuration needs: they cannot be added later."""
FOREIGN = {"daemon": {"onnxruntime", "fastapi", "sqlalchemy"}, "service": {"aiohttp", "pyserial"}}
"""Distributions that only the other package needs."""
BYTECODE_CHECKED_NEVER = b"\x01\x00\x00\x00"


@dataclass(frozen=True)
class Package:
    """A package and its unpacked files."""

    extra: str
    file: Path
    tree: Path

    @property
    def control(self) -> Message:
        return message_from_string(run("dpkg-deb", "--field", self.file))

    @property
    def home(self) -> Path:
        return self.tree / "opt" / "beamtouch" / self.extra

    @property
    def site(self) -> Path:
        (found,) = self.home.glob("lib/python3.*/site-packages")
        return found


def newest(extra: str) -> tuple[Path | None, str]:
    """Return the package that was built last, and why tests cannot use it; empty if they can."""
    files = sorted(BUILT.glob(f"beamtouch-{extra}_*.deb"))
    if not files:
        return None, "the Debian packages are not built; type: make deb"
    sources = [path for path in DEBIAN.iterdir() if path.name not in {"boot", "fresh-root"}]
    sources += [
        ROOT / "packaging" / "environment.sh",
        ROOT / "constraints.txt",
        ROOT / "pyproject.toml",
        *(ROOT / extra).glob("beamtouch-*"),
    ]
    if files[-1].stat().st_mtime < max(path.stat().st_mtime for path in sources):
        return None, "the Debian packages are older than what they are made from; type: make deb"
    return files[-1], ""


@pytest.mark.parametrize("extra", EXTRAS)
def test_the_packages_are_built(extra: str) -> None:
    """This one fails for all others, which are skipped, where changes are decided."""
    _, reason = newest(extra)
    if reason:
        give_up(reason)


@pytest.fixture(params=EXTRAS)
def package(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Package:
    require("dpkg-deb", "dpkg")
    extra: str = request.param
    file, reason = newest(extra)
    if file is None:
        pytest.skip(reason)

    def unpack(folder: Path) -> None:
        run("dpkg-deb", "--extract", file, folder / "tree")
        run("dpkg-deb", "--control", file, folder / "tree" / "DEBIAN")

    return Package(extra, file, made_once(tmp_path_factory, f"deb-{extra}", unpack) / "tree")


def test_it_asks_for_the_python_that_it_was_made_with(package: Package) -> None:
    minor = int(package.site.parent.name.removeprefix("python3."))
    depends = package.control["Depends"].split(", ")
    assert {f"python3 (>= 3.{minor})", f"python3 (<< 3.{minor + 1})", "systemd"} <= set(depends)
    assert (package.home / "bin" / "python").readlink() == Path(f"/usr/bin/python3.{minor}")


def test_it_is_small_and_holds_only_the_pinned_distributions_of_its_command(package: Package) -> None:
    found = {str(canonicalize_name(one.name)): one.version for one in distributions(path=[str(package.site)])}
    pins = dict(line.split("==") for line in (ROOT / "constraints.txt").read_text().split())
    pinned = {str(canonicalize_name(name)): version for name, version in pins.items()}
    version = found.pop("beamtouch")
    assert package.control["Version"] == version
    assert NEEDED[package.extra] <= found.keys()
    assert found == {name: pinned[name] for name in found}
    assert not FOREIGN[package.extra] & found.keys()
    assert package.file.stat().st_size < MAX_MIB[package.extra] * 2**20


def test_no_file_depends_on_the_folder_in_which_it_was_built(package: Package) -> None:
    assert not list(package.site.rglob("RECORD"))  # they have hashes of scripts that name it
    done = subprocess.run(
        ["grep", "--recursive", "--files-with-matches", "--fixed-strings", str(BUILT.resolve()), package.tree],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert (done.returncode, done.stdout) == (1, "")


def test_libraries_look_for_others_only_beside_themselves(package: Package) -> None:
    libraries = [path for path in package.site.rglob("*.so*") if re.search(r"\.so(\.|$)", path.name)]
    found = run(require("readelf", "binutils"), "--dynamic", *libraries)
    paths = ":".join(re.findall(r"Library (?:rpath|runpath): \[(.*)\]", found))
    assert [path for path in paths.split(":") if path and not path.startswith("$ORIGIN")] == []


def test_all_bytecode_is_there_and_never_checked(package: Package) -> None:
    tag = package.site.parent.name.replace("python3.", "cpython-3")

    def compiled(source: Path) -> Path:
        return source.parent / "__pycache__" / f"{source.stem}.{tag}.pyc"

    sources = list(package.site.rglob("*.py"))
    assert len(sources) > 100
    assert [source for source in sources if compiled(source).read_bytes()[4:8] != BYTECODE_CHECKED_NEVER] == []


def test_root_owns_all_files_and_the_example_is_the_only_one_that_the_user_may_change(package: Package) -> None:
    lines = run("dpkg-deb", "--contents", package.file).splitlines()
    assert {line.split()[1] for line in lines} == {"root/root"}
    assert [line for line in lines if re.match(r".*[sS]|.{5}w|.{8}w", line.split()[0]) and line[0] != "l"] == []
    conffiles = (package.tree / "DEBIAN" / "conffiles").read_text().split()
    assert conffiles == [f"/etc/beamtouch/{package.extra}.example.toml"]
    assert [str(p) for p in (package.tree / "etc").rglob("*") if p.is_file()] == [f"{package.tree}{conffiles[0]}"]


def test_the_command_on_the_path_runs_with_debians_python(package: Package) -> None:
    name = f"beamtouch-{package.extra}"
    link = (package.tree / "usr" / "bin" / name).readlink()
    script = package.tree / link.relative_to("/")
    assert script.read_text().startswith(f"#!/opt/beamtouch/{package.extra}/bin/python -I\n")
    python = (package.home / "bin" / "python").readlink()
    if not python.exists():
        give_up(f"{python} is not installed")
    code = f"import runpy, sys; sys.path.insert(0, {str(package.site)!r}); runpy.run_path({str(script)!r})"
    done = subprocess.run(
        [python, "-I", "-c", code, "--version"], capture_output=True, text=True, check=False, timeout=120
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert package.control["Version"] in done.stdout


def test_its_unit_is_that_of_the_repository_and_not_enabled_and_only_root_reads_the_token(package: Package) -> None:
    name = f"beamtouch-{package.extra}"
    (unit,) = (package.tree / "usr" / "lib" / "systemd" / "system").iterdir()
    assert unit.read_bytes() == (ROOT / package.extra / f"{name}.service").read_bytes()
    assert not list(package.tree.rglob("*.wants"))
    tmpfiles = (package.tree / "usr" / "lib" / "tmpfiles.d" / f"{name}.conf").read_text()
    assert "z /etc/beamtouch/token 0600 root root" in tmpfiles.splitlines()


@pytest.mark.parametrize("script", ["postinst", "prerm", "postrm"])
def test_the_shell_can_read_the_scripts_of_the_packages(script: str) -> None:
    run("sh", "-n", DEBIAN / script)
