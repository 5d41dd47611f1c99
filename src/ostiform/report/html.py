"""One self-contained HTML page from sections of text, tables, figures and the viewer.

The page makes no request and runs no foreign code: styles, pictures and the one script are
inlined, every text is escaped by the template, and a content-security policy that names the
script and the styles by their hashes says so to the browser.
"""

import base64
import hashlib
import io
import re
import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path

import jinja2
from markupsafe import Markup
from matplotlib.figure import Figure
from PIL import Image

from ostiform.atomic import atomically
from ostiform.report.style import PRINT_DPI, styled

SCREEN_SHRINK = 2
"""Pixels of the print picture per pixel of the one in the page, in each direction."""

SCREEN_QUALITY = 90
"""Of 100, of the pictures in the page; the files in ``figures/`` lose nothing."""

WEBP_EFFORT = 4
"""Of 6."""

PNG_COMPRESSION = 3
"""Of 9: a tenth larger than the best, in a third of the time."""

SCREEN_DPI = 125
"""CSS pixels per inch of print: letters of a figure then look like those of the page."""

WIDE = 544
"""CSS pixels below which a picture of triangles is not shrunk: its screen scrolls instead."""

ROWS_SHOWN = 10
"""Rows of a table before the rest is folded away."""

FIGURE_NAMES = re.compile(
    r"points|mode\d+|between1|motion1|evidence|gains|flagged\d+|left-out|scores|levels|volumes"
    r"|clinical|maps-paper|maps|distortion|seams|convergence"
)
"""Every name that a picture of a report of a study can have."""

FEWEST_FOLDED = 5
"""Fewer rows than this are shown with the others."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A figure with what is said about it.

    Attributes
    ----------
    name : str
        File name without suffix, unique in the page.
    figure : matplotlib Figure
        It may be drawn in another process: no lambda in it.
    caption : str
    description : str
        What a reader who cannot see the figure should know.
    is_vector : bool
        Whether it is inlined as SVG; otherwise as WebP (pictures of many triangles).
    """

    name: str
    figure: Figure
    caption: str
    description: str
    is_vector: bool = True


@dataclass(frozen=True, slots=True)
class Drawing:
    """The files of a picture, fit for print.

    Attributes
    ----------
    svg, pdf, png : bytes
        Pictures of triangles lie as pixels in all of them, the texts and curves do not.
    """

    svg: bytes
    pdf: bytes
    png: bytes


@dataclass(frozen=True, slots=True)
class Table:
    """A table of texts; numbers are formatted by whoever knows their unit.

    Attributes
    ----------
    caption : str
    header : tuple of str
    rows : tuple of tuple of str
    rows_shown : int
        Rows before the rest is folded away.
    texts : tuple of int
        Columns that hold sentences, which are set to the left; the first always is.
    """

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    rows_shown: int = ROWS_SHOWN
    texts: tuple[int, ...] = ()

    @property
    def rows_in_view(self) -> int:
        """Rows that are not folded away."""
        if 0 < self.rows_shown < len(self.rows) < self.rows_shown + FEWEST_FOLDED:
            return len(self.rows)
        return min(self.rows_shown, len(self.rows))


@dataclass(frozen=True, slots=True)
class Fact:
    """One number of the headline, and what goes with it."""

    label: str
    value: str
    is_good: bool | None = None
    note: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A part of the page.

    Attributes
    ----------
    anchor, title : str
    paragraphs : tuple of str
    pictures : tuple of Picture
    tables : tuple of Table
    viewer : str or None
        What the interactive viewer shows, as JSON; at most one section of a page has it.
    fallback : str or None
        Anchor of the section with the pictures that stand in for the viewer.
    notes : tuple of str
        Paragraphs between the pictures and the tables.
    """

    anchor: str
    title: str
    paragraphs: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    viewer: str | None = None
    fallback: str | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Page:
    """A whole report; `summary` is a table beside the facts of the headline."""

    title: str
    subtitle: str
    facts: tuple[Fact, ...]
    sections: tuple[Section, ...]
    warnings: tuple[str, ...] = field(default=())
    summary: Table | None = None


def draw_picture(picture: Picture) -> Drawing:
    """Draw a figure in every format: SVG, PDF and a PNG of 300 dots per inch.

    The figure is laid out once; all formats get the same layout.
    """
    with styled(), warnings.catch_warnings():
        # A name in a script that the font lacks shows as boxes here and in full in the tables.
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        figure = picture.figure
        if figure.get_layout_engine() is not None:
            figure.draw_without_rendering()
            figure.set_layout_engine(None)  # with an engine, every format would be drawn twice
        return Drawing(
            svg=_saved(figure, "svg", {"Date": None}),
            pdf=_saved(figure, "pdf", {"CreationDate": None}),
            png=_saved(figure, "png", {}),
        )


def save_drawing(drawing: Drawing, name: str, folder: Path) -> None:
    """Write the files ``name.svg``, ``name.pdf`` and ``name.png`` into a folder."""
    for suffix in ("svg", "pdf", "png"):
        with atomically(folder / f"{name}.{suffix}") as temporary:
            temporary.write_bytes(getattr(drawing, suffix))


def remove_stale_drawings(folder: Path, names: Collection[str]) -> None:
    """Remove the drawings of earlier reports that are not among the names of this one.

    Only files with names that reports give are removed (`FIGURE_NAMES`).
    """
    for suffix in ("svg", "pdf", "png"):
        for path in folder.glob(f"*.{suffix}"):
            if path.stem not in names and FIGURE_NAMES.fullmatch(path.stem):
                path.unlink()


def render_page(page: Page, drawings: Mapping[str, Drawing] | None = None) -> str:
    """Return the HTML of a report, complete in itself.

    Parameters
    ----------
    page : Page
    drawings : mapping of str to Drawing, optional
        By the name of the picture, where they are at hand; the others are drawn.
    """
    known = drawings or {}
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("ostiform.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["inlined"] = lambda picture: _inlined(
        picture, known.get(picture.name) or draw_picture(picture)
    )
    environment.globals["is_wide"] = lambda picture: (
        not picture.is_vector and picture.figure.get_figwidth() * SCREEN_DPI > WIDE
    )
    environment.globals["as_data"] = _as_data
    environment.filters["tied"] = _tied
    style = files("ostiform.report").joinpath("templates/report.css").read_text("utf-8")
    has_viewer = any(section.viewer is not None for section in page.sections)
    script = _viewer_script() if has_viewer else ""
    policy = "; ".join(
        (
            "default-src 'none'",
            "img-src data:",
            f"script-src {_hash_of(script)}" if has_viewer else "script-src 'none'",
            f"style-src {_hash_of(style)}",
            "style-src-attr 'unsafe-inline'",  # the styles of Matplotlib's drawings
            "base-uri 'none'",
            "form-action 'none'",
        )
    )
    return environment.get_template("report.html.j2").render(
        page=page,
        policy=policy,
        style=Markup(style),
        script=Markup(script),
    )


def _viewer_script() -> str:
    script = files("ostiform.report").joinpath("assets/viewer.min.js").read_text("utf-8")
    # Nothing in a script element may look like its end.
    return re.sub(r"</(script)", r"<\\/\1", script, flags=re.IGNORECASE)


def _hash_of(text: str) -> str:
    """Return a source of a content-security policy that allows exactly this text."""
    digest = base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")
    return f"'sha256-{digest}'"


def _as_data(text: str) -> Markup:
    """JSON inside a script element: no character that could end it."""
    escaped = {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026"}
    return Markup(re.sub("[<>&]", lambda match: escaped[match.group()], text))


def _tied(text: str) -> str:
    """Keep a percent sign on the line of its number."""
    return text.replace(" %", "\N{NO-BREAK SPACE}%")


def _inlined(picture: Picture, drawing: Drawing) -> Markup:
    width = picture.figure.get_figwidth() * SCREEN_DPI
    if picture.is_vector:
        svg = drawing.svg.decode("utf-8")
        svg = svg[svg.index("<svg") :]
        # Its style element would hold for the whole page; report.css says the same for drawings.
        svg = re.sub(r"<style[^>]*>.*?</style>", "", svg, flags=re.DOTALL)
        svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
        svg = re.sub(r'^<svg([^>]*?) width="[^"]*"', rf'<svg\1 width="{width:.0f}"', svg)
        svg = re.sub(r'^<svg([^>]*?) height="[^"]*"', r"<svg\1", svg)
        return Markup(_with_own_ids(svg, picture.name))  # Matplotlib escapes the texts it is given
    encoded = base64.b64encode(_shrunk(drawing.png)).decode("ascii")
    return Markup('<img src="data:image/webp;base64,{}" alt="" width="{:.0f}">').format(
        encoded, width
    )


def _shrunk(png: bytes) -> bytes:
    buffer = io.BytesIO()
    with Image.open(io.BytesIO(png)) as image:
        small = image.convert("RGB").reduce(SCREEN_SHRINK)
        small.save(buffer, "webp", quality=SCREEN_QUALITY, method=WEBP_EFFORT)
    return buffer.getvalue()


def _with_own_ids(svg: str, prefix: str) -> str:
    """Prefix the identifiers of a drawing so that several fit in one page."""
    svg = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', svg)
    svg = re.sub(r"url\(#([^)]+)\)", rf"url(#{prefix}-\1)", svg)
    return re.sub(r'xlink:href="#([^"]+)"', rf'xlink:href="#{prefix}-\1"', svg)


def _saved(drawing: Figure, suffix: str, metadata: dict[str, None]) -> bytes:
    buffer = io.BytesIO()
    if suffix == "png":
        compression = {"compress_level": PNG_COMPRESSION}
        drawing.savefig(buffer, format=suffix, dpi=PRINT_DPI, pil_kwargs=compression)
    else:
        drawing.savefig(buffer, format=suffix, dpi=PRINT_DPI, metadata=metadata)
    return buffer.getvalue()
