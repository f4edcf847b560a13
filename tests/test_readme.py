"""The manual pages' Python runs as printed, their commands exist, their links lead somewhere."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import pytest

from ndf_mi.commands import ENTRIES, find

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    ROOT / "scenes" / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
]


@pytest.mark.parametrize("page", ["README.md", "docs/mitsuba.md"])
def test_python_runs_as_printed(make_run, tmp_path, page):
    make_run("demo/run", frames=4)
    shutil.copytree(ROOT / "scenes", tmp_path / "scenes")
    text = (ROOT / page).read_text(encoding="utf-8")
    code = "\n".join(re.findall(r"```python\n(.*?)```", text, re.S)).replace("llvm_ad_rgb", mi.variant())
    assert "mi.load_file" in code
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "performer.png").stat().st_size > 100


def test_readme_is_short():
    lines = README.splitlines()
    assert len(lines) <= 100 and max(len(line) for line in lines if not line.startswith("|")) <= 100


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!https?://)([^)\s]+)\)", text):
        path, _, anchor = target.partition("#")
        linked = (page.parent / path).resolve() if path else page
        assert linked.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.*)$", linked.read_text(encoding="utf-8"), re.M)
            assert anchor in {
                re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings
            }, target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_that_are_named_exist(page):
    named = re.findall(
        r"`((?:ndf_mi|plugins|scenes|tests|benchmarks|docs)/[\w./-]+)`", page.read_text(encoding="utf-8")
    )
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_every_command_has_a_line_in_the_manual():
    manual = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    named = re.findall(r"(?:^|`)ndf-mi ([a-z]+(?: (?:synthesise|check|import))?)", README + manual, re.M)
    assert {entry.name for entry in ENTRIES} == {
        found.name for words in named if (found := find(words.split()))
    }
    assert not [words for words in named if find(words.split()) is None]
