"""The page on which a run is begun, in Chromium: a folder is chosen, a run begun, stopped, resumed and opened; strangers begin
nothing."""

from __future__ import annotations

import json
import os
import re
import shutil
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_app.commands.run.control import stop_run
from radiant_app.files.system_file import load_system
from radiant_core.errors import BadInput
from radiant_core.io.ply import load_ply
from radiant_viewer.web.start_server import PICTURE_WH
from tests.viewer.test_start_window import FLIGHT
from tests.viewer.window_kit import ROOT, page_server

DEADLINE_S = 300
"""For each step, on a busy machine."""


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    pytest.importorskip("trame_vuetify", reason="the extra 'web' is not installed")
    log = tmp_path / "server.log"
    with page_server("tests.viewer.web_start_server", log=log, patience_s=DEADLINE_S) as (found, interrupt):
        yield found
        interrupt()
    words = log.read_text()
    assert not [line for line in words.splitlines() if line and "KeyboardInterrupt" not in line and "Error" in line], words


@pytest.fixture
def photographs(tmp_path: Path) -> Iterator[Path]:
    pytest.importorskip("pycolmap", reason="the extra 'sfm' is not installed")
    shutil.copytree(ROOT / "sample_scenes/hamlet/images", tmp_path / "hamlet/images")
    (tmp_path / "flight.csv").write_text(FLIGHT)
    yield tmp_path / "hamlet"
    # A run outlives its page, also of a test that failed.
    with suppress(BadInput):
        stop_run(tmp_path / "hamlet_run")


def text_once(page: Any, selector: str, text: str) -> str:
    """The text of an element as soon as it has `text`."""
    page.locator(selector, has_text=text).first.wait_for()
    return page.locator(selector).first.inner_text()


def without_overflow(page: Any) -> None:
    wide = page.evaluate(
        "document.documentElement.scrollWidth <= innerWidth ? [] : [...document.querySelectorAll('*')]"
        ".filter(part => part.getBoundingClientRect().right > innerWidth).map(part => part.tagName + '#' + part.id)"
    )
    assert not wide, f"the page is wider than the screen: {wide}"


def nothing_cut_off(page: Any) -> None:
    """No field of the list of machines, and no word of the heading, at this width."""
    cut = page.evaluate(
        "[...document.querySelectorAll('#form, #form input')].filter(part => part.scrollWidth > part.clientWidth).map(part => part.id)"
    )
    # The path of the list may be longer than any field.
    assert set(cut) <= {"list"}, cut
    assert page.locator("#form select").bounding_box()["width"] > 100, "the kind of a machine cannot be read"
    headings = [box["height"] for box in page.locator("#form th").evaluate_all("all => all.map(one => one.getBoundingClientRect())")]
    assert max(headings) < 30, "a heading of the list is broken"
    button, words = (page.locator(f"#qualities {part}").first.bounding_box() for part in ("input", "span"))
    middles = [box["y"] + box["height"] / 2 for box in (button, words)]
    assert abs(middles[0] - middles[1]) < 1.5, "a button of the quality stands beside its line"
    assert page.locator("h1").bounding_box()["height"] < 40, "the heading is broken"


def test_a_run_is_chosen_begun_stopped_resumed_and_opened(browser: Any, address: str, photographs: Path) -> None:
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    page.set_default_timeout(1000 * DEADLINE_S)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(address)
    page.locator("#path").fill(str(photographs.parent))
    page.locator("#browse").click()
    page.locator("#browser button", has_text="hamlet/").click()
    page.locator("#browser button.main", has_text=str(photographs)).click()
    assert text_once(page, "#found", "photographs, ").startswith("12 photographs, ")
    assert text_once(page, "#forecast", "Time: about ").count("\n") >= 2
    out = photographs.with_name("hamlet_run")
    assert page.locator("#line").inner_text() == f"radiant run {photographs} --out {out}"
    painted = "canvas => canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.some(level => level > 0)"
    assert page.locator("#map").evaluate(painted), "no place is on the map"

    page.locator("#machines").select_option("form")
    text_once(page, "#line", "--system")
    listed = Path(page.locator("#list").input_value())
    assert not listed.exists()
    for width in (390, 1920, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        nothing_cut_off(page)
    assert page.locator("#message").is_hidden(), "an empty line is in the way"
    page.locator("#form input[aria-label='Number']").fill("many")
    page.locator("#form input[aria-label='Number']").blur()
    assert "count" in text_once(page, "#refused", "count")
    page.locator("#form input[aria-label='Number']").fill("2")
    page.locator("#form input[aria-label='Number']").blur()
    text_once(page, "#line", "--system")

    page.locator("#start").click()
    assert text_once(page, "#message", "Begun: ") == f"Begun: radiant run {photographs} --out {out} --system {listed}"
    (edge,) = load_system(listed).edges
    assert [device.memory_bytes for device in edge.devices] == [16e9, 16e9]
    page.locator("#stages td").first.wait_for()
    page.locator("#stop").click()
    page.locator("#resume").wait_for()
    without_overflow(page)
    page.locator("#resume").click()
    page.locator("#summary", has_text="Run done").wait_for()
    assert len(load_ply(out / "scene.ply")) > 100
    page.locator("#model:visible").wait_for()
    assert page.locator("#model").evaluate("image => image.decode().then(() => image.naturalWidth)") == PICTURE_WH[0]
    page.locator("#message", has_text="Finished: ").wait_for()
    assert "not empty" not in page.locator("#forecast").inner_text(), "a run that ended well is told as an error"
    if folder := os.environ.get("RADIANT_PAGE_PICTURES"):
        page.screenshot(path=str(Path(folder) / "web_start.jpg"), type="jpeg", quality=70)
    page.locator("#path").fill(str(out))
    page.locator("#look").click()
    text_once(page, "#found", "A finished run")
    for needless in ("#machines", "#out", "#map"):
        page.locator(needless).wait_for(state="hidden")
    page.set_viewport_size({"width": 390, "height": 844})
    without_overflow(page)
    assert page.locator("#open").is_hidden(), "two buttons do the same"
    page.locator("#start").click()
    page.locator("[data-layer='Regions']").first.wait_for(state="attached")
    assert page.url.startswith(address.split("?", maxsplit=1)[0]) and not errors, errors


def test_a_flight_becomes_a_plan_and_an_empty_folder_a_sentence_on_a_phone(browser: Any, address: str, photographs: Path) -> None:
    page = browser.new_page(viewport={"width": 390, "height": 844})
    page.set_default_timeout(1000 * DEADLINE_S)
    page.goto(address)
    page.locator("#path").fill(str(photographs.parent / "flight.csv"))
    page.locator("#look").click()
    text_once(page, "#found", "30 waypoints before capture")
    text_once(page, "#line", "radiant plan ")
    without_overflow(page)
    page.locator("#start").click()
    text_once(page, "#message", "Finished: ")
    assert (photographs.parent / "flight_plan/plan.json").is_file()
    (photographs.parent / "nothing").mkdir()
    page.locator("#path").fill(str(photographs.parent / "nothing"))
    page.locator("#look").click()
    assert "no photographs" in text_once(page, "#found", "no photographs")
    assert page.locator("#start").is_disabled()


def test_strangers_begin_nothing(address: str, photographs: Path) -> None:
    own, secret = address.split("/?secret=")
    choice = {"path": str(photographs), "out": str(photographs.parent / "taken"), "quality": "quick"}

    def answer(data: bytes | None, secret_sent: str, host: str = "") -> tuple[int, bytes]:
        request = urllib.request.Request(f"{own}/?secret={secret_sent}", data, {"Host": host} if host else {})
        try:
            with urllib.request.urlopen(request, timeout=DEADLINE_S) as response:
                return response.status, response.read()
        except urllib.error.HTTPError as error:
            return error.code, error.read()

    begin = json.dumps({"begin": choice}).encode()
    assert answer(begin, "guessed") == answer(None, "guessed") == (404, b"")
    assert answer(begin, secret, "evil.example") == (404, b"")
    named = json.dumps({"begin": {**choice, "command": ["run", "/etc"], "quality": "no such"}}).encode()
    status, refused = answer(named, secret)
    assert status == 200 and "is no quality" in json.loads(refused)["error"]
    listed = json.dumps({"begin": {**choice, "is_listed": True, "system_as": None}}).encode()
    for wrong in (
        listed,
        b'{"folder": "~nobody_of_this_name/x"}',
        b'{"begin": "all"}',
        b"[]",
        b"{",
        b"{}",
        b'{"look": 1, "stop": 1}',
        b'{"open": "/etc"}',
        b'{"resume": true}',
    ):
        status, refused = answer(wrong, secret)
        assert status == 200 and json.loads(refused)["error"], wrong
    time.sleep(0.5)
    assert not (photographs.parent / "taken").exists()


@pytest.mark.parametrize("options", [["--web", "--host", "0.0.0.0"], ["--web", "--view", "seams"], ["--port", "1"]])
def test_the_start_is_on_this_machine_alone(options: list[str]) -> None:
    result = CliRunner().invoke(app, ["inspect", *options])
    assert result.exit_code != 0
    assert re.search("ssh -L|needs something to show", str(result.exception)), result.exception
