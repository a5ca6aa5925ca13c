"""The notebooks beside the samples: their code runs, figures and errors are shown as a notebook shows them."""

import ast
import json
import shutil
import warnings
from typing import Any

import pytest
from matplotlib.figure import Figure

import replay_kit as rk
from replay_kit.core.errors import LogError
from tests.places import ROOT, SAMPLES

NOTEBOOKS = ("pilot", "scientist")


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_the_code_of_a_notebook_runs_and_shows_what_it_ends_with(name, monkeypatch, tmp_path):
    for path in SAMPLES.iterdir():
        if path.suffix in (".nc", ".mcap"):
            shutil.copy(path, tmp_path)
    monkeypatch.chdir(tmp_path)
    cells = json.loads((SAMPLES / f"{name}.ipynb").read_text())["cells"]
    assert not any(cell.get("outputs") for cell in cells)
    names: dict[str, Any] = {}
    shown = []
    for cell in cells:
        if cell["cell_type"] != "code":
            continue
        body = ast.parse("".join(cell["source"])).body
        last = body.pop() if isinstance(body[-1], ast.Expr) else None
        exec(compile(ast.Module(body, []), name, "exec"), names)
        if last is not None:
            shown.append(eval(compile(ast.Expression(last.value), name, "eval"), names))
    figures = [value for value in shown if isinstance(value, Figure)]
    assert figures
    assert all(figure._repr_png_().startswith(b"\x89PNG") for figure in figures)
    assert all(value is not None for value in shown if not isinstance(value, type(print)))


@pytest.mark.full
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs_in_a_kernel_and_shows_its_figure_and_no_bar(name, monkeypatch):
    import nbclient
    import nbformat

    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.delenv("MPLBACKEND", raising=False)
    notebook = nbformat.read(SAMPLES / f"{name}.ipynb", as_version=4)
    with warnings.catch_warnings():
        # of the kernel's client, about the event loop
        warnings.simplefilter("ignore")
        nbclient.NotebookClient(
            notebook, timeout=120, resources={"metadata": {"path": str(SAMPLES)}}
        ).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert not any("<progress" in output.get("data", {}).get("text/html", "") for output in outputs)
    assert not any(output.output_type == "error" for output in outputs)


def test_an_error_is_one_line_and_a_configuration_what_differs_from_the_defaults():
    assert LogError("a.mcap: file not found")._render_traceback_() == [
        "LogError: a.mcap: file not found"
    ]
    assert repr(rk.RunConfig()) == str(rk.RunConfig()) == "RunConfig()"
    assert (
        repr(rk.RunConfig(logs={"clock": "header"})) == "RunConfig(logs=LogConfig(clock='header'))"
    )
