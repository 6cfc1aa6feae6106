"""The page of a run, in a real browser where there is one."""

import json
import re
import shutil

import numpy as np
import pytest

import jaxgel
from jaxgel.cases import page as view
from jaxgel.cli import command_line as cli


@pytest.fixture(scope="module")
def page_file(run_folder, tmp_path_factory):
    """The page of the shared run, four states of sample 1."""
    file = tmp_path_factory.mktemp("view") / "page.html"
    assert cli.main(["view", str(run_folder), "--out", str(file)]) == 0
    return file


def test_page_holds_its_data_and_asks_the_network_for_nothing(page_file, path):
    text = page_file.read_text()
    assert not re.search(
        r"(src|href)\s*=\s*[\"'](?!data:)|https?://(?!www\.w3\.org/2000/svg)|@import", text
    )
    data = json.loads(
        re.search(r'<script type="application/json" id="data">(.*?)</script>', text).group(1)
    )
    assert data["value"] == path.mu.tolist()
    # percent
    assert data["columns"]["area_reduction"]["values"] == pytest.approx(
        (100 * jaxgel.area_reduction(path)).tolist()
    )
    assert np.shape(data["field"]["states"]) == (4, len(data["triangles"]))
    drawn = (
        np.array(data["vertices"][3]).reshape(-1, 2)[np.unique(data["triangles"])]
        * 22
        / view.RESOLUTION
    )
    # the walls
    np.testing.assert_allclose(
        [drawn.min(), drawn.max()], [-11.0, 11.0], rtol=0, atol=0.5 * 22 / view.RESOLUTION
    )


@pytest.mark.thorough
def test_names_cannot_end_the_data_of_a_page(path):
    assert "</script><b>" not in view.page(path, title="</script><b>")


@pytest.mark.slow
def test_the_page_of_a_path_in_time_has_its_times_the_uptake_and_a_logarithmic_axis(in_time):
    data = json.loads(
        re.search(
            r'<script type="application/json" id="data">(.*?)</script>', view.page(in_time)
        ).group(1)
    )
    assert (
        data["control"] == {"label": "time t", "unit": ""} and data["time"] and data["logarithmic"]
    )
    assert data["value"] == in_time.t.tolist()
    assert data["columns"]["uptake"]["values"] == pytest.approx(
        np.asarray(jaxgel.uptake(in_time)).tolist()
    )
    assert data["field"]["label"] == "volume ratio J"


@pytest.fixture(scope="module")
def browser():
    """A headless Chromium."""
    program, driver = (
        shutil.which("chromium") or shutil.which("google-chrome"),
        shutil.which("chromedriver"),
    )
    if not (program and driver):
        pytest.skip("no browser here: install chromium and chromedriver to try the page")
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = program
    for option in (
        "--headless=new",
        "--no-sandbox",
        "--disable-dev-shm-usage",
        "--window-size=1200,900",
    ):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(driver))
    yield driver
    driver.quit()


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_slider_moves_the_pattern_and_the_curve_without_an_error(page_file, path, browser):
    browser.get(page_file.as_uri())
    pictures = []
    for state, mu in enumerate(path.mu):
        moved = (
            "const s = document.getElementById('state'); s.value = arguments[0]; "
            "s.dispatchEvent(new Event('input'));"
        )
        browser.execute_script(moved, state)
        assert browser.execute_script(
            "return document.getElementById('value').textContent"
        ).startswith(f"{mu:.4f} kT")
        marker = browser.execute_script(
            "return Number(document.getElementById('here').getAttribute('cx'))"
        )
        assert marker == pytest.approx(70 + 395 * (mu - path.mu[0]) / (path.mu[-1] - path.mu[0]))
        pictures.append(
            browser.execute_script("return document.getElementById('pattern').toDataURL()")
        )
    assert len(set(pictures)) == 4
    assert np.min([len(picture) for picture in pictures]) > 5000  # something is drawn
    assert browser.get_log("browser") == []


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_the_slider_shows_times_and_the_curve_their_logarithms(in_time, browser, tmp_path):
    (tmp_path / "page.html").write_text(view.page(in_time))
    browser.get((tmp_path / "page.html").as_uri())
    moved = (
        "const s = document.getElementById('state'); s.value = arguments[0]; s.dispatchEvent(new "
        "Event('input'));"
    )
    markers = []
    for state in (0, 1, 4, len(in_time) - 1):
        browser.execute_script(moved, state)
        shown = browser.execute_script(
            "return document.getElementById('value').textContent"
        ).split()
        assert float(shown[0]) == float(f"{in_time.t[state]:.3g}")
        markers.append(
            browser.execute_script(
                "return Number(document.getElementById('here').getAttribute('cx'))"
            )
        )
    first, middle, last = np.log10(in_time.t[[1, 4, -1]])
    assert markers[0] == 70 and markers[3] == pytest.approx(465)
    assert (markers[2] - markers[1]) / (markers[3] - markers[1]) == pytest.approx(
        (middle - first) / (last - first)
    )
    assert browser.get_log("browser") == []
