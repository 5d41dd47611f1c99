"""Configuration of the documentation; build it with ``make docs``."""

import re

from ostiform import __version__

project = "Ostiform"
author = "The Ostiform developers"
copyright = "the Ostiform developers, BSD-3-Clause"  # noqa: A001
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
exclude_patterns = ["_build"]
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
    "header_links_before_dropdown": 9,
}
html_sidebars = {"*": []}
html_show_sourcelink = False

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
