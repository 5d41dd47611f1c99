"""Configuration of the documentation; build it with ``make docs``."""

import os
import re
import sys
from pathlib import Path

os.environ["PYVISTA_OFF_SCREEN"] = "true"  # before PyVista is imported
os.environ.setdefault("MPLBACKEND", "Agg")
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")
sys.path.insert(0, str(Path(__file__).parent / "extensions"))

import pyvista  # noqa: E402
from figures import FigureScraper  # noqa: E402

from ostiform import __version__  # noqa: E402

pyvista.OFF_SCREEN = True
pyvista.BUILDING_GALLERY = True

project = "Ostiform"
author = "The Ostiform developers"
copyright = "the Ostiform developers, BSD-3-Clause"  # noqa: A001
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
    "mathml",
]
exclude_patterns = ["_build", "extensions"]
html_math_renderer = "mathml"
html_static_path = ["static"]
html_css_files = ["ostiform.css"]

sphinx_gallery_conf = {
    "examples_dirs": "../examples/gallery",
    "gallery_dirs": "gallery",
    "filename_pattern": "/plot_",
    "image_scrapers": (FigureScraper(), "matplotlib", "pyvista"),
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e9,
    "plot_gallery": True,
    "abort_on_example_error": True,
    "reset_modules": ("matplotlib",),
}
# Gallery settings cannot be pickled; names that a package passes on are found twice.
suppress_warnings = ["config.cache", "ref.python"]
nitpicky = False

myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3

napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False
autodoc_typehints = "none"
autodoc_member_order = "bysource"
default_role = "code"

html_theme = "pydata_sphinx_theme"
html_title = f"Ostiform {__version__}"
html_theme_options = {
    "show_prev_next": True,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "show_toc_level": 2,
    "header_links_before_dropdown": 6,
}
html_sidebars = {"*": []}
html_show_sourcelink = False
html_copy_source = False

SEVERAL_NAMES = re.compile(r"(\w+(?:, \w+)+) : (.+)")


def one_name_each(app, what, name, obj, options, lines):
    """Write ``a, b : type`` of a docstring as two entries: napoleon takes one name each."""
    written, rest = [], list(lines)
    while rest:
        line = rest.pop(0)
        found = SEVERAL_NAMES.fullmatch(line)
        if found is None:
            written.append(line)
            continue
        description = []
        while rest and (rest[0].startswith(" ") or not rest[0]):
            if not rest[0] and not (len(rest) > 1 and rest[1].startswith(" ")):
                break
            description.append(rest.pop(0))
        for each in found[1].split(", "):
            written += [f"{each} : {found[2]}", *description]
    lines[:] = written


def setup(app):
    """Connect the handler ahead of napoleon's."""
    app.connect("autodoc-process-docstring", one_name_each, priority=100)
