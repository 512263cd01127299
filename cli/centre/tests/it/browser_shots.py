"""Pictures of a page at two widths, light and dark: nothing may be wider than the screen."""

SIZES = ({"width": 1280, "height": 800}, {"width": 390, "height": 844})


def shot(page, folder, name, whole=True):
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        for size in SIZES:
            page.set_viewport_size(size)
            page.wait_for_timeout(400)
            page.screenshot(path=f"{folder}/centre-{name}-{size['width']}-{scheme}.png", full_page=whole)
            wide = page.evaluate("() => document.documentElement.scrollWidth")
            assert wide <= size["width"], f"{name}: {wide} px do not fit {size['width']}"
    page.emulate_media(color_scheme="light")
    page.set_viewport_size(SIZES[0])
