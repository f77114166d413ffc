"""Reports opened in headless Chromium, on a wide and a narrow screen and on paper (needs chromium and chromedriver)."""

import json
import re
from base64 import b64decode
from pathlib import Path

import pytest

from surveysim import load_scene, run, run_sweep
from surveysim.paper.reproduce import reproduce
from surveysim.paper.scenes import wanted
from surveysim.runtime.engine import SERIAL
from tests.scenes import SMALL_SCENE, without_sections
from tests.unit.paper.test_reproduce import SCENE

pytestmark = pytest.mark.browser
CHROMIUM, DRIVER = "/usr/bin/chromium", "/usr/bin/chromedriver"
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
WIDE, NARROW = 1400, 360  # CSS pixels
SWEEP = '\n[sweep]\n"scan.speed" = ["3 arcmin / s", "4 arcmin / s", "5 arcmin / s"]\n'
PICTURES = "return [...document.images].map(image => image.complete && image.naturalWidth > 0)"
SIDEWAYS = "return document.documentElement.scrollWidth - document.documentElement.clientWidth"
SMALLEST = """
const texts = [...document.querySelectorAll('p, td, th, dd, li')]
return Math.min(...texts.map(text => parseFloat(getComputedStyle(text).fontSize)))
"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for option in (*OPTIONS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    """Pages of a run, a sweep and some of the paper's items, by name, and how many pictures each has."""
    folder = tmp_path_factory.mktemp("reports")
    (folder / "run.toml").write_text(SMALL_SCENE)
    run(load_scene(folder / "run.toml"), folder / "run", engine=SERIAL)
    (folder / "sweep.toml").write_text(without_sections(SMALL_SCENE, "sky") + SWEEP)
    run_sweep(folder / "sweep.toml", folder / "sweep", engine=SERIAL)
    (folder / "lynx.toml").write_text(SCENE)
    (folder / "sds1.toml").write_text(SCENE.replace("seed = 11", "seed = 12"))
    _, failed = reproduce(wanted((2, 3), (1, 2, 6, 16), folder, observations=None), folder / "paper", SERIAL)
    assert failed == []
    return {"run": (folder / "run", 10), "sweep": (folder / "sweep", 1), "paper": (folder / "paper", 4)}


def wrong(browser, path: Path, width: int) -> list[str]:
    """Faults of a page that is opened at a width: pictures, messages, requests, sideways scrolling."""
    screen = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    for log in ("browser", "performance"):
        browser.get_log(log)  # what was before
    own = path.resolve().as_uri()
    browser.get(own)
    found = [f"console: {entry['message']}" for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    found += ["picture: not loaded" for loaded in browser.execute_script(PICTURES) if not loaded]
    found += [f"request: {url[:100]}" for url in requests(browser) if url != own and not url.startswith("data:")]
    if (sideways := browser.execute_script(SIDEWAYS)) > 0:
        found.append(f"sideways: {sideways} pixels")
    if (smallest := browser.execute_script(SMALLEST)) < 12:
        found.append(f"text: of {smallest} pixels")
    return found


def requests(browser) -> list[str]:
    """Addresses requested since the log was last read."""
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    return [item["params"]["request"]["url"] for item in messages if item["method"] == "Network.requestWillBeSent"]


@pytest.mark.parametrize("width", [WIDE, NARROW])
@pytest.mark.parametrize("name", ["run", "sweep", "paper"])
def test_a_page_opens_whole(browser, reports, name, width):
    folder, pictures = reports[name]
    assert wrong(browser, folder / "report.html", width) == []
    assert len(browser.execute_script(PICTURES)) == pictures
    assert browser.execute_script("return document.querySelector('nav').getBoundingClientRect().height") > 100


@pytest.mark.parametrize("name", ["run", "sweep", "paper"])
def test_a_page_prints(browser, reports, name):
    """Paper of A4: as many pages as hold the text, and no picture wider or higher than one."""
    folder, pictures = reports[name]
    browser.get((folder / "report.html").resolve().as_uri())
    pdf = b64decode(browser.execute_cdp_cmd("Page.printToPDF", {"paperWidth": 8.27, "paperHeight": 11.69})["data"])
    assert pdf.startswith(b"%PDF") and len(re.findall(rb"/Type /Page\b(?!s)", pdf)) >= 3
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": 680, "height": 990, "deviceScaleFactor": 1, "mobile": False},  # 180 x 262 mm at 96 a inch
    )
    sizes = browser.execute_script("return [...document.images].map(i => [i.clientWidth, i.clientHeight])")
    sideways = browser.execute_script(SIDEWAYS)
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    assert len(sizes) == pictures and all(0 < width <= 680 and 0 < height <= 990 for width, height in sizes)
    assert sideways == 0


def test_these_checks_see_what_is_wrong(browser, reports, tmp_path):
    text = (reports["run"][0] / "report.html").read_text()
    bad = (
        '<img src="http://127.0.0.1:9/a.png" alt=""><img src="gone.png" alt="">'
        '<div style="width: 3000px">wide</div><p style="font-size: 3px">small</p>'
    )
    page = tmp_path / "bad.html"
    page.write_text(re.sub("<meta http-equiv[^>]*>", "", text).replace("</main>", f"{bad}</main>"))
    found = {line.partition(":")[0] for line in wrong(browser, page, NARROW)}
    assert found == {"console", "picture", "request", "sideways", "text"}
    # And its own policy refuses what lies outside.
    page.write_text(text.replace("</main>", f"{bad}</main>"))
    refused = [line for line in wrong(browser, page, WIDE) if "Content Security Policy" in line]
    assert any("a.png" in line for line in refused) and any("gone.png" in line for line in refused)
