# SPDX-License-Identifier: Apache-2.0
"""Settings of all tests; and which are a package's, for `colcon test`."""

import ast
import gc
import signal
from functools import wraps

import pytest
from hypothesis import HealthCheck, settings

LONGEST = [
    *("test_pages.py", "test_campaign.py", "test_offline.py", "test_first_hour.py"),
    *("test_interactive.py", "test_identification.py", "test_data_identification.py", "test_five_controllers.py"),
    *("test_documented.py", "test_several_groups.py", "test_validity.py"),
]
"""Modules that are run first, so that all processors are done at about the same time."""

# no test asks for speed: an example may take as long as a busy machine needs; the same examples in every run
settings.register_profile("untimed", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

# a shell ignores SIGINT in what a script runs in the background, `nohup` ignores SIGHUP: not in what a test starts
signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, lambda *_: None)

parse = ast.parse


@wraps(parse)
def parse_undisturbed(*arguments, **options):
    """Parse without collecting garbage.

    CPython 3.11 counts the depth of `ast.parse` once for all threads (gh-106905). Where garbage is collected meanwhile,
    Hypothesis is called, another thread may run and parse too, and the count is wrong: a SystemError, which ends pytest
    where it prints a failure.
    """
    collecting = gc.isenabled()
    gc.disable()
    try:
        return parse(*arguments, **options)
    finally:
        if collecting:
            gc.enable()


ast.parse = parse_undisturbed


def pytest_configure(config: pytest.Config) -> None:
    """In the folder of a package, as `colcon test` runs it, the tests are those of `tests/PACKAGE`."""
    package = config.invocation_params.dir
    if config.args == [str(package)] and package.parent == config.rootpath / "src":
        config.args[:] = [str(config.rootpath / "tests" / package.name)]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest modules first."""
    items.sort(key=lambda item: item.path.name not in LONGEST)
