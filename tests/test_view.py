"""The page of a run, in a real browser where there is one, and how a path shows itself in a notebook."""

import json
import re
import shutil

import numpy as np
import pytest

import jaxgel
import jaxgel.results
from jaxgel import cli, view


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    """A short run of a coarse plate with two holes, one of which the edge cuts."""
    folder = tmp_path_factory.mktemp("view")
    case = folder / "two <holes>.toml"
    case.write_text(
        "[plate]\nwidth = 4.0\nheight = 2.0\n[[holes]]\nkind = 'circle'\ncentre = [-1.0, 0.0]\nradius = 0.5\n"
        "[[holes]]\nkind = 'circle'\ncentre = [2.0, 0.0]\nradius = 0.5\n[sweep]\nmu = [-4.0, -2.0, -1.0]\n[discretisation]\nspacing = 0.4\n"
    )
    assert cli.main(["run", str(case), "--out", str(folder / "run"), "--quiet", "--no-plots"]) == 0
    assert cli.main(["view", str(folder / "run")]) == 0
    return folder / "run"


def test_page_holds_its_data_and_asks_the_network_for_nothing(run_folder):
    text = (run_folder / view.PAGE).read_text()
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!data:)|https?://(?!www\.w3\.org/2000/svg)|@import", text)
    data = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text).group(1))
    path = jaxgel.results.load_path(run_folder)
    assert data["mu"] == path.mu.tolist()
    assert data["title"] == "two <holes>"
    assert data["columns"]["area_reduction"]["values"] == pytest.approx(jaxgel.area_reduction(path).tolist())
    left = min(data["vertices"][2][::2]) * 4.0 / view.RESOLUTION  # the left wall, to half a step
    assert left == pytest.approx(-2.0, abs=0.5 * 4.0 / view.RESOLUTION)


def test_a_path_shows_itself_in_a_notebook(run_folder):
    shown = jaxgel.results.load_path(run_folder)._repr_html_()
    assert shown.count("<tr>") == 4
    assert "data:image/png;base64," in shown


@pytest.fixture(scope="module")
def browser():
    """A headless Chromium."""
    program, driver = shutil.which("chromium") or shutil.which("google-chrome"), shutil.which("chromedriver")
    if not (program and driver):
        pytest.skip("no browser here: install chromium and chromedriver to try the page")
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = program
    for option in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1200,900"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(driver))
    yield driver
    driver.quit()


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_slider_moves_the_pattern_and_the_curve_without_an_error(run_folder, browser):
    browser.get((run_folder / view.PAGE).as_uri())
    pictures = []
    for state, mu in enumerate(["-4.0000", "-2.0000", "-1.0000"]):
        moved = "const s = document.getElementById('state'); s.value = arguments[0]; s.dispatchEvent(new Event('input'));"
        browser.execute_script(moved, state)
        assert browser.execute_script("return document.getElementById('mu').textContent").startswith(mu)
        marker = browser.execute_script("return Number(document.getElementById('here').getAttribute('cx'))")
        assert marker == pytest.approx(70 + 395 * (float(mu) + 4) / 3)
        pictures.append(browser.execute_script("return document.getElementById('pattern').toDataURL()"))
    assert len(set(pictures)) == 3
    assert np.min([len(picture) for picture in pictures]) > 5000  # something is drawn
    assert browser.get_log("browser") == []
