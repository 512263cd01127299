"""A report in a headless Chromium without a network: `browser.py REPORT.html FOLDER NAME`.

Asserts that the page asks for nothing, that its script has no error, that nothing is wider than the screen, that values are shown at
the pointer and that the vectors turn; writes pictures of it at two widths, light and dark, and a PDF.
"""
import pathlib
import sys

from playwright.sync_api import sync_playwright

path, folder, name = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]), sys.argv[3]
url = path.resolve().as_uri()

with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
    context = browser.new_context(viewport={"width": 1280, "height": 900}, offline=True)
    page = context.new_page()
    page.set_default_timeout(90_000)
    errors, asked = [], []
    page.on("console", lambda message: errors.append(message.text))
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("dialog", lambda dialog: errors.append(f"a dialog: {dialog.message}"))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(url)
    assert asked == [url], asked
    for width in (1280, 420, 390):
        page.set_viewport_size({"width": width, "height": 900})
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            wide = page.evaluate("document.documentElement.scrollWidth")
            assert wide <= width, f"{wide} px do not fit {width}"
            page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
            closed = page.evaluate("[...document.querySelectorAll('.wide,.scroll')].filter((e) => e.scrollWidth > e.clientWidth && e.tabIndex < 0).length")
            assert closed == 0, f"{closed} boxes that scroll are not reached by the keys at {width} px"
            # Tables may be pushed sideways in their boxes; pictures are drawn as wide as the screen is.
            pushed = page.evaluate("""[...document.querySelectorAll('svg')].filter((e) => e.getBoundingClientRect().right > innerWidth
                || e.parentElement.scrollWidth > e.parentElement.clientWidth + 1).length""")
            assert pushed == 0, f"{pushed} pictures have to be pushed sideways at {width} px"
            # The words of a legend and the letters beside a plot stand clear of each other.
            over = page.evaluate("""[...document.querySelectorAll('svg.xy')].flatMap((plot) => ['.key', '.letter'].map((kind) => {
                const boxes = [...plot.querySelectorAll(kind)].map((e) => e.getBoundingClientRect());
                return boxes.filter((a, i) => kind == '.key' && boxes.slice(i + 1).some((b) =>
                    a.left < b.right && b.left < a.right && a.top + 3 < b.bottom && b.top + 3 < a.bottom)
                    || a.right > innerWidth).length;
            })).reduce((a, b) => a + b, 0)""")
            assert over == 0, f"{over} words in plots stand over others or beyond the edge at {width} px"
            page.screenshot(path=folder / f"{name}-{width}-{scheme}.png", full_page=True)
    page.set_viewport_size({"width": 1280, "height": 900})
    page.emulate_media(color_scheme="light")
    # A value at the pointer.
    plot = page.locator("svg.xy").first
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    for share in range(20, 95, 5):
        page.mouse.move(box["x"] + box["width"] * 0.5, box["y"] + box["height"] * share / 100)
        if page.locator("#tip").is_visible():
            break
    told = page.locator("#tip").inner_text()
    assert "mm:" in told, told
    heat = page.locator("svg.heat").first
    heat.scroll_into_view_if_needed()
    heat.locator("rect").nth(40).hover()
    assert page.locator("#tip").inner_text().endswith("µm")
    # The vectors turn by the keys and by dragging. The first view is the one that was drawn before the script; paper gets the view of the screen.
    quiver = page.locator("svg.quiver")
    quiver.scroll_into_view_if_needed()
    canvas = page.locator(".stage canvas")
    paths = quiver.locator("path.vector").all()
    picture = lambda: canvas.evaluate("(canvas) => canvas.toDataURL()")
    inked = lambda: canvas.evaluate("""(canvas) => {
        const copy = Object.assign(document.createElement('canvas'), { width: canvas.width, height: canvas.height });
        const pen = copy.getContext('2d', { willReadFrequently: true });
        pen.drawImage(canvas, 0, 0);
        return pen.getImageData(0, 0, copy.width, copy.height).data.filter((value, i) => i % 4 == 3 && value > 0).length;
    }""")
    numbers = lambda d: [float(n) for n in d.replace("M", " ").replace("L", " ").split()]
    def on_paper():
        page.evaluate("dispatchEvent(new Event('beforeprint'))")
        lines = [path.get_attribute("d") for path in paths]
        page.evaluate("dispatchEvent(new Event('afterprint'))")
        return lines
    drawn, first = paths[0].get_attribute("d"), picture()
    assert max(abs(a - b) for a, b in zip(numbers(on_paper()[0]), numbers(drawn))) < 0.5
    box, above = quiver.bounding_box(), canvas.bounding_box()
    assert all(abs(box[key] - above[key]) < 1 for key in box), (box, above)
    quiver.focus()
    page.keyboard.press("ArrowLeft")
    turned = picture()
    assert turned != first and numbers(on_paper()[0]) != numbers(drawn)
    page.keyboard.press("ArrowRight")
    assert max(abs(a - b) for a, b in zip(numbers(on_paper()[0]), numbers(drawn))) < 0.5
    page.mouse.move(box["x"] + 200, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 260, box["y"] + 220)
    page.mouse.up()
    assert picture() not in (first, turned)
    # The slider hides the vectors below its value, by its keys, and shows how many are left; the longest one stays. Paper has all.
    slider = page.get_by_label("Show errors of at least")
    sizes = [float(size) for path in paths for size in path.get_attribute("data-v").split()]
    whole = inked()
    slider.focus()
    for key in ("End", "ArrowLeft", "Home"):
        page.keyboard.press(key)
        least = float(slider.input_value())
        shown = sum(size >= least for size in sizes)
        assert max(sizes) >= least and (inked() < whole) == (shown < len(sizes)), (key, least)
        assert page.locator(".level output").inner_text() == f"{slider.input_value()} µm: {shown} of {len(sizes)}"
        assert sum(d.count("M") for d in on_paper()) == len(sizes)
    # Paper is light whatever the screen is, and no picture is cut.
    page.emulate_media(media="print", color_scheme="dark")
    assert page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--paper')").strip() == "#fff"
    page.set_viewport_size({"width": 680, "height": 1000})
    cut = page.evaluate("[...document.querySelectorAll('svg,table')].filter((e) => e.getBoundingClientRect().right > innerWidth + 1).length")
    assert cut == 0, f"{cut} pictures or tables are cut"
    page.emulate_media(media="null", color_scheme="dark")
    page.pdf(path=folder / f"{name}.pdf", prefer_css_page_size=True)
    assert asked == [url], asked
    assert errors == [], errors
    browser.close()
print("done")
