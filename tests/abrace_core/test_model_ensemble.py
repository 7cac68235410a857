# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.linear_model import LinearModel, load_covariance, load_model, save_model
from abrace_core.model.model_ensemble import draw_models

A = np.array([[-0.1, -7.0, 0.0], [7.0, -0.1, 0.0], [0.0, 0.0, -6.0]])


@pytest.fixture
def model() -> LinearModel:
    """A pair and a real pole, and a delay of U: 3 + 6 + 6 + 4 + 2 parameters."""
    c = np.array([[1.0, 0.5, 0.2], [0.3, 0.4, 0.5]])
    b = np.arange(6.0).reshape(3, 2)
    return LinearModel(A, b, c, np.eye(2), ("w", "U"), ("x1", "a1"), input_delay=(0.0, 0.1))


@pytest.fixture
def covariance() -> np.ndarray:
    root = np.random.default_rng(0).standard_normal((21, 21)) * np.linspace(0.001, 0.01, 21)[:, None]
    root[19] = 0.0  # the table has no delay
    return root @ root.T


def parameters(model: LinearModel) -> np.ndarray:
    poles = model.a[0, 0], model.a[1, 0], model.a[2, 2]
    return np.concatenate([poles, model.b.ravel(), model.c.ravel(), model.d.ravel(), model.input_delay])


def test_models_are_drawn_with_the_covariance_of_the_parameters(model, covariance):
    drawn = draw_models(model, covariance, 4000, 1)
    found = np.array([parameters(one) for one in drawn])
    deviation = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.mean(axis=0), parameters(model), atol=0.06 * deviation.max())
    assert not found[:, 19].any(), "the table has no delay"
    unit = np.outer(deviation, deviation)[:, deviation > 0][deviation > 0]
    kept = np.ix_(deviation > 0, deviation > 0)
    np.testing.assert_allclose(np.cov(found.T)[kept] / unit, covariance[kept] / unit, atol=0.08)
    for one in drawn[:5]:
        assert one.a[0, 0] == one.a[1, 1]
        assert one.a[0, 1] == -one.a[1, 0], "a pair stays a pair"
    again = draw_models(model, covariance, 2, 1)
    np.testing.assert_array_equal(again[1].c, drawn[1].c)


def test_no_delay_is_drawn_below_zero(model):
    wide = np.zeros((21, 21))
    wide[20, 20] = 0.1**2
    delays = [one.input_delay[1] for one in draw_models(model, wide, 50, 3)]
    assert min(delays) == 0.0
    assert max(delays) > 0.2


def test_an_unstable_draw_is_drawn_anew(model):
    wide = np.zeros((21, 21))
    wide[0, 0] = 0.2**2
    drawn = draw_models(model, wide, 50, 3)
    assert len(drawn) == 50
    assert all(one.is_stable() for one in drawn)


def test_a_covariance_is_kept_in_the_models_file(model, covariance, tmp_path):
    path = tmp_path / "model.json"
    save_model(model, path, covariance)
    np.testing.assert_array_equal(load_model(path).b, model.b)
    np.testing.assert_array_equal(load_covariance(path), covariance)
    save_model(model, path)
    assert load_covariance(path) is None


def test_what_is_no_covariance_of_the_model_is_refused(model, covariance, tmp_path):
    with pytest.raises(AbraceError, match=r"covariance of a model: shape \(18, 18\), expected \(21, 21\), finite"):
        draw_models(model, covariance[:18, :18], 1, 0)
    full = replace(model, a=A + np.array([[0, 0, 1.0], [0, 0, 0], [0, 0, 0]]))
    with pytest.raises(AbraceError, match="not continuous and in modal form, expected one of identify"):
        draw_models(full, covariance, 1, 0)
    path = tmp_path / "model.json"
    save_model(model, path, covariance)
    path.write_text(path.read_text().replace('"covariance": [\n  [', '"covariance": [\n  [1.0,'))
    with pytest.raises(AbraceError, match=r"model\.json: covariance: row 1 has 2 numbers, expected 1"):
        load_covariance(path)
