"""The public functions and classes as one page that needs no server: ``python -m tests.release.reference reference.html``.

What is public is what ``__all__`` of these packages names; texts are their docstrings, read by griffe in Google's style without an import.
"""

import re
import sys
from collections.abc import Iterator
from html import escape
from pathlib import Path
from textwrap import dedent

import griffe
from pydantic import BaseModel

from replay_kit.config.run import RunConfig
from replay_kit.core.version import __version__

PACKAGES = (
    "replay_kit",
    "planners",
    "replay_kit.logs",
    "replay_kit.measurements",
    "replay_kit.forecast",
    "replay_kit.estimator",
    "replay_kit.results",
)
_STYLE = Path(__file__).parents[2] / "replay_kit" / "show" / "page" / "page.css"
_OWN_STYLE = """
dt { margin-top: .4rem; } dd { margin-left: 1.5rem; max-width: 95ch; } dl { margin: 0 0 .75rem; } pre { white-space: pre-wrap; }
article { margin: 2rem 0; padding-top: .75rem; border-top: 1px solid var(--line); } .kind { margin: .5rem 0 0; color: var(--soft); }
.method { margin: 1rem 0 0 1.25rem; padding-left: 1rem; border-left: 3px solid var(--line); } h4 { margin: 0 0 .25rem; }
"""


def reference_html() -> str:
    """Return the page: the packages with their members in the order of ``__all__``, then every setting."""
    roots = {
        name: griffe.load(name, docstring_parser="google", resolve_aliases=True)
        for name in ("replay_kit", "planners")
    }
    modules = {
        name: _target(roots[name] if name in roots else roots["replay_kit"][name.partition(".")[2]])
        for name in PACKAGES
    }
    parts = [_package_html(name, module) for name, module in modules.items()]
    links = "".join(f'<li><a href="#{name}">{name}</a></li>' for name in (*PACKAGES, "settings"))
    rows = "".join(
        f"<tr><td><code>{escape(name)}</code></td><td>{_words(text)}</td></tr>"
        for name, text in settings(RunConfig)
    )
    title = f"replay-kit {__version__}: reference"
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<link rel="icon" href="data:,">
<title>{title}</title>
<style>{_STYLE.read_text(encoding="utf-8")}{_OWN_STYLE}</style>
</head>
<body>
<header><h1>{title}</h1><nav aria-label="Packages"><ul>{links}</ul></nav></header>
<main>
{"".join(parts)}
<section id="settings"><h2>settings</h2><p>Keys of the TOML file of <code>--config</code>, and of <code>settings=</code> in scripts.</p>
<table><tr><th>setting</th><th>meaning</th></tr>{rows}</table></section>
</main>
</body>
</html>
"""


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


def _target(thing: griffe.Object | griffe.Alias) -> griffe.Object:
    """Return what a name stands for, through imports."""
    return thing.final_target if isinstance(thing, griffe.Alias) else thing


def _package_html(name: str, package: griffe.Object) -> str:
    named = [str(member).strip("'\"") for member in package.exports or ()]
    members = [
        (member, _target(package[member])) for member in named if not member.startswith("__")
    ]
    links = "".join(f'<li><a href="#{name}.{member}">{member}</a></li>' for member, _ in members)
    articles = "".join(_article(f"{name}.{member}", thing) for member, thing in members)
    return f'<section id="{name}"><h2>{name}</h2>{_docstring(package)}<nav aria-label="{name}"><ul>{links}</ul></nav>{articles}</section>'


def _article(name: str, thing: griffe.Object) -> str:
    """Return a function, class or value with its public methods."""
    inner = ""
    if isinstance(thing, griffe.Class):
        public = [
            _target(member) for key, member in thing.all_members.items() if not key.startswith("_")
        ]
        methods = [
            member
            for member in public
            if member.docstring and (member.is_function or "property" in member.labels)
        ]
        inner = "".join(
            f'<div class="method"><h4><code>{escape(_signature(member))}</code></h4>{_docstring(member)}</div>'
            for member in methods
        )
    return f'<article id="{name}"><h3><code>{escape(_signature(thing, name))}</code></h3>{_docstring(thing)}{inner}</article>'


def _signature(thing: griffe.Object, name: str = "") -> str:
    """Return a name with its parameters, without their types, which the docstring's words replace."""
    if isinstance(thing, griffe.Class):
        parameters = [parameter.name for parameter in thing.parameters if parameter.name != "self"]
        return f"class {name}({', '.join(parameters)})"
    if not isinstance(thing, griffe.Function):
        return name or thing.name
    shown = [
        parameter.name
        + (
            f"={parameter.default}"
            if parameter.default is not None and not parameter.name.startswith("*")
            else ""
        )
        for parameter in thing.parameters
        if parameter.name not in ("self", "cls")
    ]
    return f"{name or thing.name}({', '.join(shown)})"


def _docstring(thing: griffe.Object) -> str:
    """Return a docstring as HTML: its text, and its sections as lists."""
    return "".join(map(_section, thing.docstring.parsed)) if thing.docstring else ""


def _section(section: griffe.DocstringSection) -> str:
    if isinstance(section, griffe.DocstringSectionText):
        return "".join(_paragraph(text) for text in section.value.split("\n\n"))
    if isinstance(section, griffe.DocstringSectionAdmonition):
        return f"<p>{_words(section.value.kind)}: {_words(section.value.contents)}</p>"
    entries = "".join(
        f"<dt><code>{escape(getattr(item, 'name', '') or str(item.annotation or ''))}</code></dt><dd>{_words(item.description)}</dd>"
        for item in section.value
    )
    return f'<p class="kind">{section.kind.value.capitalize()}</p><dl>{entries}</dl>'


def _paragraph(text: str) -> str:
    if all(line.startswith("    ") for line in text.splitlines() if line):
        return f"<pre>{escape(dedent(text))}</pre>"
    first, *points = re.split(r"^\* ", text, flags=re.MULTILINE)
    listed = "".join(f"<li>{_words(point)}</li>" for point in points)
    return (f"<p>{_words(first)}</p>" if first.strip() else "") + (
        f"<ul>{listed}</ul>" if points else ""
    )


def _words(text: str) -> str:
    """Return text as HTML, with what stands between double backticks as code."""
    return re.sub(r"``(.+?)``", r"<code>\1</code>", escape(text), flags=re.DOTALL)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(reference_html(), encoding="utf-8")
