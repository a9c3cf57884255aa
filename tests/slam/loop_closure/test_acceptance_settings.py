"""How many settings decide whether a loop closure is accepted."""

import ast
from pathlib import Path

import slam
from slam.common.calibration import ObjectCalibration
from slam.common.config import LocalizationConfig, LoopClosureConfig

MODULES = ("loop_closure/acceptance.py", "loop_closure/likelihood_ratio.py", "loop_closure/verification.py")
"""All that computes the posterior probability of a candidate."""
BRANCHES = (LocalizationConfig, LoopClosureConfig, ObjectCalibration)
MOST = 12


def test_few_settings_decide_whether_a_closure_is_accepted():
    known = {name for branch in BRANCHES for name in branch.__annotations__}
    known.add("failure_probability")  # by failures_per_km
    read = set[str]()
    for module in MODULES:
        tree = ast.parse((Path(slam.__file__).parent / module).read_text())
        read |= {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)} & known
    assert {"error_probability", "failure_probability", "landmark_sigma_m"} <= read
    assert len(read) <= MOST
