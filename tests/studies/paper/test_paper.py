"""The study of the paper on small ensembles: its tables, its files, its doors."""

import csv
import io
import json
import math
from dataclasses import asdict, fields, replace

import numpy as np
import pytest

import planners
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.grid import Ensemble
from replay_kit.core.words.progress import shown_by
from replay_kit.estimator import embed_member
from replay_kit.studies.paper import cases
from replay_kit.studies.paper.cases import (
    IDEAL_ERROR_STD,
    Case,
    draw_pairs,
    grid_observations,
    leave_out,
    random_observations,
)
from replay_kit.studies.paper.methods import (
    GlideRow,
    Run,
    Rung,
    Survey,
    build_method,
    rungs,
    span_of,
)
from replay_kit.studies.paper.methods import run as run_row
from replay_kit.studies.paper.page import FILES, files_of, text_tables, to_json, to_markdown
from replay_kit.studies.paper.run import ErrorRow, PaperJob, SparseRow, error_rows, run_paper
from replay_kit.studies.twins.field import build_field
from replay_kit.workflows.replay.conclude import scored_points
from tests import synthetic
from tests.command import invoke
from tests.show.page.checks import check_figures
from tests.show.report.html_of import table

MEMBERS = synthetic.ensemble(n_members=6, shape=(8, 9))
CONFIG = EstimatorConfig()
JOB = PaperJob(leave_out="2", most_modes=12, plan_modes=12, pings=(3, 10), pairs=2)


def final(truth, job):
    *_, last = run_paper(truth, None, CONFIG, job)
    return last


@pytest.fixture(scope="module")
def study():
    seen = []
    with shown_by(lambda *step: seen.append(step)):
        *_, tables = run_paper(MEMBERS, None, CONFIG, JOB)
    for stage in ("tables", "plans and flights"):
        done = [step[:2] for step in seen if step[2] == stage]
        assert done == [(k, len(done)) for k in range(1, len(done) + 1)]
    return tables


@pytest.fixture(scope="module")
def folder(study, tmp_path_factory):
    out = tmp_path_factory.mktemp("paper")
    for name, text in files_of(study).items():
        (out / name).write_text(text)
    return out


@pytest.fixture
def without_planning(monkeypatch):
    """Where what is planned does not matter: a plan takes half a second."""
    monkeypatch.setattr(planners, "plan_mission", lambda flow, request: None)
    monkeypatch.setattr(planners, "closest_approach", lambda truth, plan: 1.0)


def combination() -> Case:
    """A truth that is a linear combination of the members, slice by slice."""
    weights = np.array([0.5, -0.3, 0.2, 0.4, 0.1, 0.1])
    velocity = np.einsum("e,ecz...->cz...", weights, MEMBERS.velocity)[None]
    return Case(Ensemble(MEMBERS.grid, velocity, None, "combination"), MEMBERS)


def table_of(case, config=CONFIG, most_modes=None):
    profiles = grid_observations(case.truth)
    survey = Survey(profiles, IDEAL_ERROR_STD, (len(profiles),))
    asked = rungs(case.ensemble, most_modes)
    return error_rows([run_row(case, survey, rung, config, keep=False) for rung in asked])


def with_land(ensemble):
    """An ensemble with one dry column, and one of two levels."""
    wet = ensemble.grid.wet.copy()
    wet[2:, 0, 0] = wet[:, 3, 3] = False
    velocity = np.where(wet, ensemble.velocity, np.nan)
    return Ensemble(replace(ensemble.grid, wet=wet), velocity, None, "land")


def test_a_truth_in_the_span_is_found():
    """The stated error of 1 cm/s against anomalies of some 20 cm/s leaves little of the prior.

    The default allows for what shifted members show that its basis leaves out, and so trusts the measurements a little less. Its
    variance is the ensemble's: six members and no more than these are not what it looks for in the log.
    """
    config = CONFIG.model_copy(update={"dropped_std": 1e-3, "spread": 1.0})
    by_key = {(row.method, row.rung): row for row in table_of(combination(), config)}
    assert by_key["default", "full"].rel_error < 0.015
    assert by_key["default", "full"].bound < 1e-3
    assert by_key["default", "members"].rel_error > by_key["default", "full"].rel_error
    assert by_key["naive3d", ""].rel_error < 0.01
    assert by_key["nearest", ""].rel_error > 0.1
    assert by_key["ensemble_mean", ""].rel_error > 0.1


def test_no_row_beats_its_bound(study):
    for row in (*study.table1, *study.table2):
        assert not row.note
        assert row.rmse >= row.bound * (1.0 - 1e-6), row
        assert 0.0 < row.rel_error < 2.0


def test_the_bound_counts_what_the_basis_keeps_whole():
    """The default's weights are anomalies: the ensemble's mean lies in its span whatever the modes are."""
    mean = Ensemble(MEMBERS.grid, MEMBERS.velocity.mean(axis=0, keepdims=True), None, "mean")
    at = scored_points(MEMBERS.grid, mean)
    least = {
        preset: span_of(build_method(preset, MEMBERS, EstimatorConfig(modes=1)), at)[2]
        for preset in ("default", "paper")
    }
    assert least["default"] < 1e-3 < 0.02 < least["paper"]


def test_rows_are_those_that_exist():
    ensemble = synthetic.ensemble(n_members=6, shape=(4, 5))
    rows = table_of(leave_out(ensemble, 0))
    # five members of four levels: 20 slices, 16 anomalies about the mean and the mean; no 400, 300 or 200
    asked = [(row.method, row.rung, row.modes) for row in rows if row.rung]
    both = (("full", 20), ("members", 5))
    assert asked == [(name, *one) for name in ("paper", "default") for one in both]
    elements = {row.method: row.elements for row in rows if row.rung in ("members", "")}
    # the latent values of a level times r, on a lattice and at the nodes, and for whole flows 2 N Z a mode
    held = {"naive3d": 40 * 4 * 5, "paper": 200, "default": 19 * 18 * 5}
    assert elements == held | dict.fromkeys(("nearest", "ensemble_mean"))
    coarse = rungs(synthetic.ensemble(n_members=4, shape=(4, 4), step=0.3), None)
    shown, usual = ({rung.method for rung in each} for each in (coarse, rungs(MEMBERS, None)))
    assert shown - usual == {"paper_cells"}


def test_numerics_that_fail_are_a_row_with_the_reason():
    """Two levels at one depth cannot be told apart by the paper's Gaussians."""
    grid = replace(MEMBERS.grid, levels=np.array([5.0, 5.0, 150.0, 300.0]))
    twice = Ensemble(grid, MEMBERS.velocity, None, "twice")
    case = leave_out(twice, 0)
    row = next(row for row in table_of(case, most_modes=4) if row.method == "paper")
    assert "cannot be built" in row.note
    assert "the levels 5, 5, 150, 300 m" in row.note
    assert math.isnan(row.rel_error)


@pytest.mark.usefixtures("without_planning")
@pytest.mark.full
def test_a_study_goes_on_around_land_and_without_a_method_that_fails(monkeypatch):
    def build(name, ensemble, config):
        if name == "paper":
            raise np.linalg.LinAlgError("Singular matrix")
        return build_method(name, ensemble, config)

    monkeypatch.setattr("replay_kit.studies.paper.methods.build_method", build)
    tables = final(with_land(MEMBERS), replace(JOB, pairs=1))
    (row,) = (row for row in tables.table3 if row.flow == "paper")
    assert (row.pairs, "no estimate" in row.note) == (0, True)
    for found in (tables.table1, tables.table2):
        assert {row.method for row in found if row.note} == {"paper"}
    assert "cannot be built: Singular matrix" in to_markdown(tables)
    assert to_json(tables)["sparse"][0]["rel_error"] is None


def test_the_ideal_profiles_are_the_grid_points():
    truth = leave_out(MEMBERS, 1).truth
    land = with_land(truth)
    profiles = grid_observations(land)
    assert len(profiles) == 8 * 9 - 1
    assert np.isnan(profiles[0].velocity[2:]).all()
    np.testing.assert_array_equal(profiles[5].depth, truth.grid.levels)
    assert np.all(profiles[5].error_std == IDEAL_ERROR_STD)
    speed = np.hypot(*truth.velocity[0, :, :, 0, 5])
    np.testing.assert_allclose(np.hypot(*profiles[5].velocity.T), speed, rtol=1e-12)


def test_the_way_through_the_pings_ends_in_table_2(study):
    methods = "paper", "default", "ensemble_mean"
    found = [(row.pings, row.method) for row in study.sparse]
    assert found == [(n, method) for n in (3, 10) for method in methods]
    last = {row.method: row.rel_error for row in study.sparse if row.pings == 10}
    # the first row of a method has as many modes as plans are made on, the next fewer
    first = {row.method: row.rel_error for row in reversed(study.table2)}
    assert last == {method: first[method] for method in last}


def test_targets_are_reached_by_the_truth_s_own_plans(study):
    rows = {row.flow: row for row in study.table3}
    flows = "truth depth_averaged_truth naive3d paper default nearest ensemble_mean"
    assert list(rows) == flows.split()
    assert rows["truth"].within_250 == 2
    assert max(rows["truth"].closest_approach) < 10.0
    for row in rows.values():
        assert row.median == pytest.approx(np.median(row.closest_approach))
        assert row.median_low <= row.median <= row.median_high
        assert row.within_250 == sum(distance <= 250.0 for distance in row.closest_approach)


def test_pairs_stay_in_the_water_of_both_grids(monkeypatch):
    truth = leave_out(MEMBERS, 0).truth
    flow, field = embed_member(truth, 0, CONFIG), build_field(truth)
    pairs = draw_pairs(field, flow, MEMBERS.grid, 3, 7)
    assert pairs == draw_pairs(field, flow, MEMBERS.grid, 3, 7)
    assert pairs != draw_pairs(field, flow, MEMBERS.grid, 3, 8)
    pinged = {round(ping.longitude, 6) for ping in random_observations(field, 3, 0.0, 7)}
    assert not pinged & {round(start.longitude, 6) for start, _ in pairs}
    # the deepest level is shallower than the paper's targets
    assert all((start.depth, target.depth) == (0.0, 300.0) for start, target in pairs)
    monkeypatch.setattr(cases, "_MAX_DRAWS", 1)
    dry = replace(MEMBERS.grid, wet=np.zeros_like(MEMBERS.grid.wet))
    with pytest.raises(ForecastError, match="larger region"):
        draw_pairs(field, flow, dry, 1, 7)
    with pytest.raises(ForecastError, match="below the surface"):
        draw_pairs(field, flow, replace(MEMBERS.grid, levels=np.array([0.0])), 1, 7)


def test_over_truths_the_median_and_the_worst():
    def run(error, note=""):
        rung = Rung("paper", "full", None)
        return Run(rung, 0.1, 9, 90, 0.01, (0.1 * error,), 1.0, None, note)

    (both,) = error_rows([run(0.2), run(0.2), run(0.6)])
    assert (both.rel_error, both.rel_error_worst) == pytest.approx((0.2, 0.6))
    assert both.rmse_worst == pytest.approx(0.06)
    assert both.rel_error_by_truth == pytest.approx((0.2, 0.2, 0.6))
    (some,) = error_rows([run(0.2), run(math.nan, "singular")])
    assert (some.rel_error, some.note) == (pytest.approx(0.2), "1 of 2 truths: singular")


@pytest.mark.usefixtures("without_planning")
@pytest.mark.full
def test_all_members_in_turn():
    few = Ensemble(MEMBERS.grid, MEMBERS.velocity[:3], None, "three")
    job = PaperJob("all", most_modes=4, plan_modes=4, pings=(2,), pairs=1)
    *partial, tables = run_paper(few, None, CONFIG, job)
    told = [(part.unfinished, part.truths, len(part.table3)) for part in partial]
    assert told == [(True, k, 0) for k in (1, 2, 3)]
    assert partial[-1].table1 == tables.table1
    assert len(partial[0].table2[0].rel_error_by_truth) == 1
    assert not tables.unfinished
    # of a study that is not finished the tables are written, and what is not known yet is not
    files = files_of(partial[0])
    assert sorted(files) == ["paper.json", "sparse.csv", "table1.csv", "table2.csv"]
    assert json.loads(files["paper.json"])["unfinished"] is True
    assert "unfinished" not in to_json(tables)
    assert (tables.truth, tables.truths) == ("all", 3)
    assert tables.shown_truth.startswith("three#")
    for row in tables.table1:
        assert len(row.rel_error_by_truth) == 3
        assert row.rel_error <= row.rel_error_worst
    assert "worst rel. error" in text_tables(tables)[0][1][0]


def test_files_say_the_same_numbers(study, folder):
    assert sorted(path.name for path in folder.iterdir()) == sorted(FILES)
    answer = json.loads((folder / "paper.json").read_text())
    assert answer == json.loads(json.dumps(to_json(study), allow_nan=False))
    assert {"replay-kit", "numpy", "casadi"} <= set(answer["versions"])
    assert answer["seed"] == 0
    kinds = {"table1": ErrorRow, "table2": ErrorRow, "table3": GlideRow, "sparse": SparseRow}
    for name, kind in kinds.items():
        rows = list(csv.DictReader(io.StringIO((folder / f"{name}.csv").read_text())))
        assert list(rows[0]) == [field.name for field in fields(kind)] == list(answer[name][0])
        for row, in_json, value in zip(rows, answer[name], getattr(study, name), strict=True):
            # every figure to the last digit, in all of them
            for key, cell in asdict(value).items():
                if isinstance(cell, float):
                    assert float(row[key]) == in_json[key] == cell
    unknown = replace(study, table1=(replace(study.table1[0], rel_error=math.nan),))
    assert next(csv.DictReader(io.StringIO(files_of(unknown)["table1.csv"])))["rel_error"] == ""


def test_console_report_and_page_show_the_rows(study, folder):
    written = (folder / "report.md").read_text()
    cells = {cell for _, rows in text_tables(study) for row in rows for cell in row.values()}
    for row in (*study.table1, *study.table2):
        for text in (cells, written):
            assert f"{row.rel_error:.3f}" in text
            assert f"{row.rmse:.4f}" in text
    for row in study.table3:
        assert f"{row.lower_quartile:.0f} to {row.upper_quartile:.0f}" in written
    page, (title, rows) = (folder / "index.html").read_text(), text_tables(study)[0]
    assert [row[0] for row in table(page, title)] == [row["estimator"] for row in rows]
    figures = check_figures(page)
    sparse, glides = (
        {mark["name"]: mark for mark in figures[key]["panels"][0]["marks"]}
        for key in ("sparse", "glides")
    )
    (row,) = [row for row in study.sparse if (row.method, row.pings) == ("default", 10)]
    assert sparse["2.5D default"]["x"] == [3.0, 10.0]
    assert sparse["2.5D default"]["y"][1] == pytest.approx(row.rel_error, rel=1e-4)
    (glide,) = [row for row in study.table3 if row.flow == "nearest"]
    mark = glides["nearest member"]
    assert mark["y"] == [0.0, 0.5, 0.5, 1.0]
    np.testing.assert_allclose(mark["x"][::2], np.sort(glide.closest_approach), rtol=1e-4)


@pytest.fixture(scope="module")
def ocean(tmp_path_factory):
    place = tmp_path_factory.mktemp("ocean")
    synthetic.dataset(n_members=6, shape=(7, 8)).to_netcdf(place / "ensemble.nc", engine="h5netcdf")
    (place / "full").mkdir()
    (place / "full" / "table1.csv").write_text("precious")
    (place / "file").write_text("precious")
    return place


def paper(ocean, words):
    return invoke(f"experiment paper --ensemble {ocean}/ensemble.nc {words}")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("-o new", "--truth and --leave-out"),
        ("-o new --leave-out 0 --truth ensemble.nc", "--truth and --leave-out"),
        ("-o new --leave-out some", "all or most-distant"),
        ("-o new --leave-out 9", "expected 0 to 5"),
        ("-o full --leave-out 0", "--overwrite"),
        ("-o file --leave-out 0", "is a file"),
        ("-o absent/new --leave-out 0", "there is no folder"),
        ("-o new --leave-out 0 --modes none", "modes"),
        ("-o new --truth t.json --json t.json --overwrite", "an input is never overwritten"),
    ],
)
def test_wrong_options_end_with_code_2(ocean, monkeypatch, arguments, said):
    monkeypatch.chdir(ocean)
    done = paper(ocean, arguments)
    assert (done.exit_code, said in str(done.exception)) == (2, True)
    assert (ocean / "full" / "table1.csv").read_text() == "precious"


@pytest.mark.usefixtures("without_planning")
@pytest.mark.full
def test_the_command_writes_a_folder_and_replaces_it_when_told(ocean):
    files = f"-o {ocean}/full --overwrite --json {ocean}/a.json"
    done = paper(ocean, f"--leave-out most-distant --modes 4 --pairs 1 {files}")
    assert done.exit_code == 0, done.exception
    assert "Table III" in done.stdout
    answer = json.loads((ocean / "a.json").read_text())
    kept = json.loads((ocean / "full" / "paper.json").read_text())
    assert answer == {"format_version": 2, **kept}
    assert (ocean / "full" / "table1.csv").read_text().startswith("method,")
    # the naive basis has more modes than the limit of those a level, and is planned on all the same
    assert "naive3d" in [row["flow"] for row in answer["table3"]]
