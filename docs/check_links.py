#!/usr/bin/env python3
"""Checks every internal link, image and anchor of the built book and of Markdown files.

    check_links.py BOOK [FILE.md...]  BOOK: folder with the built HTML
    check_links.py --self-test       finds the mistakes that it is made to find

A link of the book may not leave its folder: what is published is that folder alone. Links of Markdown files go
to files of the repository. Links to other hosts are not followed. Exit status: 0 nothing wrong, 1 broken links.
"""

import html
import re
import sys
import tempfile
import unittest
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

# Attributes that hold an address, by element.
ADDRESSES = {"a": "href", "link": "href", "img": "src", "script": "src", "iframe": "src", "source": "src", "object": "data"}


class Page(HTMLParser):
    """The anchors of a page, and where its links go."""

    def __init__(self, text):
        super().__init__()
        self.anchors = set()
        self.links = []
        self.base = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        for key in ("id", "name"):
            if values.get(key):
                self.anchors.add(values[key])
        if tag == "base":
            self.base = values.get("href") or ""
        elif tag in ADDRESSES and values.get(ADDRESSES[tag]):
            self.links.append((self.getpos()[0], values[ADDRESSES[tag]]))


def slug(heading):
    """The anchor that a forge gives to a heading of Markdown."""
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
    text = re.sub(r"[`*]", "", html.unescape(text)).strip().lower()
    return re.sub(r"[^\w\- ]", "", text).replace(" ", "-")


class Markdown:
    """The anchors of a Markdown file, and where its links go. Code is left out."""

    def __init__(self, text):
        self.anchors = set()
        self.links = []
        fence = None
        for number, line in enumerate(text.splitlines(), 1):
            mark = re.match(r"\s*(```+|~~~+)", line)
            if fence is None and mark:
                fence = mark[1]
                continue
            if fence is not None:
                if mark and mark[1].startswith(fence) and line.strip() == mark[1]:
                    fence = None
                continue
            heading = re.match(r"#{1,6}\s+(.*?)\s*#*$", line)
            if heading:
                anchor, count = slug(heading[1]), 0
                while (f"{anchor}-{count}" if count else anchor) in self.anchors:
                    count += 1
                self.anchors.add(f"{anchor}-{count}" if count else anchor)
            line = re.sub(r"(`+).*?\1", "", line)
            targets = re.findall(r"\]\(\s*<?([^)\s>]+)>?[^)]*\)", line)
            targets += re.findall(r"^\s*\[[^\]]+\]:\s*<?([^\s>]+)", line)
            targets += re.findall(r"<(?:img|a|source)\b[^>]*?\b(?:src|href)=\"([^\"]+)\"", line)
            self.links += [(number, target) for target in targets]


def read(path):
    text = path.read_text(encoding="utf-8")
    return Markdown(text) if path.suffix == ".md" else Page(text)


def check(files, inside):
    """Every broken link of the files, as a line of text. Targets lie within the folder `inside`."""
    inside, pages, broken = inside.resolve(), {}, []

    def page(path):
        if path not in pages:
            pages[path] = read(path)
        return pages[path]

    for file in files:
        file = file.resolve()
        base = getattr(page(file), "base", "")
        for line, link in page(file).links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            start = inside if parts.path.startswith("/") or base == "/" else file.parent
            target = (start / unquote(parts.path).lstrip("/")).resolve() if parts.path else file
            if target.is_dir() and file.suffix != ".md":
                target = target / "index.html"
            if not target.is_relative_to(inside):
                why = "leaves the folder"
            elif not target.exists():
                why = "no such file"
            elif parts.fragment and target.suffix in (".html", ".md") and unquote(parts.fragment) not in page(target).anchors:
                why = "no such anchor"
            else:
                continue
            broken.append(f"{file}:{line}: {link}: {why}")
    return broken


class SelfTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name).resolve() / "book"
        self.folder.mkdir()
        self.put("other.html", '<h2 id="here">Here</h2>')
        self.put("picture.svg", "<svg/>")

    def put(self, name, text):
        path = self.folder / name
        path.write_text(text, encoding="utf-8")
        return path

    def found(self, name, text):
        return [line.rsplit(": ", 2)[1:] for line in check([self.put(name, text)], self.folder)]

    def test_what_is_right_is_left_alone(self):
        page = '<p id="top"><a href="#top">up</a> <a href="other.html#here">x</a> <a href="https://example.org/x#y">x</a> <img src="picture.svg">'
        self.assertEqual(self.found("page.html", page), [])
        text = "# One & two\n## Same\n## Same\n[a](other.html) [b](#one--two) [c](#same-1) ![p](picture.svg)\n`[code](none.md)`\n```\n[d](none.md)\n```\n"
        self.assertEqual(self.found("page.md", text), [])

    def test_broken_link(self):
        self.assertEqual(self.found("page.html", '<a href="none.html">x</a>'), [["none.html", "no such file"]])
        self.assertEqual(self.found("page.md", "[x](none.md)"), [["none.md", "no such file"]])
        self.assertEqual(self.found("page.md", "[x]: none.md"), [["none.md", "no such file"]])

    def test_broken_anchor(self):
        self.assertEqual(self.found("page.html", '<a href="other.html#there">x</a>'), [["other.html#there", "no such anchor"]])
        self.assertEqual(self.found("page.html", '<a href="#none">x</a>'), [["#none", "no such anchor"]])
        self.assertEqual(self.found("page.md", "# A\n[x](#b)"), [["#b", "no such anchor"]])

    def test_missing_image(self):
        self.assertEqual(self.found("page.html", '<img src="none.png">'), [["none.png", "no such file"]])
        self.assertEqual(self.found("page.md", "![x](none.png)"), [["none.png", "no such file"]])

    def test_link_out_of_the_folder(self):
        (self.folder.parent / "outside.html").write_text("")
        self.assertEqual(self.found("page.html", '<a href="../outside.html">x</a>'), [["../outside.html", "leaves the folder"]])

    def test_base_of_a_page(self):
        (self.folder / "deep").mkdir()
        page = '<base href="/"><a href="other.html#here">x</a><a href="none.html">x</a>'
        self.assertEqual(self.found("deep/404.html", page), [["none.html", "no such file"]])


def main(arguments):
    if arguments == ["--self-test"]:
        result = unittest.TextTestRunner(verbosity=0).run(unittest.defaultTestLoader.loadTestsFromTestCase(SelfTest))
        return 0 if result.wasSuccessful() else 1
    if not arguments or arguments[0].startswith("-"):
        print(__doc__.strip(), file=sys.stderr)
        return 2
    book = Path(arguments[0])
    pages = sorted(book.rglob("*.html"))
    if not pages:
        print(f"{book}: no pages", file=sys.stderr)
        return 1
    readmes = [Path(name) for name in arguments[1:]]
    broken = check(pages, book) + check(readmes, Path(__file__).resolve().parent.parent)
    for line in broken:
        print(line, file=sys.stderr)
    links = sum(len(read(path).links) for path in pages + readmes)
    print(f"{len(pages)} pages, {len(readmes)} Markdown files, {links} links, {len(broken)} broken")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
