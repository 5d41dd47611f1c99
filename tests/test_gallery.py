"""Every example of the gallery runs, without a warning."""

import runpy
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

GALLERY = Path(__file__).resolve().parents[1] / "examples" / "gallery"
EXAMPLES = sorted(GALLERY.glob("plot_*.py"))

pytestmark = pytest.mark.xdist_group("example")


@pytest.fixture(autouse=True)
def without_a_display(monkeypatch, tmp_path):
    """Draw into memory, and write where nobody looks."""
    import pyvista

    monkeypatch.setattr(pyvista, "OFF_SCREEN", True)
    monkeypatch.chdir(tmp_path)
    plt.switch_backend("Agg")
    yield
    plt.close("all")
    pyvista.close_all()


def test_there_are_examples():
    assert EXAMPLES


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_the_example_runs(path, example_folder):
    runpy.run_path(str(path), run_name="__main__")
