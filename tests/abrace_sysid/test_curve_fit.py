# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_sysid.fitting.curve_fit import require_stable, uncertainty_weights


def test_weights_follow_the_noise_and_are_bounded_where_there_is_none():
    g = np.array([100.0 + 0j, 1.0, 0.0])
    assert np.allclose(uncertainty_weights(g, np.array([0.0, 1.0, 1.0])), [1.0, 1 / 1.0001, 1.0])
    assert np.isfinite(uncertainty_weights(np.zeros(1, complex), np.zeros(1))).all()


def test_unstable_poles_are_named():
    with pytest.raises(AbraceError, match=r"table test: unstable poles \+0\.02\+7\.3i rad/s, expected stable"):
        require_stable(np.array([0.02 + 7.3j, 0.02 - 7.3j, -1 + 5j, -1 - 5j]), "table test")
    stable = np.array([-1 + 5j, -1 - 5j])
    assert require_stable(stable, "table test") is stable
