"""What SECURITY.md says: bytes are data, the lock is whole, and the page names every address."""

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from galen_hw.config.paths import Addresses

ROOT = Path(__file__).parent.parent
SOURCES = [
    p
    for folder in ("galen_hw", "drivers", "services", "config", "tools")
    for p in sorted((ROOT / folder).rglob("*.py"))
]
FORBIDDEN_MODULES = {"pickle", "cPickle", "marshal", "shelve", "dill", "cloudpickle", "yaml", "xmlrpc"}
FORBIDDEN_CALLS = {
    "eval",
    "exec",
    "compile",
    "__import__",
    "os.system",
    "os.popen",
    "joblib.load",
    "torch.load",
    "np.load",
}


def said(node: ast.expr) -> str:
    """`a.b.c` of a call's function; empty for what is no name."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and (before := said(node.value)):
        return f"{before}.{node.attr}"
    return ""


def offences(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        yield from (name for name in names if name.partition(".")[0] in FORBIDDEN_MODULES)
        if isinstance(node, ast.Call):
            if said(node.func) in FORBIDDEN_CALLS:
                yield said(node.func)
            if any(k.arg in ("shell", "allow_pickle") and getattr(k.value, "value", None) for k in node.keywords):
                yield f"{said(node.func)} with a shell or pickles"


@pytest.mark.parametrize(
    "text", ["import pickle", "from yaml import load", "eval('1')", "run('x', shell=True)", "import os; os.system('x')"]
)
def test_what_must_not_be_there_is_found(text: str) -> None:
    assert list(offences(ast.parse(text)))


def test_bytes_are_data() -> None:
    """No module unpickles, evaluates or runs a shell; weights of a network are read as plain arrays."""
    assert len(SOURCES) > 200
    found = {str(p.relative_to(ROOT)): list(offences(ast.parse(p.read_text(encoding="utf-8")))) for p in SOURCES}
    assert {path: what for path, what in found.items() if what} == {}


def locked() -> dict[str, tuple[str, str]]:
    """Version and the rest (marker, hashes) of each package of the lock; of several for a name, the last."""
    text = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    blocks = re.findall(r"^([A-Za-z0-9._-]+)==(\S+)(.*(?:\n[ ]+.*)*)", text, re.MULTILINE)
    return {canonicalize_name(name): (version, rest) for name, version, rest in blocks}


def test_the_lock_has_every_package_with_its_hashes() -> None:
    """What pyproject.toml asks for is there in a version that it admits; nothing is there without a hash."""
    found = locked()
    with (ROOT / "pyproject.toml").open("rb") as file:
        wanted = [Requirement(text) for text in tomllib.load(file)["project"]["dependencies"]]
    for requirement in wanted:
        version, _ = found[canonicalize_name(requirement.name)]
        assert requirement.specifier.contains(version), requirement
    assert [name for name, (_, rest) in found.items() if "--hash=sha256:" not in rest] == []
    assert "://" not in (ROOT / "requirements.lock").read_text(encoding="utf-8")


def test_the_threat_model_names_every_address() -> None:
    """Each socket of the daemon, the viewers' port and the keys."""
    page = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    addresses = Addresses(Path("/run/x"))
    for address in (addresses.bus, addresses.command, addresses.inward, addresses.control):
        assert f"`{address.rpartition('/')[2]}`" in page
    assert "viewers' port" in page
    assert "[bus] keys" in page
