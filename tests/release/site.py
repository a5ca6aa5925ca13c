"""The documentation as a site that needs no server: ``python -m tests.release.site FOLDER``.

Its pages are the README files of the folders and what lies beside them, in the chapters below, then every setting and the public names
with their docstrings. Sphinx builds it with warnings as errors, so that a link that leads nowhere ends the build.
"""

import argparse
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel
from sphinx.application import Sphinx

from replay_kit.config.run import RunConfig
from replay_kit.core import __version__

ROOT = Path(__file__).parents[2]
PACKAGES = (
    "replay_kit",
    "planners",
    "replay_kit.logs",
    "replay_kit.measurements",
    "replay_kit.forecast",
    "replay_kit.estimator",
    "replay_kit.results",
)
#: Title of each chapter, and its pages.
CHAPTERS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("Start", ("sample_logs/README.md", "sample_logs/RECIPES.md")),
    (
        "For pilots",
        (
            "sample_logs/PILOT.md",
            "replay_kit/workflows/follow/README.md",
            "replay_kit/workflows/planning/README.md",
            "replay_kit/show/README.md",
        ),
    ),
    (
        "For scientists",
        (
            "sample_logs/SCIENTIST.md",
            "replay_kit/results/README.md",
            "replay_kit/forecast/README.md",
            "replay_kit/workflows/replay/README.md",
            "replay_kit/workflows/fleet/README.md",
            "replay_kit/studies/README.md",
            "tests/benchmarks/README.md",
        ),
    ),
    (
        "Formats",
        (
            "replay_kit/logs/README.md",
            "replay_kit/logs/netcdf/README.md",
            "replay_kit/logs/mavlink/README.md",
            "replay_kit/logs/tables/README.md",
            "replay_kit/logs/tables/ADCP_PING.md",
            "replay_kit/results/CHANNELS.md",
        ),
    ),
    (
        "How it works",
        (
            "replay_kit/estimator/METHOD.md",
            "replay_kit/estimator/README.md",
            "replay_kit/measurements/README.md",
            "replay_kit/measurements/checks/README.md",
            "planners/README.md",
        ),
    ),
    ("Reference", ("replay_kit/cli/README.md", "replay_kit/config/README.md", "settings.md")),
    (
        "For developers",
        (
            "replay_kit/README.md",
            ".github/CONTRIBUTING.md",
            ".github/CODE_OF_CONDUCT.md",
            "replay_kit/core/README.md",
            "replay_kit/workflows/README.md",
            "tests/README.md",
            "tests/record/README.md",
            "replay_kit/DECISIONS.md",
            ".github/SECURITY.md",
            "replay_kit/CHANGELOG.md",
        ),
    ),
)
_LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)\s]*)?\)")


def pages() -> dict[Path, str]:
    """Return the text of each page by its path in the site."""
    written = [
        name for _, names in CHAPTERS for name in ("README.md", *names) if name != "settings.md"
    ]
    found = {Path(name): (ROOT / name).read_text(encoding="utf-8") for name in written}
    found[Path("README.md")] += "\n".join(map(_contents, *zip(*CHAPTERS, strict=True)))
    found[Path("settings.md")] = _settings_page()
    for package in PACKAGES:
        found[_reference(package)] = (
            f"# {package}\n\n```{{eval-rst}}\n.. automodule:: {package}\n   :members:\n```\n"
        )
    return found


def build(folder: Path) -> None:
    """Build the site into a folder.

    Raises:
        SystemExit: Sphinx warned of something.
    """
    with tempfile.TemporaryDirectory() as name:
        source = Path(name) / "source"
        for path, text in pages().items():
            (source / path).parent.mkdir(parents=True, exist_ok=True)
            (source / path).write_text(text, encoding="utf-8")
            for target in _linked(path, text):
                (source / target).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / target, source / target)
        app = Sphinx(
            source,
            None,
            folder,
            Path(name) / "doctrees",
            "html",
            confoverrides=_CONFIGURATION,
            warningiserror=True,
            status=None,
        )
        app.build()
    if app.statuscode:
        raise SystemExit(app.statuscode)


_CONFIGURATION = {
    "project": "replay-kit",
    "version": __version__,
    "release": __version__,
    "root_doc": "README",
    "extensions": ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"],
    "html_theme": "furo",
    "html_title": f"replay-kit {__version__}",
    "html_copy_source": False,
    "myst_heading_anchors": 4,
    "autodoc_typehints": "none",
    "napoleon_google_docstring": True,
    "napoleon_numpy_docstring": False,
    # fields of a named tuple have descriptions of their own
    "napoleon_use_ivar": True,
}


def settings(model: type[BaseModel], before: str = "") -> Iterator[tuple[str, str]]:
    """Yield the name and meaning of each setting of a model, tables within it included.

    Args:
        model: The settings.
        before: Name of the table, with a dot at its end.
    """
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from settings(field.annotation, f"{before}{name}.")
        else:
            default = (
                ""
                if field.is_required() or field.default is None
                else f" Default: {field.default}."
            )
            yield f"{before}{name}", f"{field.description or ''}{default}"


def _settings_page() -> str:
    rows = "".join(
        f"| `{name}` | {text.replace('|', chr(92) + '|')} |\n" for name, text in settings(RunConfig)
    )
    return (
        "# Settings\n\nKeys of the TOML file of `--config`, and of `settings=` in scripts.\n\n"
        f"| setting | meaning |\n|---|---|\n{rows}"
    )


def _reference(package: str) -> Path:
    return Path("reference", f"{package}.md")


def _contents(title: str, names: tuple[str, ...]) -> str:
    """Return the table of contents of a chapter, which the theme shows beside each page."""
    of_packages = [str(_reference(package)) for package in PACKAGES] if title == "Reference" else []
    listed = "\n".join([*names, *of_packages])
    return f"\n```{{toctree}}\n:hidden:\n:caption: {title}\n\n{listed}\n```\n"


def _linked(page: Path, text: str) -> Iterator[Path]:
    """Yield the files of the project that a page links to or shows, other than pages."""
    for target in _LINK.findall(text):
        if "://" in target or target.endswith(".md"):
            continue
        path = (ROOT / page.parent / target).resolve()
        if path.is_file() and path.is_relative_to(ROOT):
            yield path.relative_to(ROOT)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    build(parser.parse_args().folder)
    sys.exit(0)
