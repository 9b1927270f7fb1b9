"""The page in a browser: what is drawn, and that its buttons do what they say."""

import io
import shutil
import threading
import time

import numpy as np
import pytest

from diffuphy.viewer.page import Page
from diffuphy.viewer.server import serve
from diffuphy.viewer.session import Session
from diffuphy.viewer.training import Training
from tests.viewer.runs import SIZE, ball, run

pytest.importorskip("viser")

SOFTWARE_WEBGL = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
SCENE = {"x": 0, "y": 150, "width": 760, "height": 550}
"""The part of the window without panel and notices."""


@pytest.fixture
def shown(tmp_path):
    """A page that a thread keeps up to date, as ``Page.run`` does."""
    server = serve(port=18100)
    page = Page(Session(run(tmp_path)), server)
    stop = threading.Event()
    failed = []

    def update():
        while not stop.wait(1 / 60):
            try:
                page.update()
            except Exception as error:
                failed.append(error)
                return

    thread = threading.Thread(target=update, daemon=True)
    thread.start()
    yield page
    stop.set()
    thread.join()
    page.session.close()
    server.stop()
    assert not failed, failed


@pytest.fixture
def browser():
    """Chromium without a screen, drawing in software."""
    api = pytest.importorskip("playwright.sync_api")
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("needs Chromium on the path")
    with api.sync_playwright() as p:
        chromium = p.chromium.launch(executable_path=program, args=SOFTWARE_WEBGL)
        yield chromium.new_page(viewport={"width": 1100, "height": 900})
        chromium.close()


def picture(tab) -> np.ndarray:
    """The scene as it is drawn now, (H, W, 3)."""
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(tab.screenshot(clip=SCENE))).convert("RGB")).astype(int)


def colored(rgb: np.ndarray) -> np.ndarray:
    """Where something other than the grey floor is drawn."""
    return rgb.max(-1) - rgb.min(-1) > 40


def until(test, what: str, tab, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not test():
        assert time.monotonic() < end, what
        tab.wait_for_timeout(100)


def visit(tab, server) -> list[str]:
    errors: list[str] = []
    tab.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
    tab.on("pageerror", lambda e: errors.append(str(e)))
    tab.goto(f"http://127.0.0.1:{server.get_port()}")
    until(lambda: colored(picture(tab)).sum() > 500, "the body is drawn", tab)
    return errors


def test_a_page_goes_on_without_a_browser(shown):
    """Frames follow the clock, the panel says what is played."""
    before = shown._shown
    time.sleep(0.3)
    assert shown._shown != before and shown.panel.title.content == "as in the film"


def test_the_panel_asks_for_no_more_than_was_touched(shown):
    """An untouched panel is a draft of the film; a touched one has what was set, and that alone."""
    panel = shown.panel
    assert str(panel.change()) == "as in the film, 2000 particles"
    panel.height.value, panel.stiffness.value, panel.material.value = 1.25, 1.0, "jelly"
    change = panel.change()
    assert (change.height, change.stiffness, change.material) == (1.25, 10.0, "jelly")
    assert change.velocity is None and change.gravity is None


@pytest.mark.slow
def test_the_body_falls_on_the_page_and_is_painted(shown, browser):
    """Frame 5 is drawn lower than frame 0; another view has other colours in the same places, and a legend."""
    player, session = shown.session.player, shown.session
    player.playing = False
    player.seek(0)
    errors = visit(browser, shown.server)

    def drawn(frame):
        player.seek(frame)
        browser.wait_for_timeout(1500)
        return picture(browser)

    first, last = drawn(0), drawn(5)
    row = [float(np.nonzero(colored(p))[0].mean()) for p in (first, last)]
    assert row[1] > row[0] + 10  # 0.14 m of a fall that fills a third of the picture
    browser.get_by_role("button", name="Play").wait_for()
    session.paint("velocity")
    browser.wait_for_timeout(1500)
    painted = picture(browser)
    both = colored(painted) & colored(last)
    assert both.sum() > 500 and np.abs(painted - last)[both].mean() > 20
    # viser's own, at the first frame of splats: its bounding sphere is not used
    assert [e for e in errors if "computeBoundingSphere" not in e] == []


@pytest.mark.slow
def test_a_press_simulates_again_and_a_drag_lifts_the_body(shown, browser):
    """Three presses and a drag, all by the browser."""
    session = shown.session
    visit(browser, shown.server)
    browser.get_by_role("button", name="Simulate", exact=True).click()
    until(lambda: session.shot is not session.film, f"simulated: {session.job.message}", browser)
    browser.get_by_text("of motion in").wait_for()
    browser.get_by_role("button", name="Start", exact=True).click()
    until(lambda: session.live is not None and session.live.number > 60, "it lies on the floor", browser)
    browser.wait_for_timeout(1000)
    rows, columns = np.nonzero(colored(picture(browser)))
    x, y = float(np.median(columns)), float(np.median(rows)) + SCENE["y"]
    lain = float(session.live.latest.x[:, 2].mean())
    browser.mouse.move(x, y)
    browser.mouse.down()
    for k in range(1, 13):
        browser.mouse.move(x, y - 20 * k)
        browser.wait_for_timeout(60)
    high = lambda: float(session.live.latest.x[:, 2].mean()) > lain + 0.2 * SIZE  # noqa: E731
    until(high, f"lifted: {session.live.message}", browser)
    assert colored(picture(browser)).sum() > 500
    browser.mouse.up()
    until(lambda: not high(), "it falls again", browser)
    browser.get_by_role("button", name="End", exact=True).click()
    until(lambda: session.live is None, "it ends", browser)


@pytest.mark.slow
def test_gaussians_grow_on_the_page_of_a_training(browser):
    """Pictures that a stage hands over are drawn, with how far it is."""
    server = serve(port=18200, title="training")
    watch = Training(server)
    try:
        browser.goto(f"http://127.0.0.1:{server.get_port()}")
        gaussians, _ = ball(8)
        step = [0]

        def trained():
            step[0] += 1
            watch("gaussians", step[0], 1000, lambda: gaussians)
            return colored(picture(browser)).sum() > 500

        until(trained, "Gaussians are drawn", browser)
        browser.get_by_text("of 1000").wait_for()
    finally:
        watch.close()
