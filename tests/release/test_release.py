"""The page of the reference, the licences, and what the files beside the code say of the version."""

import re
import tomllib

import pytest

import planners
import replay_kit
from tests.places import ROOT
from tests.release.licences import PROJECT, installed, licence, refused
from tests.release.reference import reference_html


def test_the_reference_has_every_public_name_and_every_setting_and_fetches_nothing() -> None:
    page = reference_html()
    for package in (replay_kit, planners):
        for name in package.__all__:
            assert name.startswith("__") or f'<article id="{package.__name__}.{name}">' in page, (
                name
            )
    assert "<h4><code>velocity_at(longitude, latitude, depth, time=None)</code></h4>" in page
    assert "<code>estimator.modes</code>" in page
    assert "<dt><code>EstimatorError</code></dt>" in page
    assert "``" not in page
    assert not re.search(r"(src|href)=[\"']?(https?:|//)|<script", page)
    links = set(re.findall(r'href="#([^"]+)"', page))
    assert links <= set(re.findall(r'id="([^"]+)"', page))


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
def test_licences_that_are_refused(text, bad) -> None:
    assert refused(text) is bad


def test_no_dependency_has_a_licence_that_is_refused() -> None:
    found = installed([PROJECT])
    assert {"numpy", "casadi", "pymavlink", "contourpy"} <= set(found)
    assert "hypothesis" not in found
    assert {
        name: licence(package) for name, package in found.items() if refused(licence(package))
    } == {}


def test_the_citation_states_the_version_and_the_licence() -> None:
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert f"version: {replay_kit.__version__}\n" in text
    assert f"license: {project['license']}\n" in text


def test_the_changelog_begins_with_this_version_and_its_date() -> None:
    latest = re.search(
        r"^## (\S+), (\S+)$",
        (ROOT / "replay_kit" / "CHANGELOG.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    assert latest
    assert latest[1] == replay_kit.__version__
    assert f"date-released: {latest[2]}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
