"""What would cost hours is refused before they are spent: tables, schedulers, workers."""

from pathlib import Path

import pytest

from replay_kit.core.errors import ConfigError
from replay_kit.workflows.fleet import cluster as clusters
from replay_kit.workflows.fleet.cluster import UnreachableError, open_workers
from tests.command import invoke

GOOD = '[all]\nensemble = "ensemble.nc"\n'
ONE = '[[mission]]\nlogs = "twin00.mcap"\n'


@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        (GOOD, 2, "'mission': Field required"),
        (GOOD + "[[mission]]\n", 2, "mission 1: expected one of logs, vehicles and each"),
        (GOOD + '[[mission]]\nvehicles.a = "twin00.mcap"\n', 2, "at least 2 items"),
        (GOOD + ONE + 'each = "*.mcap"\n', 2, "mission 1: expected one of logs, vehicles"),
        (GOOD + '[[mission]]\neach = "*.mcap"\nname = "a"\n', 2, "leave name a out"),
        (GOOD + ONE + ONE, 2, "twin00: two missions have this name"),
        (
            GOOD + ONE + '[[mission]]\nlogs = "twin01.mcap"\nname = "TWIN00"\n',
            2,
            "TWIN00: two missions have this name",
        ),
        (GOOD + ONE + 'name = "../up"\n', 2, "'mission.0.name'"),
        (GOOD + '[[mission]]\nlogs = "none.mcap"\n', 2, "none.mcap: file not found"),
        (GOOD + '[[mission]]\neach = "none*.mcap"\n', 3, "none*.mcap: no log has such a name"),
        (
            GOOD + '[[mission]]\neach = ["a*.no", "twin00.mcap", "b*.no"]\n' + ONE,
            3,
            "a*.no, b*.no: no log has such a name",
        ),
        (
            GOOD + ONE + ONE + '[[mission]]\neach = "none*.mcap"\n',
            2,
            "give one of them another name; none*.mcap: no log has such a name",
        ),
        (
            '[all]\nensemble = "none.nc"\n' + ONE + ONE.replace("00", "01"),
            2,
            "twin00 and 1 others: ",
        ),
        (GOOD + ONE + 'truth = "none.nc"\n', 2, "none.nc: file not found"),
        ('[all]\nensemble = "none*.nc"\n' + ONE, 2, "none*.nc"),
        (ONE, 2, "twin00: no ensemble is given"),
        (
            GOOD + ONE + "settings.estimator.mode = 3\n",
            2,
            "mission twin00.mcap: options: unknown key 'estimator.mode'",
        ),
        (
            GOOD + ONE + "speed = 3\n",
            2,
            "unknown key 'mission.0.speed'; known here: config, each, ensemble, goal, logs",
        ),
        ('[all]\nname = "a"\n' + ONE, 2, "[all] has no name, logs, vehicles or each"),
    ],
)
def test_a_table_that_cannot_be_run_is_refused(table, tmp_path, text, code, said):
    bad = table.parent / "bad.toml"
    bad.write_text(text)
    done = invoke(f"fleet {bad} -o {tmp_path}/out --scheduler tcp://127.0.0.1:1")
    assert said in done.stderr, done.output
    assert done.exit_code == code
    assert not (tmp_path / "out").exists()


def test_missions_of_which_some_cannot_begin_are_all_named(table, tmp_path):
    bad = table.parent / "bad.toml"
    bad.write_text(GOOD + ONE + "".join(f'[[mission]]\nlogs = "none{k}.mcap"\n' for k in range(12)))
    done = invoke(f"fleet {bad} -o {tmp_path}/out")
    assert "12 of 13 missions cannot begin: none0: " in done.stderr
    assert "none9.mcap: file not found; correct its name; and 2 more" in done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("fleet.toml --ensemble ensemble.nc", "fleet.toml names the ensembles"),
        ("twin00.mcap", "expected a table (TOML), or logs with --ensemble FILE"),
        (
            "fleet.toml --scheduler tcp://127.0.0.1:1 --workers 2",
            "has its own workers; omit --workers",
        ),
        ("fleet.toml --scheduler nowhere", "the scheduler does not answer in 0.3 s"),
        ("fleet.toml --scheduler tcp://127.0.0.1:1", "the scheduler does not answer in 0.3 s"),
    ],
)
def test_options_that_do_not_fit(table, tmp_path, words, said, monkeypatch):
    monkeypatch.setattr(clusters, "TIMEOUT_S", 0.3)
    words = [
        str(table.parent / word) if "." in word and ":" not in word else word
        for word in words.split()
    ]
    done = invoke(["fleet", *words, "-o", str(tmp_path / "out")])
    assert said in done.stderr, done.output


def test_a_scheduler_without_workers_is_given_up(monkeypatch):
    from distributed import LocalCluster

    monkeypatch.setattr(clusters, "TIMEOUT_S", 0.3)
    empty = LocalCluster(n_workers=0, processes=False, dashboard_address=":0", protocol="tcp")
    try:
        with (
            pytest.raises(UnreachableError, match=r"no worker in 0.3 s; start one: dask worker"),
            open_workers(empty.scheduler_address, None),
        ):
            pass
    finally:
        empty.close()


def test_workers_are_asked_for_their_versions_and_what_they_see(
    scheduler, table, tmp_path, monkeypatch
):
    def asked(*files, out=tmp_path):
        with open_workers(scheduler, None, files, out):
            pass

    asked(table)
    with pytest.raises(ConfigError, match=r"sees another file as .*gone.nc, or none"):
        asked(table, tmp_path / "gone.nc")

    def refuse(path):
        raise PermissionError(path)

    # the command's own file, then that of the worker
    touches = iter((Path.touch, refuse))
    with monkeypatch.context() as patched:
        patched.setattr(Path, "touch", lambda path: next(touches)(path))
        with pytest.raises(ConfigError, match=f"cannot write to {tmp_path}; choose a folder on"):
            asked()
    # the workers are threads of this process: what is asked first are the versions here
    versions = iter([{"replay-kit": "0.0.2"}, {"replay-kit": "0.0.1"}, {}])
    monkeypatch.setattr(clusters, "package_versions", lambda: next(versions))
    with pytest.raises(
        ConfigError, match=r"tcp://.* has other versions, .*: replay-kit 0.0.1 \(here 0.0.2"
    ):
        asked()
    assert not list(tmp_path.iterdir())
