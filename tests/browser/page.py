"""Tests of the report's page in Chromium: the actions of a reader, at three widths and in print.

Runs short jobs in a temporary folder, reports on them, and opens the page.
"""

import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

from playwright.sync_api import sync_playwright

MANIFEST = """
format = 1
name = "browser"
question = "Does the page work?"
extends = "paper"
scenarios = ["P-H-D", "L-H-D"]
seeds = 3
environment.sigma = [0.4, 0.6]
evaluation.test_episodes = 50
[[agent]]
name = "dqn"
episodes = 60
layers = [16]
[[agent]]
name = "reinforce"
episodes = 400
layers = [16]
[[analysis]]
name = "returns"
kind = "curve"
title = "Returns"
[[analysis]]
name = "gain"
kind = "contrast"
by = "scenario"
between = ["P-H-D", "L-H-D"]
[[analysis]]
name = "learning"
kind = "learning_curve"
window = 20
[[analysis]]
name = "choices"
kind = "action_choice"
where = { environment.sigma = 0.6 }
"""

ROOT = pathlib.Path(__file__).resolve().parents[2]


def report(folder):
    """The page of short jobs, or the page at `JITAI_PAGE`."""
    if "JITAI_PAGE" in os.environ:
        return pathlib.Path(os.environ["JITAI_PAGE"]).resolve()
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    jitai = target / "release" / "jitai"
    (folder / "browser.toml").write_text(MANIFEST)
    for arguments in (["run", "browser.toml", "--quiet"], ["report", "browser.toml", "--out", "r"]):
        subprocess.run([jitai, *arguments], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    return folder / "r" / "index.html"


def numbers(page, table):
    """The index of the first numeric column, and its values in displayed order."""
    return page.evaluate(
        """(table) => {
            const place = [...table.tHead.rows[0].cells].findIndex((c) => c.className === "number");
            return [place, [...table.tBodies[0].rows].map((r) => Number(r.cells[place].dataset.value))
                .filter((n) => !Number.isNaN(n))];
        }""",
        table,
    )


def check_sorting(page):
    # The headings can be clicked only in open sections.
    page.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    table = page.query_selector("article table")
    place, _ = numbers(page, table)
    button = table.query_selector_all("th button")[place]
    button.click()
    _, up = numbers(page, table)
    assert up == sorted(up), up
    button.click()
    _, down = numbers(page, table)
    assert down == sorted(down, reverse=True), down
    assert table.query_selector_all("th")[place].get_attribute("aria-sort") == "descending"


LOWER_ENDS = """() => {
    for (const table of document.querySelectorAll("article table")) {
        const lines = [...table.tBodies[0].rows];
        for (let place = 0; place < lines[0].cells.length; place += 1) {
            const ends = lines.map((line) => /^[−\\d.]+(?= to )/.exec(line.cells[place].textContent));
            const lower = ends.filter((end) => end !== null).map((end) => Number(end[0].replace("−", "-")));
            if (new Set(lower.filter((end) => end < 0)).size < 2) continue;
            table.tHead.rows[0].cells[place].dataset.intervals = "";
            return lower;
        }
    }
    return null;
}"""


def check_sorting_of_intervals(page):
    assert page.evaluate(LOWER_ENDS) is not None, "no table has intervals"
    page.query_selector("th[data-intervals] button").click()
    up = page.evaluate(LOWER_ENDS)
    assert up == sorted(up), up
    page.query_selector("th[data-intervals] button").click()
    down = page.evaluate(LOWER_ENDS)
    assert down == sorted(down, reverse=True) and down != up, down


def check_pointing(page):
    for card in page.query_selector_all("article"):
        mark = card.query_selector("figure svg [data-tip]")
        if mark is None:
            continue
        mark.scroll_into_view_if_needed()
        box = mark.bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        tip = page.query_selector("#tip")
        assert tip.is_visible(), card.get_attribute("id")
        assert any(character.isdigit() for character in tip.inner_text()), tip.inner_text()
        page.mouse.move(1, 1)
    assert not page.query_selector("#tip").is_visible()


def check_tapping(browser, path):
    """On a touch screen, a tap on a mark shows its tooltip, and a tap elsewhere hides the tooltip."""
    context = browser.new_context(viewport={"width": 390, "height": 900}, has_touch=True)
    page = context.new_page()
    page.goto(path.as_uri())
    mark = page.query_selector("figure svg [data-tip]")
    mark.scroll_into_view_if_needed()
    box = mark.bounding_box()
    page.touchscreen.tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    tip = page.query_selector("#tip")
    assert tip.is_visible(), "a tap tells nothing"
    assert any(character.isdigit() for character in tip.inner_text()), tip.inner_text()
    heading = page.query_selector("article h3")
    heading.scroll_into_view_if_needed()
    box = heading.bounding_box()
    page.touchscreen.tap(box["x"] + 2, box["y"] + 2)
    assert not tip.is_visible(), "a tap elsewhere hides nothing"
    context.close()


def check_hiding(page):
    """A checkbox hides the marks with its value in all figures of the experiment, and no other marks."""
    box = page.query_selector("[data-toggle]")
    value = box.get_attribute("data-toggle")
    state = lambda: page.evaluate(
        """(value) => [...document.querySelectorAll("figure svg [data-series]")].map((mark) =>
            [mark.classList.contains(value), getComputedStyle(mark).display !== "none", mark.closest("article").id])""",
        value,
    )
    assert all(is_shown for _, is_shown, _ in state())
    assert len({card for has_value, _, card in state() if has_value}) > 2, "one figure alone"
    box.uncheck()
    assert all(is_shown != has_value for has_value, is_shown, _ in state())
    box.check()
    assert all(is_shown for _, is_shown, _ in state())


def check_tables(page):
    """The hint to scroll is shown above exactly the tables that are wider than their container."""
    # Sizes are observed once per frame.
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    wrong = page.evaluate(
        """() => [...document.querySelectorAll(".scroll")].filter((scroll) => scroll.offsetParent !== null)
            .filter((scroll) => (scroll.scrollWidth > scroll.clientWidth + 1) === scroll.previousElementSibling.hidden)
            .map((scroll) => scroll.textContent.slice(0, 40))"""
    )
    assert not wrong, wrong


def check_rows_of_cards(page):
    """Cards with the same upper edge have the same lower edge."""
    boxes = page.evaluate(
        """() => [...document.querySelectorAll(".cards > .card")].map((card) => {
            const box = card.getBoundingClientRect();
            return [Math.round(box.top), box.bottom];
        })"""
    )
    for top, bottom in boxes:
        assert all(abs(bottom - other) < 1 for at, other in boxes if at == top), boxes


def check_dark(browser, path):
    """In the dark colour scheme, the page is dark, and its figures other than maps are inverted."""
    page = browser.new_page(viewport={"width": 1280, "height": 900}, color_scheme="dark")
    page.goto(path.as_uri())
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert all(int(part) < 60 for part in ground[4:-1].split(",")), ground
    filters = page.evaluate(
        """() => [...document.querySelectorAll("figure:not(.map) svg")].map((svg) => getComputedStyle(svg).filter)"""
    )
    assert filters and all("invert" in one for one in filters), filters
    page.close()


def check_layout(page, width):
    scrolls = page.evaluate("document.documentElement.scrollWidth")
    assert scrolls <= width, f"the page is {scrolls} wide at {width}"
    boxes = page.evaluate(
        """() => [...document.querySelectorAll('article, .card, section > h2, header, .tile')].map((e) => {
            const b = e.getBoundingClientRect();
            return [e.id || e.textContent.slice(0, 20), b.left, b.top, b.right, b.bottom, e.matches('.card')];
        })"""
    )
    cards = [box for box in boxes if box[5]]
    for at, one in enumerate(cards):
        for other in cards[at + 1 :]:
            apart = (
                one[3] <= other[1] + 1 or other[3] <= one[1] + 1
                or one[4] <= other[2] + 1 or other[4] <= one[2] + 1
            )
            assert apart, f"{one[0]} and {other[0]} overlap at {width}"
    overlapping = page.evaluate(
        """() => {
            const found = [];
            for (const svg of document.querySelectorAll('figure svg')) {
                const frame = svg.getBoundingClientRect();
                const texts = [...svg.querySelectorAll('text')].map((t) => [t.textContent, t.getBoundingClientRect()]);
                texts.forEach(([words, a], at) => {
                    if (a.left < frame.left - 1 || a.right > frame.right + 1) found.push(`${words} leaves its figure`);
                    for (const [others, b] of texts.slice(at + 1)) {
                        const across = Math.min(a.right, b.right) - Math.max(a.left, b.left);
                        const down = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
                        // Boxes of letters hold room above and below them.
                        if (across > 1 && down > 0.45 * Math.min(a.height, b.height)) found.push(`${words} / ${others}`);
                    }
                });
            }
            return found;
        }"""
    )
    assert not overlapping, f"at {width}: {overlapping[:8]}"


def check_print(page):
    """In print at the width of A4, no control is shown, and no content is cut off."""
    page.set_viewport_size({"width": 718, "height": 1000})
    page.emulate_media(media="print")
    check_layout(page, 718)
    cut = page.evaluate(
        """() => [...document.querySelectorAll('table, figure, pre, p, h1, h2, h3')]
            .filter((e) => e.getBoundingClientRect().right > innerWidth + 1)
            .map((e) => e.closest('[id]')?.id + ': ' + e.tagName)"""
    )
    assert not cut, f"cut off in print: {cut}"
    controls = page.query_selector_all("nav, .switches, .links, #tip")
    assert not any(control.is_visible() for control in controls)
    assert page.pdf(format="A4").startswith(b"%PDF")
    page.emulate_media(media="screen")


def main():
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        sys.exit("chromium is not installed: run `make browser`")
    passed = 0
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        path = report(pathlib.Path(folder))
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for width in (1280, 1200, 820, 390):
            page = browser.new_page(viewport={"width": width, "height": 900})
            said, requests = [], []
            page.on("console", lambda message: said.append(message.text))
            page.on("pageerror", lambda error: said.append(str(error)))
            page.on("request", lambda request: requests.append(request.url))
            page.goto(path.as_uri())
            page.wait_for_load_state("load")
            check_layout(page, width)
            check_sorting(page)
            check_sorting_of_intervals(page)
            check_layout(page, width)
            check_tables(page)
            check_rows_of_cards(page)
            check_pointing(page)
            check_hiding(page)
            check_print(page)
            assert not said, said
            outside = [url for url in requests if url != path.as_uri() and not url.startswith("data:")]
            assert not outside, outside
            passed += 1
        check_tapping(browser, path)
        check_dark(browser, path)
        passed += 2
        browser.close()
    print(f"{passed} passed, 0 failed")


if __name__ == "__main__":
    main()
