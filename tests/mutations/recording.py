"""A pytest plugin that records which test executes which line: ``pytest -p tests.mutations.recording``.

The environment names the folder it writes to (``MUTATIONS_RECORD``): ``lines.coverage``, coverage's database with one context
a test, and ``tests.json``, the seconds, the outcome and the shared fixtures of every test. What a fixture of a module or of
the session executes counts for every test that uses it, and all caches are emptied before each test: otherwise only the first
test to come would be said to cover the line.
"""

import importlib
import json
import os
import pkgutil
import sys
import time
from pathlib import Path

import coverage
import pytest

from tests.mutations.targets import PACKAGES

IMPORT = "import"  # the context of what runs outside of every test
FIXTURE = (
    "fixture"  # and of a shared fixture: this word, its name and the node below which it is visible
)


class Recorder:
    """What one run of the tests executes."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.coverage = coverage.Coverage(
            data_file=str(folder / "lines.coverage"),
            source=list(PACKAGES),
            config_file=False,
            messages=False,
        )
        self.coverage.set_option("run:relative_files", True)
        self.coverage.start()
        self.context = IMPORT
        self.coverage.switch_context(IMPORT)
        # a module that only the first of its tests imports would count as executed by that test alone
        for package in map(
            importlib.import_module, (name for name in PACKAGES if Path(name).is_dir())
        ):
            for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
                if not module.name.endswith(".__main__"):
                    importlib.import_module(module.name)
        self.tests: dict[str, dict[str, object]] = {}

    def switch(self, context: str) -> str:
        """Make ``context`` the current one and return the one before."""
        before, self.context = self.context, context
        self.coverage.switch_context(context)
        return before

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item):
        empty_caches()
        before = self.switch(item.nodeid)
        self.tests[item.nodeid] = {"passed": False, "fixtures": list(item.fixturenames)}
        began = time.perf_counter()
        try:
            return (yield)
        finally:
            self.tests[item.nodeid]["seconds"] = time.perf_counter() - began
            self.switch(before)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef):
        if fixturedef.scope == "function":
            return (yield)
        before = self.switch(f"{FIXTURE} {fixturedef.argname} {fixturedef.baseid}")
        try:
            return (yield)
        finally:
            self.switch(before)

    def pytest_runtest_logreport(self, report):
        if report.when == "call":
            self.tests[report.nodeid]["passed"] = report.passed

    def pytest_sessionfinish(self):
        self.coverage.stop()
        self.coverage.save()
        (self.folder / "tests.json").write_text(json.dumps(self.tests), encoding="utf-8")


def empty_caches() -> None:
    """Forget what functions of the packages and of what tests share have cached, so that each test executes what it needs."""
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] in (*PACKAGES, "tests"):
            for value in list(vars(module).values()):
                if hasattr(value, "cache_clear"):
                    value.cache_clear()


@pytest.hookimpl(tryfirst=True)
def pytest_load_initial_conftests(early_config):
    # before tests/conftest.py imports modules of the packages: what those run at import would else count as run by no test
    early_config.pluginmanager.register(Recorder(Path(os.environ["MUTATIONS_RECORD"])))
