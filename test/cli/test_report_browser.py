"""The report as a reader meets it: in Chromium, from a file, without network. Skipped where there is no Chromium."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import CHROMIUM, DRIVER, Browser, browser

pytest.importorskip("plotly", reason="the extra 'report' is not installed")
pytestmark = pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="chromium and chromedriver are not installed")

RANGE = "return document.getElementById(arguments[0])._fullLayout.xaxis.range"


@pytest.fixture(scope="module")
def page(jointest: Any, shell: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "out"
    assert jointest("evaluate", shell, "-c", f"{shell}.yaml", "--report", folder, "--json", "-").code == 0
    return folder / "index.html"


@pytest.fixture(scope="module")
def window(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("profile")) as one:
        yield one


@pytest.fixture
def opened(window: Browser, page: Path) -> Browser:
    window.open(page)
    window.until("return document.documentElement.dataset.ready")
    return window


def show(window: Browser, plot: str) -> None:
    """Scroll to a plot and wait until it is drawn."""
    window.run("document.getElementById(arguments[0]).scrollIntoView({block: 'center'})", plot)
    window.until("return document.getElementById(arguments[0]).querySelector('.main-svg') !== null", plot)


def test_every_plot_is_drawn_without_a_complaint_or_a_request(opened: Browser) -> None:
    plots = opened.run("return [...document.querySelectorAll('.chart')].map((plot) => plot.id)")
    expected = {"comparison-bars", "nees", "nis", "innovations", "intervals", "torso-errors"}
    expected |= {f"{kind}-joint_{n}" for kind in ("angle", "distribution", "velocity") for n in range(1, 5)}
    assert set(plots) == expected
    drawn = "return [...document.querySelectorAll('.chart')].filter((plot) => plot.querySelector('.main-svg')).length"
    assert opened.run(drawn) < len(plots)  # the others when they are seen
    for plot in plots:
        show(opened, plot)
        lines = "return document.getElementById(arguments[0]).querySelectorAll('.js-line, .point path').length"
        assert opened.until(lines, plot) >= 1
    assert opened.complaints() == []
    assert opened.run("return performance.getEntriesByType('resource').length") == 0


def test_a_drag_zooms_and_all_time_axes_follow(opened: Browser) -> None:
    show(opened, "angle-joint_2")
    show(opened, "angle-joint_1")
    whole = opened.run(RANGE, "angle-joint_1")
    box = opened.run(
        "const b = document.getElementById('angle-joint_1').querySelector('.nsewdrag').getBoundingClientRect();"
        "return [b.left, b.top, b.width, b.height]"
    )
    left, top, width, height = box
    opened.drag((left + 0.25 * width, top + 0.5 * height), (left + 0.75 * width, top + 0.5 * height))
    opened.until("return document.getElementById('angle-joint_1').layout.xaxis.range !== undefined")
    span = whole[1] - whole[0]
    zoomed = opened.run(RANGE, "angle-joint_1")
    assert zoomed == pytest.approx([whole[0] + 0.25 * span, whole[0] + 0.75 * span], abs=0.02 * span)
    opened.until(
        "const [a, b] = ['angle-joint_1', 'angle-joint_2'].map((id) => document.getElementById(id)._fullLayout.xaxis);"
        "return Math.abs(a.range[0] - b.range[0]) + Math.abs(a.range[1] - b.range[1]) < 1e-6"
    )
    show(opened, "nees")  # drawn only now
    assert opened.run(RANGE, "nees") == pytest.approx(zoomed)


def test_what_a_legend_hides_is_hidden_everywhere_and_the_error_axis_follows(opened: Browser) -> None:
    show(opened, "angle-joint_1")
    before = opened.run("return document.getElementById('angle-joint_1')._fullLayout.yaxis2.range")
    for name in ("gyro", "hall"):
        opened.run(
            "const plot = document.getElementById('angle-joint_1');"
            "const rows = plot.data.map((t, i) => t.legendgroup === arguments[0] ? i : -1).filter((i) => i >= 0);"
            "Plotly.restyle(plot, {visible: 'legendonly'}, rows)",
            name,
        )
    after = opened.until(
        "const range = document.getElementById('angle-joint_1')._fullLayout.yaxis2.range;"
        "return range[1] - range[0] < arguments[0] ? range : null",
        0.5 * (before[1] - before[0]),
    )
    assert after[0] < 0.0 < after[1]
    show(opened, "comparison-bars")
    hidden = "return document.getElementById('comparison-bars').data.filter((t) => t.visible === 'legendonly').length"
    assert opened.until(hidden) == 2


def test_the_buttons_of_a_plot_cover_no_entry_of_its_legend(opened: Browser) -> None:
    show(opened, "angle-joint_1")
    places = opened.run(
        "const plot = document.getElementById('angle-joint_1');"
        "return ['.legend', '.modebar-group'].map((one) => plot.querySelector(one).getBoundingClientRect())"
        ".map((box) => [box.top, box.bottom, box.left, box.right])"
    )
    (legend_top, *_), (_, bottom, left, right) = places
    assert bottom <= legend_top
    title = opened.run(
        "const box = document.createRange();"
        "box.selectNodeContents(document.getElementById('angle-joint_1').previousElementSibling);"
        "return box.getBoundingClientRect().right"
    )
    assert title < left < right


def test_a_joint_in_the_table_leads_to_its_plot(opened: Browser) -> None:
    opened.run("document.querySelector('#errors-joints a[href$=joint_3]').click()")
    top = "const box = document.getElementById('angle-joint_3').getBoundingClientRect();"
    opened.until(top + "return box.top > 0 && box.top < 300")
    opened.until("return document.getElementById('angle-joint_3').querySelector('.main-svg') !== null")


def test_colours_follow_the_reader(opened: Browser) -> None:
    show(opened, "angle-joint_1")
    back = "document.getElementById('angle-joint_1')._fullLayout.paper_bgcolor"
    for scheme, plot, page in (("dark", "#16181c", "rgb(22, 24, 28)"), ("light", "#ffffff", "rgb(255, 255, 255)")):
        opened.prefer(scheme)
        opened.until(f"return {back} === arguments[0]", plot)
        assert opened.run("return getComputedStyle(document.body).backgroundColor") == page


def test_all_is_drawn_and_unfolded_for_print(opened: Browser) -> None:
    opened.run("window.dispatchEvent(new Event('beforeprint'))")
    opened.until("return [...document.querySelectorAll('.chart')].every((plot) => plot.querySelector('.main-svg'))")
    assert opened.run("return [...document.querySelectorAll('details')].every((one) => one.open)")
