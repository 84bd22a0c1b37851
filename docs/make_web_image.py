"""Make docs/web.png: the page over a simulated room, in headless Chromium.

uv run python docs/make_web_image.py
"""

from __future__ import annotations

import io
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

import lmkit

OUTPUT = Path(__file__).parent / "web.png"
DESKTOP, PHONE = {"width": 1120, "height": 760}, {"width": 400, "height": 760}
GAP = 24
LIVE_MS = 15_000


def main() -> None:
    """Write the image."""
    with tempfile.TemporaryDirectory() as name:
        room = Path(name) / "my-room"
        lmkit.write_example_files(room / "drives/example", board_pairs=0)
        for name_ in ("rig.yaml", "floor.yaml"):
            shutil.copy(room / "drives/example" / name_, room / name_)
        lmkit.print_landmarks(7).save(room / "landmark-7.pdf")
        words = [sys.executable, "-m", "lmkit", "web", str(room), "--port", "0"]
        server = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        assert server.stdout is not None
        lines = [server.stdout.readline(), server.stdout.readline()]
        found = re.search(r"http://\S+/", lines[1])
        assert found is not None
        try:
            shots = take(found.group(), room)
        finally:
            server.terminate()
            server.wait()
    width = sum(shot.width for shot in shots) + GAP * (len(shots) - 1)
    whole = Image.new("RGB", (width, shots[0].height), "#c9d2db")
    left = 0
    for shot in shots:
        whole.paste(shot, (left, 0))
        left += shot.width + GAP
    whole.resize((1600, round(1600 * whole.height / whole.width)), Image.Resampling.LANCZOS).save(
        OUTPUT, optimize=True
    )


def take(address: str, room: Path) -> list[Image.Image]:
    """Screenshots of a live run, of the map in 3D after a survey, and of a checked print on a phone."""
    with sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport=DESKTOP)
        page.set_default_timeout(120_000)
        visit(page, address, "recordings")
        page.get_by_role("button", name="Survey: build the map").click()
        page.get_by_role("link", name="Open the report").wait_for()
        shots = [live(page, address)]
        visit(page, address, "map")
        page.get_by_role("button", name="3D").click()
        page.get_by_role("img", name="in 3D").wait_for()
        page.wait_for_timeout(2000)
        shots.append(shot(page))
        page.set_viewport_size(PHONE)
        visit(page, address, "check")
        page.get_by_label("Photograph, scan or PDF").set_input_files(room / "landmark-7.pdf")
        page.locator(".grade.big").wait_for()
        page.evaluate("scrollTo(0, document.querySelector('.grade.big').getBoundingClientRect().top - 24)")
        shots.append(shot(page))
        browser.close()
    return shots


def live(page: Page, address: str) -> Image.Image:
    """Live while a simulated robot drives."""
    visit(page, address, "live")
    page.get_by_role("button", name="Watch a simulated robot").click()
    page.get_by_text("The last minute", exact=True).wait_for()
    page.get_by_text("Ok: the pose").wait_for()
    page.wait_for_timeout(LIVE_MS)
    page.evaluate("scrollTo(0, document.querySelector('.grid.wide').offsetTop - 72)")
    taken = shot(page)
    page.get_by_role("button", name="Stop").click()
    return taken


def visit(page: Page, address: str, name: str) -> None:
    """Open a page and wait until it is drawn."""
    page.goto(f"{address}#/{name}")
    page.wait_for_selector(f"main[data-ready={name}]")
    page.evaluate("document.getElementById('folder').textContent = 'my-room'")
    page.wait_for_timeout(500)


def shot(page: Page) -> Image.Image:
    """The window as an image."""
    return Image.open(io.BytesIO(page.screenshot())).convert("RGB")


if __name__ == "__main__":
    main()
