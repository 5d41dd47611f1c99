"""Draw the pictures of a report for the documentation: ``docs/images/report-*.png``.

Needs the results of ``ostiform demo`` and a Chromium (``pip install --group browser``)::

    ostiform demo -o demo
    python examples/report_pictures.py demo/results docs/images
"""

import argparse
import io
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

WIDTH = 900
"""Pixels of a picture at most."""
MOST_BYTES = 150_000
COLOURS = (256, 128, 64)
WINDOW = {"width": 1100, "height": 800}
FIGURES = {
    "points": "#viewer figure",
    "modes": "#modes figure",
    "evidence": "#evidence figure",
    "shapes": "#shapes figure",
    "scores": "#scores figure",
    "levels": "#cycles figure",
    "volumes": "#volumes figure",
    "clinical": "#clinical figure",
    "maps": "#maps figure",
}


def main() -> None:
    """Open the report and save its headline, its viewer and the first figure of each section."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=Path, help="output folder of a build")
    parser.add_argument("images", type=Path, help="folder for the pictures")
    given = parser.parse_args()
    report = given.results / "report.html"
    path = shutil.which("chromium") or shutil.which("chrome")
    if path is None or not report.is_file():
        parser.error(f"expected {report} and a Chromium on the PATH, found one of them missing")
    given.images.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=path, args=["--no-sandbox", "--enable-unsafe-swiftshader"]
        )
        page = browser.new_page(viewport=WINDOW)
        page.goto(report.resolve().as_uri())
        page.wait_for_selector("#viewer-root[data-ready]")
        for name, png in pictures(page).items():
            (given.images / f"report-{name}.png").write_bytes(small(png))
        browser.close()


def pictures(page: Page) -> dict[str, bytes]:
    """Return the pictures of a report by name, as the browser draws them."""
    found = {"headline": page.locator("header").screenshot()}
    page.get_by_label("Colour").select_option("left-out error of the points")
    page.locator('input[data-mode="0"]').fill("1.5")
    found["viewer"] = page.locator("#viewer-root").screenshot()
    for name, selector in FIGURES.items():
        found[name] = page.locator(f"{selector} .picture").first.screenshot()
    return found


def small(png: bytes) -> bytes:
    """Return a picture of few bytes: not wider than `WIDTH`, with a palette."""
    image = Image.open(io.BytesIO(png)).convert("RGB")
    image.thumbnail((WIDTH, 4 * WIDTH), Image.Resampling.LANCZOS)
    encoded = b""
    for colours in COLOURS:
        buffer = io.BytesIO()
        image.quantize(colours, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(
            buffer, "png", optimize=True
        )
        encoded = buffer.getvalue()
        if len(encoded) < MOST_BYTES:
            break
    return encoded


if __name__ == "__main__":
    main()
