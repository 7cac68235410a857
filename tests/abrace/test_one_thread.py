# SPDX-License-Identifier: Apache-2.0
import importlib

import numpy as np
import pytest
import scipy.linalg
from threadpoolctl import threadpool_info, threadpool_limits

from abrace_core import AbraceError
from abrace_core.model.one_thread import one_thread


def threads() -> set[int]:
    """Of the libraries of linear algebra that NumPy and SciPy have loaded."""
    scipy.linalg.svdvals(np.eye(2))
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


@pytest.fixture(autouse=True)
def several():
    """Two threads outside, as on a machine with two processors."""
    with threadpool_limits(2, user_api="blas"):
        if threads() != {2}:
            pytest.skip("this linear algebra cannot use two threads")
        yield
        assert threads() == {2}, "as before"


def test_linear_algebra_has_one_thread_within_and_as_many_as_before_after_an_error():
    with one_thread():
        assert threads() == {1}
    with pytest.raises(ZeroDivisionError), one_thread():
        raise ZeroDivisionError


@pytest.mark.parametrize(
    ("module", "function", "called", "given"),
    [
        ("identification", "identify", "identification.identify", ("table", "command")),
        ("data", "identify_ambient", "AmbientOptions.read", ("quiet",)),
        ("data", "identify_data", "DataOptions.read", ("data.csv", ["u"])),
        ("controllers", "design", "model_of", ("model.json", "weights.yaml")),
        ("validation", "validate", "model_of", ("test", "model.json")),
    ],
)
def test_what_takes_long_in_python_has_one_thread(module, function, called, given, monkeypatch):
    found = []

    def seen(*_, **__):
        found.append(threads())
        raise AbraceError("seen")

    where = importlib.import_module(f"abrace.interactive.{module}")
    monkeypatch.setattr(f"abrace.interactive.{module}.{called}", seen)
    with pytest.raises(AbraceError, match="seen"):
        getattr(where, function)(*given)
    assert found == [{1}]
