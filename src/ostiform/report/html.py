"""One self-contained HTML page from sections of text, tables and figures.

The page makes no request and runs no foreign code: styles and pictures are inlined, every text
is escaped by the template, and a content-security policy says so to the browser.
"""

import base64
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import jinja2
from markupsafe import Markup
from matplotlib.figure import Figure

from ostiform.atomic import atomically
from ostiform.report.style import styled

__all__ = ["Fact", "Page", "Picture", "Section", "Table", "render_page", "save_picture"]

RASTER_DPI = 130
PRINT_DPI = 300


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A figure with what is said about it.

    Attributes
    ----------
    name : str
        File name without suffix, unique in the page.
    figure : matplotlib Figure
    caption : str
    description : str
        What a reader who cannot see the figure should know.
    is_vector : bool
        Whether it is inlined as SVG; otherwise as PNG (pictures of many triangles).
    """

    name: str
    figure: Figure
    caption: str
    description: str
    is_vector: bool = True


@dataclass(frozen=True, slots=True)
class Table:
    """A table of texts; numbers are formatted by whoever knows their unit."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class Fact:
    """One number of the headline."""

    label: str
    value: str
    is_good: bool | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A part of the page."""

    anchor: str
    title: str
    paragraphs: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Page:
    """A whole report."""

    title: str
    subtitle: str
    facts: tuple[Fact, ...]
    sections: tuple[Section, ...]
    warnings: tuple[str, ...] = field(default=())


def render_page(page: Page) -> str:
    """Return the HTML of a report, complete in itself."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("ostiform.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["inlined"] = _inlined
    return environment.get_template("report.html.j2").render(page=page)


def save_picture(
    picture: Picture, folder: Path, formats: Sequence[str] = ("svg", "pdf", "png")
) -> None:
    """Write a figure as files fit for print: SVG, PDF and a PNG of 300 dots per inch."""
    for suffix in formats:
        with atomically(folder / f"{picture.name}.{suffix}") as temporary:
            temporary.write_bytes(_drawn(picture.figure, suffix, PRINT_DPI))


def _inlined(picture: Picture) -> Markup:
    if picture.is_vector:
        svg = _drawn(picture.figure, "svg", RASTER_DPI).decode("utf-8")
        svg = svg[svg.index("<svg") :]
        svg = _with_own_ids(svg, picture.name)
        return Markup(svg)  # drawn by Matplotlib, which escapes the texts it is given
    encoded = base64.b64encode(_drawn(picture.figure, "png", RASTER_DPI)).decode("ascii")
    return Markup('<img src="data:image/png;base64,{}" alt="">').format(encoded)


def _with_own_ids(svg: str, prefix: str) -> str:
    """Prefix the identifiers of a drawing so that several fit in one page."""
    svg = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', svg)
    svg = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", svg)
    return re.sub(r'xlink:href="#([^"]+)"', rf'xlink:href="#{prefix}-\1"', svg)


def _drawn(drawing: Figure, suffix: str, dpi: int) -> bytes:
    buffer = io.BytesIO()
    metadata = (
        {"Date": None} if suffix == "svg" else {"CreationDate": None} if suffix == "pdf" else {}
    )
    with styled():
        drawing.savefig(buffer, format=suffix, dpi=dpi, metadata=metadata)
    return buffer.getvalue()
