from __future__ import annotations

import numpy as np

from slam.fleet.passes import find_passes
from tests.slam.fleet.parts import street_part


def test_find_passes_measures_distances_from_the_path_and_beyond_its_ends() -> None:
    positions = np.array([[50.0, 5.0, 0.0], [37.0, -8.0, 1.0], [-3.0, 4.0, 0.0], [101.0, 8.0, 0.0]])
    seen = np.array([[True, False], [True, True], [False, False], [False, True]])
    passes = find_passes(street_part(positions, ["tree"] * 4, seen))
    np.testing.assert_array_equal(passes.seen, seen)
    np.testing.assert_allclose(passes.distances_m, np.repeat([[5.0], [8.0], [5.0], [10.0]], 2, axis=1))
