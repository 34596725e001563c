"""The page of Studio in a browser, on answers as its API gives them."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import axe
import needs
import numpy as np
import pytest
from canned_answers import NOT, PITCH, result, scene, task, volumes
from canned_studio import Studio
from PIL import Image

FULL = 1.5  # dose of byte 255 of the volume [dose that prints]
DESK, PHONE = (1280, 860), (390, 844)
SWITCHES = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--ignore-gpu-blocklist"]
JOB = "#jobs/boat.toml/"
Opened = Callable[..., tuple[Any, Studio]]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as tools:
        yield tools.chromium.launch(executable_path=needs.browser(), args=SWITCHES, timeout=needs.WAIT)


@pytest.fixture
def opened(browser: Any) -> Iterator[Opened]:
    """Open a tab of a server with given answers; the test fails if the page raises or breaks its policy."""
    pages, studios, wrong = [], [], []

    def heard(message: Any) -> None:
        if message.type == "error" and "404" not in message.text and "409" not in message.text:
            wrong.append(message.text)

    def made(tab: str, size: Any = DESK, theme: str = "day", server: Studio | None = None, **answers: Any) -> Any:
        studio = server or Studio(**answers).__enter__()
        studios.append(studio)
        page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        page.set_default_timeout(needs.WAIT)
        page.add_init_script(f"localStorage.setItem('theme', '{theme}')")
        page.on("console", heard)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(studio.url + tab)
        page.get_by_role("tab", selected=True).wait_for()
        pages.append(page)
        return page, studio

    yield made
    for page in pages:
        page.close()
    for studio in set(studios):
        studio.__exit__()
    assert not wrong, wrong


def sent(studio: Studio, name: str) -> list[Any]:
    """Bodies that were sent to a path."""
    return [body for _, path, body in studio.posts if path.endswith(name)]


def until(page: Any, what: str) -> None:
    """Wait until an expression is true; the page's policy lets no test evaluate it there again and again."""
    end = time.monotonic() + needs.WAIT / 1000
    while not page.evaluate(what):
        assert time.monotonic() < end, what
        page.wait_for_timeout(50)


def pixels(page: Any, place: Any) -> np.ndarray:
    """Colors [row, column, rgb] of an element as it is drawn."""
    return np.array(Image.open(io.BytesIO(place.screenshot())).convert("RGB")).astype(int)


def test_an_empty_workspace_says_how_to_start(opened: Opened) -> None:
    page, studio = opened("", empty=True, result=None)
    page.get_by_role("heading", name="Start with a part").wait_for()
    page.get_by_role("button", name="Use the bundled boat").click()
    until(page, "location.hash.startsWith('#jobs/boat.toml')")
    assert sent(studio, "jobs")[0] == {
        "name": "boat", "part": None, "height": None, "vial": None, "projector": None, "resin": None,
    }  # fmt: skip


def test_a_wrong_value_is_named_at_its_field_and_comments_stay(opened: Opened) -> None:
    page, studio = opened(f"{JOB}job")
    radius = page.get_by_label("vial radius")
    radius.fill("12,4")
    radius.press("Enter")
    page.locator(".key", has=radius).get_by_text("expected a length above 0 mm").wait_for()
    assert radius.get_attribute("aria-invalid") == "true"
    page.get_by_role("button", name="line 7").click()
    chosen = "(area) => area.value.slice(area.selectionStart, area.selectionEnd)"
    assert page.get_by_label("Text of boat.toml").evaluate(chosen).startswith('radius = "12,4"')
    radius.fill("13")
    radius.press("Enter")
    page.get_by_text("saved", exact=True).wait_for()
    assert 'radius = "13 mm"  # measured with a caliper' in studio.text
    assert sent(studio, "jobs/edit")[-1]["set"] == {"vial.radius": "13 mm"}


def test_the_text_of_the_file_fills_the_fields(opened: Opened) -> None:
    page, studio = opened(f"{JOB}job")
    area = page.get_by_label("Text of boat.toml")
    area.fill(studio.text.replace('wall = "1 mm"', 'wall = "0.8 mm"'))
    until(page, "document.querySelector('[data-key=\"vial.wall\"]').value === '0.8 mm'")
    assert 'wall = "0.8 mm"' in studio.text and "# Boat for the catalog" in studio.text


@pytest.mark.slow
def test_a_second_page_shows_what_the_first_one_changed(opened: Opened) -> None:
    first, studio = opened(f"{JOB}job")
    second, _ = opened(f"{JOB}job", server=studio)
    second.get_by_label("vial wall", exact=True).wait_for()
    first.get_by_label("vial wall", exact=True).fill("2 mm")
    first.get_by_label("vial wall", exact=True).press("Enter")
    first.get_by_text("saved", exact=True).wait_for()
    studio.tell("workspace", {"revision": 18})
    until(second, "document.querySelector('[data-key=\"vial.wall\"]').value === '2 mm'")


@pytest.mark.slow
def test_an_edit_of_an_old_text_is_refused_and_the_new_text_is_shown(opened: Opened) -> None:
    page, studio = opened(f"{JOB}job")
    page.get_by_label("vial wall", exact=True).wait_for()
    while not studio.streams:
        page.wait_for_timeout(50)
    page.wait_for_timeout(500)  # the first event makes the page read everything again
    studio.text, studio.version = studio.text.replace("1.473", "1.52"), studio.version + 1
    page.get_by_label("vial wall", exact=True).fill("2 mm")
    page.get_by_label("vial wall", exact=True).press("Enter")
    page.get_by_text("was changed elsewhere at the same time").wait_for()
    until(page, "document.querySelector('[data-key=\"vial.wall_index\"]').value === '1.52'")
    assert 'wall = "1 mm"' in studio.text


def test_a_pair_needs_no_brackets(opened: Opened) -> None:
    page, studio = opened(f"{JOB}job")
    for number, typed in enumerate(["60, 32", "61 × 32", "62x32", "[63, 32]", "64 32"]):
        page.get_by_label("beam pixels").fill(typed)
        page.get_by_label("beam pixels").press("Enter")
        while len(sent(studio, "jobs/edit")) == number:
            page.wait_for_timeout(20)
        assert sent(studio, "jobs/edit")[number]["set"] == {"beam.pixels": [60 + number, 32]}


def test_an_address_of_a_tab_opens_it(opened: Opened) -> None:
    page, _ = opened("#look")
    page.get_by_test_id("verdict").wait_for()
    gone, _ = opened("#jobs/gone.toml/print")
    gone.get_by_text("there is no gone.toml").wait_for()
    gone.get_by_role("heading", name="Earlier prints").wait_for()


def test_a_folder_is_dropped_with_its_parts_and_jobs(opened: Opened) -> None:
    page, studio = opened(f"{JOB}part")
    page.locator("canvas.scene").wait_for()
    page.evaluate("""() => {
      const file = (name) => ({ isFile: true, file: (done) => done(new File(["solid"], name)) });
      const read = (inside) => ({ readEntries: (done) => done(inside.splice(0, 1)) });
      const folder = (...inside) => ({ isFile: false, createReader: () => read(inside) });
      const entry = folder(file("new.toml"), file("notes.txt"), folder(file("ring.stl"), file("gear.stl")));
      const event = new Event("drop", { cancelable: true });
      event.dataTransfer = { items: [{ webkitGetAsEntry: () => entry }] };
      window.dispatchEvent(event); }""")
    page.get_by_text("left out notes.txt").wait_for()
    until(page, "location.hash.includes('gear.stl')")  # this server keeps no new job
    uploads = [path for method, path, _ in studio.posts if "jobs" in path or path.startswith("parts")]
    assert uploads == ["parts", "parts", "/api/v1/jobs/new.toml"]


@pytest.mark.parametrize("gain", [pytest.param(0.8, marks=pytest.mark.slow), 1.2])
def test_the_exposure_slider_counts_what_prints(opened: Opened, gain: float) -> None:
    page, _ = opened(f"{JOB}look")
    page.get_by_test_id("live").get_by_text("of the part prints").wait_for()
    page.get_by_label("Exposure", exact=True).fill(str(gain))
    part, dose = volumes()
    stored = np.round(255 * dose / FULL)
    solid = stored >= 255 / (FULL * gain)
    inside, outside = (100 * solid[part == value].mean() for value in (1, 0))
    expected = f"At {22.7 * gain:.1f} s"
    page.get_by_test_id("live").get_by_text(expected).wait_for()
    said = page.get_by_test_id("live").text_content()
    assert f"{inside:.2f} % of the part prints, and {outside:.2f} % of the resin" in said


def test_slices_show_the_volume_the_right_way_round(opened: Opened) -> None:
    page, _ = opened(f"{JOB}look")
    page.get_by_test_id("live").get_by_text("of the part prints").wait_for()
    part, dose = volumes()
    k = int((-2.0 / PITCH) + part.shape[2] / 2)  # through the peg, at +x and +y
    page.get_by_label("Place of the slice").fill(str(round((k + 0.5) / part.shape[2] / 0.002) * 0.002))
    read = """(canvas) => {
      const gl = canvas.getContext("webgl2"), all = new Uint8Array(4 * canvas.width * canvas.height), n = 96;
      gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, all);
      const gap = 10, each = Math.floor((canvas.width - 2 * gap) / 3);
      const middle = (k, size) => Math.floor(((k + 0.5) / n) * size);
      return [0, 1, 2].map((pane) => [...Array(n).keys()].map((row) => [...Array(n).keys()].map((column) => {
        const k = 4 * (middle(row, canvas.height) * canvas.width + pane * (each + gap) + middle(column, each));
        return [...all.slice(k, k + 3)]; })));
    }"""  # panes, rows from the bottom, columns, colors
    for _ in range(40):  # until it is drawn
        page.wait_for_timeout(250)
        sampled = np.array(page.get_by_test_id("slices").evaluate(read))
        if ((sampled[0][..., 0] < 180) == (part[:, :, k].T > 0.5)).mean() > 0.97:
            break
    target = sampled[0][..., 0] < 180
    assert (target == (part[:, :, k].T > 0.5)).mean() > 0.97
    assert target[64:, 64:].any() and not target[:32, :32].any()  # the peg is right and up, and only there
    solid = (dose[:, :, k] >= 1).T
    printed = abs(sampled[2][..., :3] - [176, 190, 208]).max(-1) < 6
    assert (printed == (solid & (part[:, :, k].T > 0.5))).mean() > 0.97
    missing = abs(sampled[2][..., :3] - [214, 58, 73]).max(-1) < 6
    assert (missing == (~solid & (part[:, :, k].T > 0.5))).mean() > 0.97


def test_a_bad_verdict_tells_what_to_do(opened: Opened) -> None:
    page, _ = opened(f"{JOB}look", result=result(NOT))
    assert "Does not print" in page.get_by_test_id("verdict").text_content()
    page.get_by_text("180 angles instead of 60").wait_for()
    assert page.locator(".verdict.bad").count() == 1


@pytest.mark.slow
def test_errors_of_the_machine_are_exposed_with_their_units(opened: Opened) -> None:
    page, studio = opened(f"{JOB}look")
    page.get_by_label("Axis, across the light").fill("40")
    page.get_by_label("Dose", exact=True).fill("-5")
    page.get_by_role("button", name="Expose with these errors").click()
    page.get_by_text("exposing again").wait_for()
    made = sent(studio, "tasks")[0]
    assert (made["kind"], made["result"], made["off"]) == ("expose", "boat.vam", {"axis": "40 um", "dose": "-5 %"})


def test_an_error_that_was_not_measured_has_its_reason(opened: Opened) -> None:
    found = result()
    known = found["tolerances"]["rows"][0] | {"name": "dose", "change": "+5 %", "note": ""}
    some = [known, *({**known, "name": "lens", "change": f"+{k} pixel", "window": None, "wrong": None, "note": "absent"}
                     for k in range(3))]  # fmt: skip
    page, _ = opened(f"{JOB}look", result=found | {"tolerances": found["tolerances"] | {"rows": some}})
    page.get_by_text("Not measured: lens (absent).", exact=True).wait_for()
    assert page.get_by_role("group", name="Tolerances").locator("tbody tr").count() == 1


def test_progress_follows_the_events_and_a_solve_goes_on_after_a_stop(opened: Opened) -> None:
    running = task()
    page, studio = opened(f"{JOB}solve", tasks=[running], result=None)
    page.get_by_role("progressbar", name="Progress").wait_for()
    running["progress"] |= {"share": 0.75, "left": 9.0, "said": "packing frames"}
    studio.tell("task", running)
    page.get_by_text("Packing frames").wait_for()
    bar = page.get_by_role("progressbar", name="Progress")
    assert bar.evaluate("(bar) => bar.value") == 0.75 and page.get_by_text("9.0 s", exact=True).count() == 1
    page.locator("button.stop").click()
    page.get_by_role("button", name="Continue").click()
    page.wait_for_timeout(200)
    posted = [path for _, path, _ in studio.posts]
    assert posted == [f"tasks/{running['id']}/cancel", f"tasks/{running['id']}/resume"]


def test_a_print_starts_only_after_its_name_is_typed(opened: Opened) -> None:
    page, studio = opened(f"{JOB}print", result=result(NOT))
    start = page.get_by_role("button", name="Start the print")
    page.get_by_text("calibrate it with vam calibrate power").wait_for()
    assert start.is_disabled()
    page.get_by_label("Type boat.vam to confirm").last.fill("boat")
    assert start.is_disabled()
    page.get_by_label("Type boat.vam to confirm").last.fill("boat.vam")
    assert start.is_disabled(), "it is not known to print"
    page.get_by_label("Print anyway, although it does not print").check()
    start.click()
    until(page, "document.querySelectorAll('.task').length > 0")
    made = sent(studio, "tasks")[0]
    assert (made["kind"], made["rig"], made["confirm"], made["anyway"]) == ("print", "emulated", "boat.vam", True)


@pytest.mark.slow
def test_turning_a_part_multiplies_its_orientation(opened: Opened) -> None:
    page, studio = opened(f"{JOB}part")
    page.get_by_role("button", name="Turn about x by 90°").click()
    until(page, "[...document.querySelectorAll('input')].some((input) => input.value === '90.0')")
    page.get_by_role("button", name="Turn about z by 90°").click()
    until(page, "[...document.querySelectorAll('input')].filter((input) => input.value === '90.0').length === 2")
    x, z = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert np.allclose(sent(studio, "jobs/edit")[-1]["set"]["target.orientation"], z @ x, atol=1e-6)


@pytest.mark.slow
def test_a_second_body_leaves_the_first_one_where_it_is(opened: Opened) -> None:
    page, studio = opened(f"{JOB}part")  # drawn five times as large as printed, and 24 mm higher
    page.get_by_role("button", name="Add", exact=True).click()
    while not sent(studio, "jobs/edit"):
        page.wait_for_timeout(50)
    made = sent(studio, "jobs/edit")[0]
    assert made["set"]["target.factor"] == pytest.approx(0.2, rel=1e-5)
    assert made["set"]["target.origin"] == pytest.approx([0, 0, 24], abs=1e-3)
    assert (made["set"]["body.0.mesh"], made["set"]["body.1.role"]) == ("benchy.stl", "keep out")
    assert made["remove"] == ["target.mesh", "target.height"]


@pytest.mark.slow
def test_what_lies_beyond_the_printable_cylinder_is_red(opened: Opened) -> None:
    reds = []
    for reach, role in ((8.9, "print"), (3.0, "gray"), (3.0, "insert")):  # an insert need not be lit
        server = Studio(**{"jobs/boat.toml/scene": scene() | {"beam": scene()["beam"] | {"reach": reach}}}).__enter__()
        server.text += f'\n[[body]]\nmesh = "benchy.stl"\nrole = "{role}"\n'
        page, _ = opened(f"{JOB}part", server=server)
        page.get_by_text("prints up to").wait_for()
        page.wait_for_timeout(400)
        image = pixels(page, page.locator("canvas.scene"))
        reds.append(((image[..., 0] > 130) & (image[..., 1] < 90) & (image[..., 2] < 110)).mean())
    assert reds[0] == reds[2] == 0 and reds[1] > 0.004


def test_a_part_is_uploaded_and_another_file_is_refused(opened: Opened, tmp_path: Path) -> None:
    page, studio = opened("", empty=True, result=None)
    for name, told in (("notes.txt", "left out notes.txt"), ("ring.stl", "")):
        (file := tmp_path / name).write_bytes(b"solid ring\nendsolid ring\n")
        with page.expect_file_chooser() as chooser:
            page.get_by_role("button", name="Choose a file").click()
        chooser.value.set_files(file)
        if told:
            page.get_by_text(told).wait_for()
            assert not studio.posts
    until(page, "location.hash.startsWith('#parts/ring.stl')")
    assert studio.posts[0][2] == b"solid ring\nendsolid ring\n"


def test_arrow_keys_change_the_tab_and_every_control_is_reached_by_tab(opened: Opened) -> None:
    page, _ = opened(f"{JOB}part")
    page.get_by_role("tab", name="Part").focus()
    page.keyboard.press("ArrowRight")
    until(page, "document.activeElement.id === 'tab-job'")
    page.get_by_label("vial radius").wait_for()
    controls = """() => {
      const all = [...document.querySelectorAll("button, a[href], input, select, textarea, summary")];
      return all.filter((each) => each.checkVisibility() && !each.disabled && each.tabIndex >= 0).length; }"""
    step = """() => {
      if (document.activeElement !== document.body) reached.add(document.activeElement);
      return reached.size; }"""
    page.locator(".skip").focus()
    reached = page.evaluate("() => { window.reached = new Set([document.activeElement]); return 1; }")
    for _ in range(page.evaluate(controls) + 8):
        page.keyboard.press("Tab")
        reached = page.evaluate(step)
    assert reached >= page.evaluate(controls)


TABS = {"part": "Size", "job": "Presets", "solve": "Queue", "look": "Slices", "print": "Earlier prints"}


@pytest.mark.slow
@pytest.mark.parametrize("theme", ["day", "room"])
@pytest.mark.parametrize("tab", TABS)
def test_a_tab_has_names_contrast_and_room_for_fingers(opened: Opened, tab: str, theme: str) -> None:
    page, _ = opened(JOB + tab, PHONE, theme, tasks=[task()])
    page.get_by_role("heading", name=TABS[tab]).first.wait_for()
    page.wait_for_timeout(300)
    audit = (Path(__file__).parents[1] / "hosts" / "page_audit.js").read_text()
    found = [each for each in page.evaluate(audit) if 'role="tab"' not in each]
    assert not found, "\n".join(found)


@pytest.mark.slow
@pytest.mark.parametrize("theme", ["day", "room"])
@pytest.mark.parametrize("tab", TABS)
def test_axe_finds_no_serious_fault(opened: Opened, tab: str, theme: str) -> None:
    page, _ = opened(JOB + tab, theme=theme, tasks=[task()])
    page.get_by_role("heading", name=TABS[tab]).first.wait_for()
    page.wait_for_timeout(300)
    assert not (faults := axe.serious(page)), "\n".join(faults)


def test_the_page_is_small_and_loads_nothing_from_elsewhere() -> None:
    static = Path(__file__).parents[2] / "vamgpu" / "studio" / "static"
    files = [file for file in static.iterdir() if file.is_file()]
    assert sum(file.stat().st_size for file in files) < 2_000_000
    own = [file for file in files if file.suffix in (".html", ".css", ".js") and file.name != "three.js"]
    assert len(own) >= 10
    for file in own:
        text = file.read_text("utf-8").replace("http://www.w3.org/2000/svg", "")
        assert "http:" not in text and "https:" not in text and "innerHTML" not in text, file.name
        assert "style=" not in text and len(text.splitlines()) <= 500, file.name
