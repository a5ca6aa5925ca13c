"""The site of the documentation, the licences, and what the files beside the code say of the version."""

import re
import tomllib
from pathlib import Path

import pytest

import planners
import replay_kit
from tests.places import ROOT
from tests.release.licences import PROJECT, installed, licence, refused
from tests.release.site import build, pages


def test_every_page_of_prose_is_in_the_contents_of_the_site_and_so_is_every_setting():
    written = {
        path.relative_to(ROOT)
        for top in ("replay_kit", "planners", "tests", "sample_logs")
        for path in (ROOT / top).rglob("*.md")
    }
    found = pages()
    assert written | {Path("README.md")} <= set(found)
    listed = re.findall(r"^[\w/.]+\.md$", found[Path("README.md")], re.MULTILINE)
    assert sorted(["README.md", *listed]) == sorted(map(str, found))
    assert "| `estimator.modes` |" in found[Path("settings.md")]


# Sphinx warns of what its own extensions still use
@pytest.mark.filterwarnings("ignore::PendingDeprecationWarning", "ignore::DeprecationWarning")
@pytest.mark.full
def test_the_site_has_every_public_name_and_fetches_nothing(tmp_path):
    build(tmp_path)
    for package in (replay_kit, planners):
        page = (tmp_path / "reference" / f"{package.__name__}.html").read_text(encoding="utf-8")
        for name in package.__all__:
            assert name.startswith("__") or f'id="{package.__name__}.{name}"' in page, name
    for path in tmp_path.rglob("*.html"):
        page = path.read_text(encoding="utf-8")
        assert not re.search(r"<(?:script|img|link)[^>]*(?:src|href)=[\"']?(?:https?:|//)", page), (
            path
        )


@pytest.mark.parametrize(
    ("text", "bad"),
    [
        ("MIT", False),
        ("", True),
        ("GNU Lesser General Public License v3 (LGPLv3)", False),
        ("GNU Library or Lesser General Public License (LGPL)", False),
        ("LGPL-3.0-only", False),
        ("GPL-3.0-or-later", True),
        ("GNU General Public License v3 (GPLv3)", True),
        ("GNU Affero General Public License v3", True),
        ("AGPL-3.0", True),
        ("MIT OR GPL-2.0", False),
    ],
)
def test_licences_that_are_refused(text, bad):
    assert refused(text) is bad


def test_no_dependency_has_a_licence_that_is_refused():
    found = installed([PROJECT])
    assert {"numpy", "casadi", "pymavlink", "contourpy"} <= set(found)
    assert "hypothesis" not in found
    assert {
        name: licence(package) for name, package in found.items() if refused(licence(package))
    } == {}


def test_the_oldest_versions_that_are_tested_are_those_that_are_allowed():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = (project["optional-dependencies"][name] for name in ("adcp", "remote", "fleet"))
    needed = [*project["dependencies"], *(each for extra in extras for each in extra)]
    stated = (ROOT / "tests/release/oldest.txt").read_text(encoding="utf-8").splitlines()[1:]
    assert stated == sorted({each.replace(">=", "==") for each in needed}, key=str.lower)


def test_the_citation_states_the_version_and_the_licence():
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert f"version: {replay_kit.__version__}\n" in text
    assert f"license: {project['license']}\n" in text


def test_the_changelog_begins_with_this_version_and_its_date():
    latest = re.search(
        r"^## (\S+), (\S+)$",
        (ROOT / "replay_kit" / "CHANGELOG.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    assert latest
    assert latest[1] == replay_kit.__version__
    assert f"date-released: {latest[2]}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
