from __future__ import annotations

import numpy as np
import pytest

from thermacq_drivers.simflume.three_d_noise import noise_components


def test_estimator_is_unbiased_where_the_plain_one_is_not() -> None:
    random = np.random.default_rng(3)
    found = []
    for _ in range(200):
        cube = random.standard_normal((12, 8, 10)) + 0.3 * random.standard_normal((12, 1, 10))
        found.append(noise_components(cube + 5000))
    assert np.mean([each.tvh for each in found]) == pytest.approx(1.0, rel=0.01)
    assert np.mean([each.th for each in found]) == pytest.approx(0.09, rel=0.1)
    for component in ("t", "v", "h", "tv", "vh"):
        assert abs(np.mean([getattr(each, component) for each in found])) < 0.005, component
