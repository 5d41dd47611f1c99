"""The page: nothing foreign gets in, nothing leaves, and it says so to the browser."""

import base64
import hashlib
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from ostiform.report import (
    Fact,
    Page,
    Picture,
    Section,
    Table,
    draw_picture,
    render_page,
    save_drawing,
)
from ostiform.report.curves import scores_figure

NASTY = "</script><script>alert('1')</script><img src=x onerror=alert(2)> & \"$x$\" Ünïcode 心"
VOID = {"meta", "img", "br", "link", "input", "hr"}


class Reader(HTMLParser):
    """Collects elements and texts, and checks that elements nest."""

    def __init__(self):
        super().__init__()
        self.open, self.tags, self.texts = [], [], {}

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open:
            self.texts.setdefault(self.open[-1], []).append(data)


def read(html):
    reader = Reader()
    reader.feed(html)
    assert reader.open == []
    return reader


def plotted():
    drawing = Figure()
    drawing.subplots().plot([0, 1], label="line")
    return drawing


def page(**kwargs):
    sections = (
        Section(
            "first",
            NASTY,
            (NASTY,),
            (Picture("plot", plotted(), NASTY, NASTY), Picture("pixels", plotted(), "", "", False)),
            (Table(NASTY, (NASTY, "b"), ((NASTY, "1"),) * 15),),
            **kwargs,
        ),
    )
    return Page(NASTY, NASTY, (Fact(NASTY, NASTY, True, NASTY),), sections, (NASTY,))


def policy_of(reader):
    (content,) = [
        attrs["content"]
        for tag, attrs in reader.tags
        if tag == "meta" and attrs.get("http-equiv") == "Content-Security-Policy"
    ]
    return dict(item.split(" ", 1) for item in content.split("; "))


def hashed(text):
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


@pytest.fixture(scope="module")
def without_viewer():
    return render_page(page())


@pytest.fixture(scope="module")
def with_viewer():
    return render_page(page(viewer='{"name": "</script><!-- <script> &"}'))


def test_names_are_escaped_everywhere(without_viewer):
    reader = read(without_viewer)
    assert not any(tag == "script" or "onerror" in attrs for tag, attrs in reader.tags)
    assert NASTY in "".join(reader.texts["h1"])
    assert "<img src=x" not in without_viewer


def test_nothing_is_asked_of_the_network(with_viewer):
    reader = read(with_viewer)
    for _, attrs in reader.tags:
        for name in ("src", "href", "xlink:href", "action", "data", "poster", "srcset"):
            assert attrs.get(name, "#").startswith(("#", "data:"))
    assert not re.search(r"@import|url\((?!#|['\"]?#)", "".join(reader.texts["style"]))


def test_the_policy_forbids_everything_but_what_is_in_the_page(with_viewer):
    reader = read(with_viewer)
    policy = policy_of(reader)
    assert policy["default-src"] == "'none'"
    assert policy["img-src"] == "data:"
    assert policy["style-src"] == hashed("".join(reader.texts["style"]))
    scripts = [attrs for tag, attrs in reader.tags if tag == "script"]
    assert [attrs.get("type") for attrs in scripts] == ["application/json", None]
    (code,) = re.findall(r"<script>(.*?)</script>", with_viewer, flags=re.DOTALL)
    assert policy["script-src"] == hashed(code)
    assert "unsafe-inline" not in policy["script-src"] + policy["style-src"]


def test_a_page_without_viewer_allows_no_script(without_viewer):
    assert policy_of(read(without_viewer))["script-src"] == "'none'"


def test_data_cannot_end_its_element(with_viewer):
    reader = read(with_viewer)
    data = [text for text in reader.texts["script"] if "name" in text][0]
    assert "<" not in data
    assert "\\u003c/script\\u003e" in data


def test_the_bundle_cannot_be_taken_for_markup(with_viewer):
    (code,) = re.findall(r"<script>(.*?)</script>", with_viewer, flags=re.DOTALL)
    assert "<!--" not in code
    assert "</script" not in code.lower()


def test_long_tables_are_folded_after_ten_rows(without_viewer):
    reader = read(without_viewer)
    assert "The other 5 of 15 rows" in "".join(reader.texts["summary"])
    assert sum(tag == "th" and attrs.get("scope") == "row" for tag, attrs in reader.tags) == 15


def test_a_few_more_rows_are_not_folded():
    tables = (Table("t", ("x", "y"), (("a", "b"),) * 14),)
    reader = read(render_page(Page("p", "", (), (Section("s", "t", tables=tables),))))
    assert not reader.texts.get("summary")


def test_every_table_has_a_name_of_its_own():
    tables = (Table("t", ("x", "y"), (("a", "b"),) * 30),)
    reader = read(render_page(Page("p", "", (), (Section("s", "t", tables=tables),))))
    names = [attrs["aria-label"] for _, attrs in reader.tags if attrs.get("role") == "region"]
    assert names == ["t", "t: The other 20 of 30 rows"]


def test_a_table_shows_as_many_rows_as_it_says():
    rows = (("a", "b"),) * 9
    tables = tuple(Table(f"{shown}", ("x", "y"), rows, shown) for shown in (0, 2, 9))
    reader = read(render_page(Page("p", "", (), (Section("s", "t", tables=tables),))))
    assert reader.texts["summary"] == ["All 9 rows", "The other 7 of 9 rows"]
    assert sum(tag == "table" for tag, _ in reader.tags) == 4


def test_sentences_are_set_to_the_left_and_the_summary_is_in_the_head():
    summary = Table("three", ("x", "y"), (("a", "words"),), texts=(1,))
    reader = read(render_page(Page("p", "", (), (), summary=summary)))
    left = [tag for tag, attrs in reader.tags if attrs.get("class") == "text"]
    assert left == ["th", "td"]
    assert "three" in reader.texts["p"]


def test_identifiers_of_several_drawings_differ():
    two = Section(
        "two", "t", pictures=(Picture("a", plotted(), "", ""), Picture("b", plotted(), "", ""))
    )
    reader = read(render_page(Page("p", "", (), (two,))))
    ids = [attrs["id"] for _, attrs in reader.tags if "id" in attrs]
    assert len(ids) == len(set(ids))
    assert "style" not in {tag for tag, _ in reader.tags[-1:]}
    assert sum(tag == "style" for tag, _ in reader.tags) == 1


def test_every_picture_has_a_text(without_viewer):
    reader = read(without_viewer)
    pictures = [attrs for _, attrs in reader.tags if attrs.get("role") == "img"]
    assert len(pictures) == 2
    assert pictures[0]["aria-label"] == NASTY


def test_every_picture_names_its_files(without_viewer):
    assert read(without_viewer).texts["span"][-1] == "figures/pixels.svg, .pdf, .png"


def test_files_are_fit_for_print(tmp_path):
    drawing = draw_picture(Picture("plot", Figure(figsize=(2.0, 1.0)), "", ""))
    save_drawing(drawing, "plot", tmp_path)
    assert (tmp_path / "plot.svg").read_text("utf-8").startswith("<?xml")
    assert (tmp_path / "plot.pdf").read_bytes().startswith(b"%PDF")
    with Image.open(tmp_path / "plot.png") as image:
        assert image.size == (600, 300)


def test_drawing_twice_gives_the_same_files():
    first, second = (draw_picture(Picture("plot", plotted(), "", "")) for _ in range(2))
    assert first == second


def test_dollars_and_foreign_scripts_in_names_are_drawn_as_they_are():
    drawing = scores_figure(np.eye(3), ["$a", "b$^", "心"], np.zeros(3), np.ones(3) / 3)
    svg = draw_picture(Picture("scores", drawing, "", "")).svg.decode()
    assert "$a" in svg
    assert "心" in svg
