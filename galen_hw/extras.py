"""Libraries that a robot's computer can do without: which extra brings each, and the one line when it is missing."""

import importlib.util
from typing import Final

from galen_hw.errors import UsageError

EXTRAS: Final[dict[str, tuple[str, ...]]] = {
    "diagnose": ("sklearn", "joblib", "threadpoolctl"),
    "reports": ("matplotlib", "jinja2"),
    "import": ("pyarrow", "pandas", "rosbags", "h5py", "matio", "asammdf"),
    "dask": ("distributed", "dask"),
    "torch": ("torch",),
    "xacro": ("xacrodoc",),
    "remote": ("fsspec",),
    "completion": ("shtab",),
    "bota": ("bota_driver",),
}
"""Name of the extra: modules that nothing else needs."""
NAMES: Final = {"sklearn": "scikit-learn", "jinja2": "Jinja2", "matio": "mat-io", "bota_driver": "bota-driver"}
"""Module: what it is called where it is installed from."""


class MissingExtraError(UsageError, ImportError):
    """A library of an extra is not installed; an `ImportError` too, as Python calls it."""


def need(extra: str, where: str = "", *modules: str) -> None:
    """Return if the libraries of an extra (or these of its modules alone) are installed; asked before the work, not after it.

    Raises:
        MissingExtraError: one is not: which, and what to type.
    """
    for module in modules or EXTRAS[extra]:
        if importlib.util.find_spec(module) is None:
            raise _missing(extra, module, where)


def explained(error: ModuleNotFoundError, where: str = "") -> MissingExtraError | None:
    """Return the line for an import that failed; None where the module belongs to no extra."""
    module = (error.name or "").partition(".")[0]
    extra = next((name for name, modules in EXTRAS.items() if module in modules), None)
    return None if extra is None else _missing(extra, module, where)


def _missing(extra: str, module: str, where: str) -> MissingExtraError:
    name = NAMES.get(module, module)
    return MissingExtraError(f"{name} is not installed", where=where, todo=f"pip install 'galen-hw[{extra}]'")
