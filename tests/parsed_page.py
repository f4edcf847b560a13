"""A report as tests look at it: parsed, with the rules that hold for every report checked on the way."""

from __future__ import annotations

import base64
import io
import os
import re
from html.parser import HTMLParser
from pathlib import Path

from PIL import Image

VOID = {"meta", "img", "br", "link", "use", "path", "rect", "polyline"}


class ParsedPage(HTMLParser):
    """Headings, tables, texts and pictures of a report.

    Every element closes in order; nothing refers to another file; pictures are PNGs; pictures and charts have
    alternative texts; headings of tables have a scope; tables lie in boxes that scroll.

    Attributes:
        text: all text outside of the style sheet, tags dropped.
        alts: alternative texts of the pictures, in order.
        charts: alternative texts of the charts, in order.
        headings: (level, text) of h1 to h4.
        tables: a list of rows of cell texts for each table.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        super().__init__()
        self.source = Path(path).read_text(encoding="utf-8")
        self.text, self.alts, self.charts = "", [], []
        self.headings: list[tuple[int, str]] = []
        self.tables: list[list[list[str]]] = []
        self._open: list[tuple[str, dict[str, str | None]]] = []
        self.feed(self.source)
        self.close()
        assert not self._open
        assert not re.search(
            r"""(src|href)=["'](?!data:|#)|url\((?!#)|@import|<script|<link|<iframe""", self.source
        )
        assert 'name="viewport"' in self.source and "<style>" in self.source

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        if tag == "img":
            assert values["alt"]
            self.alts.append(values["alt"])
            picture = Image.open(
                io.BytesIO(base64.b64decode(values["src"].removeprefix("data:image/png;base64,")))
            )
            assert picture.format == "PNG" and min(picture.size) > 1
        if tag == "svg":
            of = self._open[-1][1]
            assert of["role"] == "img" and of["aria-label"]
            self.charts.append(of["aria-label"])
            assert "width" not in values and "viewbox" in values
        if tag == "table":
            assert "scroll" in (self._open[-1][1].get("class") or "")
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("th", "td"):
            assert tag == "td" or values["scope"]
            self.tables[-1][-1].append("")
        if re.fullmatch("h[1-4]", tag):
            self.headings.append((int(tag[1]), ""))
        if tag not in VOID:
            self._open.append((tag, values))

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self._open.pop()[0] == tag

    def handle_data(self, data):
        tags = [tag for tag, _ in self._open]
        if "style" in tags:
            return
        self.text += data
        if {"th", "td"} & set(tags):
            self.tables[-1][-1][-1] += data
        elif any(re.fullmatch("h[1-4]", tag) for tag in tags):
            level, text = self.headings[-1]
            self.headings[-1] = level, text + data
