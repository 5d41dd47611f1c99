"""The report in a real browser, without a network: it draws, it moves, it complains of nothing."""

import base64
import hashlib
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from ostiform.evaluation import clinical_table, left_out_point_residues
from ostiform.model import (
    StoredModel,
    SurfaceField,
    dynamic_model_of,
    fit_model,
    mesh_of_template,
    project,
)
from ostiform.report import (
    Fact,
    Page,
    Section,
    Table,
    modes_section,
    render_page,
    viewer_section,
    volumes_section,
)
from tests.populations import population, two_part_template

pytestmark = pytest.mark.long

REDRAWN = 1e-3  # pixels at edges, by rounding of the camera's place
KEEP_PIXELS = """
const plain = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, options) {
  return plain.call(this, kind, { ...options, preserveDrawingBuffer: true });
};
"""
READ_PIXELS = """() => {
  const gl = document.querySelector('.viewer .stage > canvas').getContext('webgl2');
  const size = [gl.drawingBufferWidth, gl.drawingBufferHeight];
  const pixels = new Uint8Array(4 * size[0] * size[1]);
  gl.readPixels(0, 0, ...size, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  let text = '';
  for (const value of pixels) text += String.fromCharCode(value);
  return [size, btoa(text)];
}"""
FLAGS = ["--no-sandbox", "--enable-unsafe-swiftshader"]
AXE = Path(__file__).parents[2] / "viewer" / "node_modules" / "axe-core" / "axe.min.js"


@pytest.fixture(scope="module")
def chromium():
    sync_api = pytest.importorskip(
        "playwright.sync_api", reason="playwright is missing: pip install --group browser"
    )
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")
    if path is None:
        pytest.skip("no Chromium found on this machine")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    shapes = population(3, 5, np.random.default_rng(4), two_part_template(9, 24))
    model = fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))
    stored = StoredModel(model, project(model, shapes.aligned), shapes.ids, None)
    residues = left_out_point_residues(shapes.aligned, shapes.weights, shapes.ids, 3)
    page = Page(
        "A study <b>&</b>",
        "subtitle",
        (Fact("certified", "3 of 3", True, "note"), Fact("bad", "1", False)),
        (
            viewer_section(stored, dynamic_model_of(stored), residues, surface_fields(stored)),
            modes_section(model),
            volumes_section(clinical_table(shapes.ids, shapes.points, shapes.aligned, model.mesh)),
            Section("long", "Long", (), (), (Table("rows", ("a", "b"), (("x" * 60, "1"),) * 12),)),
        ),
        ("a warning",),
        Table("three models", ("model", "gain"), (("conformal", "1 %"),)),
    )
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(render_page(page), encoding="utf-8")
    return path


def surface_fields(stored):
    """Return a voltage with a gap that is 10 mV lower in the first shape, and a label."""
    height = np.broadcast_to(stored.model.mean[:, 2], (len(stored.ids), len(stored.model.mean)))
    voltage = np.where(height > 40.0, np.nan, 0.1 * height)
    voltage[0] -= 10.0
    return (
        SurfaceField("voltage", "mV", False, voltage),
        SurfaceField("region", "", True, np.where(height > 0.0, 7.0, 3.0)),
    )


class Opened:
    """A page, what it said on the console, and what it asked of the network."""

    def __init__(self, context, report):
        self.page = context.new_page()
        self.complaints, self.requests = [], []
        self.page.on("console", self._heard)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.add_init_script(KEEP_PIXELS)
        self.page.goto(report.as_uri())

    def _heard(self, message):
        if message.type in {"error", "warning"} and "GPU stall" not in message.text:
            self.complaints.append(message.text)

    def pixels(self):
        """Hash of what the viewer has drawn."""
        return hashlib.sha256(self.picture().tobytes()).hexdigest()

    def picture(self):
        """What the viewer has drawn, (H, W, 4) uint8, read from WebGL itself."""
        self.page.evaluate(
            "() => new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(go)))"
        )
        size, encoded = self.page.evaluate(READ_PIXELS)
        return np.frombuffer(base64.b64decode(encoded), np.uint8).reshape(size[1], size[0], 4)


@pytest.fixture
def opened(chromium, report, request):
    context = chromium.new_context(offline=True, **getattr(request, "param", {}))
    page = Opened(context, report)
    yield page
    assert page.complaints == []
    assert [url for url in page.requests if not url.startswith(("file:", "data:"))] == []
    context.close()


def share_changed(first, second):
    """Share of pixels that differ visibly."""
    return (np.abs(first.astype(int) - second) > 8).any(axis=2).mean()


def slide(opened, index, value):
    slider = opened.page.locator(f'input[data-mode="{index}"]')
    slider.fill(str(value))


def test_the_viewer_starts_and_hides_its_fallback(opened):
    assert opened.page.locator("#viewer-root").get_attribute("data-ready") == "true"
    assert not opened.page.locator("#viewer-fallback").is_visible()


def test_every_slider_moves_pixels_and_the_button_brings_the_mean_back(opened):
    mean = opened.pixels()
    seen = {mean}
    for index in range(2):
        slide(opened, index, 2)
        seen.add(opened.pixels())
    assert len(seen) == 3
    opened.page.get_by_role("button", name="Mean shape").click()
    assert opened.pixels() == mean


def test_a_slider_moves_with_the_keyboard(opened):
    before = opened.pixels()
    slider = opened.page.locator('input[data-mode="0"]')
    slider.focus()
    for _ in range(20):
        opened.page.keyboard.press("ArrowRight")
    assert float(slider.input_value()) == pytest.approx(1.0)
    assert slider.get_attribute("aria-valuetext") == "1.00 standard deviations"
    assert opened.pixels() != before


def test_the_picture_turns_and_zooms_with_the_keyboard_and_comes_back(opened):
    opened.page.locator(".viewer .stage > canvas").focus()
    first = opened.picture()
    seen = {opened.pixels()}
    for key in ("ArrowLeft", "ArrowDown", "+"):
        opened.page.keyboard.press(key)
        seen.add(opened.pixels())
    assert len(seen) == 4
    opened.page.keyboard.press("0")
    assert share_changed(opened.picture(), first) < REDRAWN


def test_the_picture_turns_with_the_mouse(opened):
    before = opened.pixels()
    canvas = opened.page.locator(".viewer .stage > canvas")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    opened.page.mouse.move(x, y)
    opened.page.mouse.down()
    opened.page.mouse.move(x + 80, y, steps=4)
    opened.page.mouse.up()
    assert opened.pixels() != before


def test_the_cycle_plays_and_stops(opened):
    opened.page.get_by_role("button", name="Play").click()
    root = opened.page.locator("#viewer-root")
    first, before = root.get_attribute("data-time"), opened.pixels()
    opened.page.wait_for_timeout(300)
    assert root.get_attribute("data-time") != first
    assert opened.pixels() != before
    opened.page.get_by_role("button", name="Pause").click()
    stopped = root.get_attribute("data-time")
    opened.page.wait_for_timeout(200)
    assert root.get_attribute("data-time") == stopped


@pytest.mark.parametrize("opened", [{"reduced_motion": "reduce"}], indirect=True)
def test_with_reduced_motion_the_cycle_goes_in_steps(opened):
    opened.page.get_by_role("button", name="Play").click()
    root = opened.page.locator("#viewer-root")
    opened.page.wait_for_timeout(400)
    assert float(root.get_attribute("data-time")) == 0.0
    opened.page.wait_for_timeout(1000)
    assert float(root.get_attribute("data-time")) in {0.125, 0.25}


def test_other_modes_cycles_colours_and_wires_change_the_picture(opened):
    page = opened.page
    seen = [opened.pixels()]
    page.get_by_label("Colour").select_option("standard deviation of the points")
    seen.append(opened.pixels())
    slide(opened, 0, 1.5)
    page.get_by_label("Colour").select_option("distance from the mean shape")
    seen.append(opened.pixels())
    page.get_by_label("wireframe").check()
    seen.append(opened.pixels())
    page.get_by_label("openings and seams").uncheck()
    seen.append(opened.pixels())
    page.get_by_label("Variation of").select_option("between subjects")
    slide(opened, 0, 1.5)
    seen.append(opened.pixels())
    page.get_by_label("Modes are added to the").select_option("mean cycle")
    page.get_by_label("Time in the cycle").fill("0.5")
    seen.append(opened.pixels())
    page.get_by_role("button", name="Side").click()
    seen.append(opened.pixels())
    assert len(set(seen)) == len(seen)


def test_points_are_coloured_by_their_left_out_error_with_a_scale_in_mm(opened):
    page = opened.page
    before = opened.pixels()
    page.get_by_label("Colour").select_option("left-out error of the points")
    assert opened.pixels() != before
    legend = page.locator(".viewer .legend").text_content()
    assert legend.startswith("error of left-out shapes, RMS (mm)0")
    assert float(legend.split("\u2265")[1]) > 0.0
    slide(opened, 0, 2)
    assert page.locator(".viewer .legend").text_content() == legend


def test_points_are_coloured_by_their_distance_from_the_chosen_training_shape(opened):
    page = opened.page
    page.get_by_label("Colour").select_option("distance from the training shape")
    assert "Choose a training shape" in page.get_by_role("status").text_content()
    page.get_by_label("Put the sliders at").select_option(index=3)
    page.get_by_label("overlay the shape itself").uncheck()
    near = opened.pixels()
    page.get_by_role("button", name="Mean shape").click()
    assert opened.pixels() != near
    assert "distance from the training shape (mm)" in (
        page.locator(".viewer .legend").text_content()
    )


def test_points_are_coloured_by_a_field_of_the_mean_or_of_the_chosen_training_shape(opened):
    page, legend = opened.page, opened.page.locator(".viewer .legend")
    before = opened.pixels()
    page.get_by_label("Colour").select_option("voltage")
    mean = opened.pixels()
    assert mean != before
    assert legend.text_content().startswith("voltage (mV), mean of the shapes\u2264 \u2212")
    page.get_by_label("overlay the shape itself").uncheck()
    page.get_by_label("Put the sliders at").select_option(index=1)
    page.get_by_role("button", name="Mean shape").click()
    assert opened.pixels() != mean
    assert "voltage (mV), of the training shape" in legend.text_content()
    page.get_by_label("Colour").select_option("region")
    assert legend.text_content() == "region, of the training shape37"
    page.get_by_label("Put the sliders at").select_option("none")
    assert legend.text_content() == "region, most frequent label37"


def test_every_control_is_reached_and_worked_with_the_keyboard_alone(opened):
    page = opened.page
    reached = set()
    for _ in range(60):
        page.keyboard.press("Tab")
        reached.add(
            page.evaluate(
                """() => {
                  const e = document.activeElement;
                  if (!e.closest('.viewer')) return e.tagName;
                  if (e.tagName === 'CANVAS') return 'CANVAS';
                  if (e.dataset.mode) return 'mode ' + e.dataset.mode;
                  return e.closest('label')?.textContent.split('\\n')[0].slice(0, 12)
                    ?? e.textContent;
                }"""
            )
        )
    assert {"CANVAS", "mode 0", "mode 5", "Mean shape", "Play", "Front", "Side"} <= reached
    assert {
        "Variation of",
        "Modes are ad",
        "Time in the ",
        "Colour partd",
        "Put the slid",
    } <= reached
    assert {" wireframe", " openings an", " overlay the"} <= reached
    page.get_by_role("button", name="Play").focus()
    page.keyboard.press("Enter")
    assert page.get_by_role("button", name="Pause").is_visible()
    page.get_by_label("wireframe").focus()
    page.keyboard.press("Space")
    assert page.get_by_label("wireframe").is_checked()


def test_a_training_shape_is_put_on_the_sliders_and_overlaid(opened):
    page = opened.page
    before = opened.pixels()
    page.get_by_label("Put the sliders at").select_option(index=3)
    with_overlay = opened.pixels()
    page.get_by_label("overlay the shape itself").uncheck()
    assert len({before, with_overlay, opened.pixels()}) == 3
    status = page.get_by_role("status").text_content()
    away = float(re.search(r"is ([\d.]+) mm", status).group(1))
    assert away < 0.5  # what six of fourteen modes leave of noise of 0.35 mm
    assert any(float(page.locator(f'input[data-mode="{k}"]').input_value()) != 0 for k in range(6))
    page.get_by_label("Put the sliders at").select_option("none")
    assert opened.pixels() == before


NARROW = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
DARK = {"color_scheme": "dark"}


@pytest.mark.parametrize("opened", [NARROW, DARK, {**NARROW, **DARK}], indirect=True)
def test_small_and_dark_screens_show_everything_without_scrolling_sideways(opened):
    page = opened.page
    width = page.viewport_size["width"]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    before = opened.pixels()
    slide(opened, 0, 2)
    assert opened.pixels() != before


@pytest.mark.parametrize("opened", [{}, NARROW, DARK], indirect=True)
def test_no_serious_fault_of_accessibility_is_found(opened):
    if not AXE.is_file():
        pytest.skip("axe-core is missing: cd viewer && npm ci")
    opened.page.evaluate(AXE.read_text("utf-8"))
    found = opened.page.evaluate("() => axe.run()")["violations"]
    grave = [
        (fault["id"], [node["target"] for node in fault["nodes"]])
        for fault in found
        if fault["impact"] in {"serious", "critical"}
    ]
    assert grave == []


def test_without_javascript_the_page_says_where_the_pictures_are(chromium, report):
    context = chromium.new_context(java_script_enabled=False, offline=True)
    page = context.new_page()
    page.goto(report.as_uri())
    assert page.locator("#viewer-fallback").is_visible()
    assert page.locator("#modes img").count() > 0
    context.close()


def test_without_webgl_the_page_says_where_the_pictures_are(chromium, report):
    context = chromium.new_context(offline=True)
    context.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    opened = Opened(context, report)
    assert opened.page.locator("#viewer-fallback").is_visible()
    assert opened.page.locator("#viewer figure img").is_visible()
    assert opened.complaints == []
    context.close()


def test_a_driver_that_fails_later_leaves_the_pictures(chromium, report):
    context = chromium.new_context(offline=True)
    context.add_init_script(
        """
        const plain = HTMLCanvasElement.prototype.getContext;
        let asked = 0;
        HTMLCanvasElement.prototype.getContext = function (kind, options) {
          if (kind !== 'webgl2') return plain.call(this, kind, options);
          asked += 1;
          return asked === 1 ? plain.call(this, kind, options) : null;
        };
        """
    )
    page = context.new_page()
    page.goto(report.as_uri())
    assert page.locator("#viewer-root").get_attribute("data-ready") is None
    assert page.locator("#viewer-fallback").is_visible()
    assert page.locator("#viewer figure img").is_visible()
    context.close()
