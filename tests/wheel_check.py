"""Build the wheel and the sdist, install the wheel in a clean environment away from the sources, and try it there.

Run by `make wheel-test`; not a pytest file, because it must not see the checkout.
"""

import shutil
import subprocess
import sys
import tarfile
import tempfile
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MUST_HOLD = (
    "galen_hw/cli.py",
    "galen_hw/drivers/ati_netcanoem/device.py",
    "galen_hw/drivers/virtual/world.py",
    "galen_hw/services/calibration/service.py",
    "galen_hw/services/compensation/service.py",
    "galen_hw/services/deflection/service.py",
    "galen_hw/config/galen.urdf",
    "galen_hw/config/galen.toml",
    "galen_hw/config/galen-hw.service",
    "galen_hw/config/report_base.html.j2",
    "galen_hw/config/tools/retractor.json",
    "galen_hw/tools/calibration/command.py",
    "galen_hw/tools/calibration/report.html.j2",
    "galen_hw/tools/collect/session.py",
    "galen_hw/tools/deflection/report.html.j2",
    "galen_hw/tools/dashboard/static/index.html",
    "galen_hw/tools/dashboard/static/page.js",
    "galen_hw/tools/dashboard/static/uPlot.iife.min.js",
    "galen_hw/tools/dashboard/static/uPlot.LICENSE.txt",
    "galen_hw/py.typed",
)
WHOLE_MB = 700
SMALL_MB = 500


def main() -> None:
    """Fail loudly on the first thing that is not as it must be."""
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        run(sys.executable, "-m", "build", "--outdir", str(work / "dist"), str(ROOT))
        wheel = next((work / "dist").glob("*.whl"))
        sdist = next((work / "dist").glob("*.tar.gz"))
        check_contents(zipfile.ZipFile(wheel).namelist())
        with tarfile.open(sdist) as archive:
            check_sdist(archive.getnames())
        venv.create(work / "venv", with_pip=True)
        python = str(work / "venv/bin/python")
        run(python, "-m", "pip", "install", "--quiet", str(wheel))
        check_size(next((work / "venv/lib").glob("python3*/site-packages")))
        run(str(work / "venv/bin/galen-hw"), "--help", cwd=work)
        assert (work / "venv/share/man/man1/galen-hw.1").is_file(), "pip has not put the manual page where man looks"
        run(python, "-I", "-c", CONFORMANCE, cwd=work)
        run(str(work / "venv/bin/galen-hw"), "tool", "list", cwd=work)
    print("wheel: contents, installation and every row of the tables are in order")


CONFORMANCE = """
import importlib
from galen_hw.cli import COMMANDS
from galen_hw.drivers.table import DRIVERS, VIRTUAL_DEVICES
from galen_hw.physics.effects.registry import EFFECTS
from galen_hw.services.table import SERVICES
for module, _ in COMMANDS.values():
    importlib.import_module(module)
for row in [*DRIVERS.values(), *VIRTUAL_DEVICES.values(), *SERVICES.values(), *EFFECTS.values()]:
    module, _, name = row.partition(":")
    getattr(importlib.import_module(module), name)
"""


def check_contents(names: list[str]) -> None:
    """The wheel holds one top-level package, with the linked folders inside it."""
    tops = {n.split("/")[0] for n in names}
    assert {t for t in tops if not t.endswith((".dist-info", ".data"))} == {"galen_hw"}, tops
    assert any(n.endswith(".data/data/share/man/man1/galen-hw.1") for n in names), "the wheel lacks the manual page"
    missing = [n for n in MUST_HOLD if n not in names]
    assert not missing, f"the wheel lacks {missing}"
    cloned = [n for n in names if "blind_proof" in n or "benchmarks" in n]
    assert not cloned, (
        f"the blind proof and the benchmarks are run from a clone, they are not for the wheel: {cloned[:3]}"
    )


def check_size(packages: Path) -> None:
    """The size that docs/install.md gives; then the C++ headers go, as it says that they may."""
    whole = megabytes(packages)
    assert whole < WHOLE_MB, f"the plain install takes {whole:.0f} MB"
    shutil.rmtree(packages / "cmeel.prefix/include")
    small = megabytes(packages)
    assert small < SMALL_MB, f"the plain install takes {small:.0f} MB without headers"
    print(f"wheel: the plain install takes {whole:.0f} MB, {small:.0f} MB without C++ headers")


def megabytes(packages: Path) -> float:
    """Space on the disk in units of 2^20 bytes, as du -m counts it; of all but pip and what venv itself brings."""
    ours = [p for p in packages.iterdir() if not p.name.startswith(("pip", "setuptools", "pkg_resources"))]
    files = [f for p in ours for f in (p.rglob("*") if p.is_dir() else [p])]
    return sum(f.lstat().st_blocks for f in files) * 512 / 2**20


def check_sdist(names: list[str]) -> None:
    """The sdist can be built again: the linked folders are in it."""
    inside = {n.split("/", 1)[1] for n in names if "/" in n}
    missing = [n for n in MUST_HOLD if n not in inside]
    assert not missing, f"the sdist lacks {missing}"


def run(*command: str, cwd: Path | None = None) -> None:
    """Run a command; its failure is ours."""
    subprocess.run(command, check=True, cwd=cwd)


if __name__ == "__main__":
    main()
