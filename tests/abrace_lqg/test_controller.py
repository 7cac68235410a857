"""The run-time law is Eq. (13), cut to the force limit."""

from __future__ import annotations

import numpy as np
import pytest

from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel
from abrace_core.simulation import simulate
from abrace_lqg.controller import ControlLaw


def matrices(commands: int = 2) -> tuple[np.ndarray, ...]:
    random = np.random.default_rng(5)
    a = 0.2 * random.standard_normal((6, 6))
    return a, *(random.standard_normal(shape) for shape in ((6, 3), (commands, 6), (commands, 3)))


def test_it_gives_the_response_of_eq_13():
    a, b, c, d = matrices()
    law = ControlLaw(a, b, c, d, np.full(2, 1e9))
    y = np.random.default_rng(6).standard_normal((200, 3))
    found = np.array([law.update(row).copy() for row in y])
    model = LinearModel(a, b, c, d, ("a1", "a2", "a3"), ("U1", "U2"), 0.002)
    np.testing.assert_allclose(found, simulate(model, y), rtol=1e-10, atol=1e-12)


def test_the_first_command_answers_the_first_sample():
    a, b, c, d = matrices()
    np.testing.assert_allclose(ControlLaw(a, b, c, d, np.full(2, 1e9)).update([1.0, 2.0, 3.0]), d @ [1.0, 2.0, 3.0])


def test_commands_are_cut_to_the_force_limit_each_with_its_own():
    a, b, c, d = matrices()
    limit = np.array([0.5, 1.5])
    law = ControlLaw(a, b, c, d, limit)
    y = 10 * np.random.default_rng(6).standard_normal((100, 3))
    found = np.array([law.update(row).copy() for row in y])
    free = ControlLaw(a, b, c, d, np.full(2, 1e9))
    np.testing.assert_allclose(found, [np.clip(free.update(row), -limit, limit) for row in y], rtol=1e-10, atol=1e-12)
    assert (np.abs(found).max(axis=0) == limit).all()


def test_reset_forgets_the_past():
    a, b, c, d = matrices()
    law = ControlLaw(a, b, c, d, np.full(2, 1e9))
    first = law.update([1.0, 2.0, 3.0]).copy()
    law.update([4.0, 5.0, 6.0])
    law.reset()
    np.testing.assert_array_equal(law.update([1.0, 2.0, 3.0]), first)


def test_the_same_samples_give_the_same_bits():
    a, b, c, d = matrices()
    y = np.random.default_rng(6).standard_normal((100, 3))
    runs = []
    for _ in range(2):
        law = ControlLaw(a, b, c, d, np.full(2, 1e9))
        runs.append(np.array([law.update(list(row)).copy() for row in y]).tobytes())
    assert runs[0] == runs[1]


@pytest.mark.parametrize("wrong", ["a", "b", "c", "d", "force_limit"])
def test_matrices_that_do_not_fit_are_refused(wrong: str):
    a, b, c, d = matrices()
    parts = {"a": a, "b": b, "c": c, "d": d, "force_limit": np.ones(2)}
    parts[wrong] = parts[wrong][:-1]
    with pytest.raises(AbraceError, match="control law"):
        ControlLaw(**parts)


def test_a_wrong_number_of_measured_values_is_refused():
    law = ControlLaw(*matrices(), np.ones(2))
    with pytest.raises(ValueError, match="shape"):
        law.update([1.0, 2.0])
