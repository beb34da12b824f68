"""The page of `view` in a browser without a screen: it loads, shows the robot, and its controls move it."""

import io
import shutil
import time
import urllib.request

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import sync_playwright

import kanejax as kj
from kanejax._view.scene import scene_of
from tests.helpers.seen_robots import swing, write_robots

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
# WebGL without a graphics card.
OPTIONS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
SIZE = {"width": 760, "height": 440}
PATIENCE = 60.0

in_a_browser = pytest.mark.skipif(
    CHROMIUM is None, reason="THE PAGE IS NOT TESTED: there is no chromium (apt-get install chromium)"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    write_robots(folder)
    return folder


@pytest.fixture(scope="module")
def motion():
    ts, q = swing()
    return {"ts": ts, "q": q, "u": q, "tau": q[1:]}


@pytest.fixture(scope="module")
def browser():
    with sync_playwright() as playwright:
        yield playwright.chromium.launch(executable_path=CHROMIUM, args=OPTIONS)


@pytest.fixture
def opened(browser):
    """A function that opens a page; the console's errors, and requests that leave this machine, are collected in a list."""
    faults: list[str] = []
    page = browser.new_page(viewport=SIZE)
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
    page.on(
        "request", lambda asked: None if asked.url.startswith(("http://127.0.0.1:", "data:", "blob:")) else faults.append(asked.url)
    )

    def open_page(url):
        page.goto(url)
        # That WebGL runs on the processor: it hides a part of the scene.
        page.locator(".mantine-Notification-closeButton").click()
        return page

    yield open_page, faults
    page.close()
    assert faults == []


def wait_for(condition):
    """Until it holds: pictures of a processor take their time."""
    end = time.monotonic() + PATIENCE
    while (found := condition()) is None or found is False:
        assert time.monotonic() < end, "in vain"
        time.sleep(0.05)
    return found


def image(page):
    """The scene beside the panel."""
    shot = page.locator("canvas").first.screenshot(timeout=1000.0 * PATIENCE)
    return np.array(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)


def red(page):
    """Middle of the red upper arm in the picture, nothing if it is hardly there."""
    r, g, b = np.moveaxis(image(page), 2, 0)
    places = np.argwhere((r > 90) & (r > 1.6 * g) & (r > 1.6 * b))
    return places.mean(0) if len(places) > 150 else None


@in_a_browser
def test_the_slider_moves_the_robot_in_the_picture(opened, folder, motion):
    open_page, _ = opened
    with kj.view(folder / "arm.urdf", motion, port=0) as view:
        page = open_page(view.url)
        first = wait_for(lambda: red(page))
        field = page.locator("input[inputmode=decimal]").first
        field.fill("0.5")
        field.press("Enter")
        wait_for(lambda: view.time == pytest.approx(0.5, abs=0.01))
        wait_for(lambda: (place := red(page)) is not None and np.linalg.norm(place - first) > 10.0)
        scene = scene_of(folder / "arm.urdf")
        placed = scene.postures(np.array([motion["q"][10]]))
        for body in range(4):
            np.testing.assert_allclose(view._page.node_pose(0, body)[1], placed.origin[0, body], atol=1e-2)
        page.get_by_role("button", name="play", exact=True).click()
        wait_for(lambda: view.time > 0.6)
        page.get_by_role("button", name="pause", exact=True).click()
        wait_for(lambda: not view.playing)
        paused = view.time
        time.sleep(0.3)
        assert view.time == paused
        page.get_by_label("shapes").uncheck()
        wait_for(lambda: red(page) is None)


@in_a_browser
def test_sliders_of_joints_pose_the_robot_and_a_mesh_that_is_missing_is_told(opened, folder):
    open_page, _ = opened
    (folder / "bare.urdf").write_text((folder / "arm.urdf").read_text().replace("tetrahedron.stl", "gone.stl"))
    with kj.view(folder / "bare.urdf", port=0) as view:
        assert "'gone.stl' is not there" in view.notes[0]
        page = open_page(view.url)
        first = wait_for(lambda: red(page))
        fields = page.locator("input[inputmode=decimal]")
        wait_for(lambda: fields.count() == 3)
        fields.first.fill("-1.2")
        fields.first.press("Enter")
        wait_for(lambda: (place := red(page)) is not None and np.linalg.norm(place - first) > 10.0)
        placed = scene_of(folder / "arm.urdf").postures(np.array([[-1.2, 0.0, 0.1]]))
        np.testing.assert_allclose(view._page.node_pose(0, 3)[1], placed.origin[0, 3], atol=1e-6)
        page.get_by_role("button", name="reference posture").click()
        wait_for(lambda: (place := red(page)) is not None and np.linalg.norm(place - first) < 3.0)
        page.get_by_text("notes").click()
        wait_for(lambda: page.get_by_text("gone.stl").count() > 0)


def test_the_page_is_served_to_this_machine_alone_until_it_is_closed(folder, motion):
    view = kj.view(folder / "arm.urdf", [motion, motion], rows=(0,), reference=motion, port=0)
    try:
        assert view.url.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(view.url, timeout=20) as page:
            assert page.status == 200
        assert view._repr_html_().startswith(f'<iframe src="{view.url}"')
        assert repr(view) == f"<view at {view.url}>"
        view.show_time(7.0)
        assert view.time == 1.0
        second = view._page.node_pose(1, 1)[1]
        np.testing.assert_allclose(view._page.node_pose(0, 1)[1], second)
        view.play()
        wait_for(lambda: 0.0 < view.time < 0.9)
        view.pause()
        assert not view.playing
    finally:
        view.close()
    with pytest.raises(OSError):  # noqa: PT011
        urllib.request.urlopen(view.url, timeout=5)


def test_an_address_of_another_machine_is_refused(folder):
    with pytest.raises(kj.KanejaxError, match=r"host '192\.0\.2\.1' is no address of this machine"):
        kj.view(folder / "arm.urdf", host="192.0.2.1", port=0)
