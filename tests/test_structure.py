"""The layout of the package: imports point one way, public names are listed and documented."""

import ast
import importlib
import pkgutil
from pathlib import Path

import pytest

import ostiform

SOURCE = Path(ostiform.__file__).parent
ORDER = [
    "errors",
    "kernel_cache",
    "compiled",
    "arrays",
    "values",
    "codecs",
    "artifacts",
    "atomic",
    "tables",
    "surface",
    "study",
    "demo",
    "domain",
    "embedding",
    "correspondence",
    "model",
    "evaluation",
    "fitting",
    "statistics",
    "exchange",
    "report",
    "execution",
    "pipeline",
    "api",
    "cli",
]
MODULES = sorted(
    module.name for module in pkgutil.walk_packages(ostiform.__path__, prefix="ostiform.")
)


def imports_of(path: Path) -> set[str]:
    """Top-level packages of ostiform that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names = [node.module]
            if node.module == "ostiform":
                names = [f"ostiform.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        found |= {name.split(".")[1] for name in names if name.startswith("ostiform.")}
    return found - {"__version__"}


def forbidden_imports(package: str, imported: set[str]) -> set[str]:
    return {name for name in imported if ORDER.index(name) > ORDER.index(package)}


@pytest.mark.parametrize("package", ORDER)
def test_imports_point_up_the_list_only(package):
    files = (
        [SOURCE / f"{package}.py"]
        if (SOURCE / f"{package}.py").is_file()
        else sorted((SOURCE / package).rglob("*.py"))
    )
    for path in files:
        assert forbidden_imports(package, imports_of(path)) == set(), path


def test_the_import_check_bites():
    assert forbidden_imports("surface", {"errors", "study"}) == {"study"}


def test_every_package_has_its_place_in_the_order():
    packages = {name.split(".")[1] for name in MODULES}
    assert packages - set(ORDER) - {"__main__"} == set()


@pytest.mark.parametrize("module_name", MODULES)
def test_public_names_exist_and_are_documented(module_name):
    if module_name == "ostiform.__main__":
        pytest.skip("runs the command line when imported")
    module = importlib.import_module(module_name)
    assert module.__doc__
    for name in getattr(module, "__all__", []):
        value = getattr(module, name)
        if callable(value) and getattr(value, "__module__", "").startswith("ostiform"):
            assert value.__doc__, f"{module_name}.{name} has no docstring"
