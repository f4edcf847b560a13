"""Pages: one file, text escaped, no value forgotten."""

import jinja2
import pytest
from parsed_page import ParsedPage

from ndf_mi.reports import page
from ndf_mi.reports.page import Fact


def test_a_page_is_one_file_with_escaped_text(tmp_path):
    origin = page.origin(
        {"command": "ndf-mi a 'b<c'", "machine": {"Cores": 2}}, Fact("Run", ("runs/a&b", "two lines"))
    )
    curves = [{"name": "rays & <more>", "charts": [], "sentences": ["Time < memory."]}]
    page.write_page(
        tmp_path / "page.html", "growth.html.j2", curves=curves, repeats=3, memory="counted.", origin=origin
    )
    parsed = ParsedPage(tmp_path / "page.html")
    for text in (
        "ndf-mi a 'b<c'",
        "runs/a&b",
        "two lines",
        "Rays & <more>",
        "Time < memory.",
        "Cores",
        "3 repeats",
    ):
        assert text in parsed.text
    assert (
        "<pre>ndf-mi a" in parsed.source
        and "prefers-color-scheme: dark" in parsed.source
        and "@media print" in parsed.source
    )


def test_a_value_that_a_template_lacks_is_an_error_and_no_file_is_written(tmp_path):
    with pytest.raises(jinja2.UndefinedError, match="curves"):
        page.write_page(tmp_path / "page.html", "growth.html.j2", repeats=3, memory="counted.", origin=[])
    assert not list(tmp_path.iterdir())


def test_settings_in_one_line():
    values = {"learning_rate": 0.1 + 0.2, "axes": ("a", "b"), "seed": 0, "atlas": "body"}
    assert page.settings_text(values) == "learning rate 0.3, axes a b, seed 0, atlas body"


def test_facts_of_a_study(about):
    assert page.capture_fact(about).lines == ("dancer, digest 0123456789abcdef…",)
    assert page.protocol_fact(about).lines == ("Protocol default: All images.",)
    assert page.protocol_notes(about) == ["A `note` on the protocol."] and page.protocol_notes({}) == []
