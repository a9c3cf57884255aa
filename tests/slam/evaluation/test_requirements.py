import pytest

from slam.common.errors import EvaluationError
from slam.evaluation.requirements import check_requirement, parse_requirement

RESULTS = {"trajectory": {"ate_m": 4.0, "online_ate_m": None, "note": "text"}, "counters": {"keyframes": 12},
           "unavailable": {"closures": "no candidate"}}  # fmt: skip


@pytest.mark.parametrize(
    ("text", "requirement"),
    [
        ("trajectory.ate_m<=4.0", ("trajectory.ate_m", "<=", 4.0)),
        (" a.b >= 1e-3 ", ("a.b", ">=", 1e-3)),
        ("a<-1", ("a", "<", -1.0)),
        ("a==0", ("a", "==", 0.0)),
    ],
)
def test_parsing(text: str, requirement: tuple[str, str, float]) -> None:
    assert parse_requirement(text) == requirement


@pytest.mark.parametrize("text", ["", "a", "a<", "<4", "a=4", "a<=nan", "a<=inf", "a<=b", "a<=4 m", "a!=4"])
def test_what_is_no_requirement(text: str) -> None:
    with pytest.raises(EvaluationError, match="expected for example"):
        parse_requirement(text)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("trajectory.ate_m<=4", ""),
        ("trajectory.ate_m>=4", ""),
        ("trajectory.ate_m==4", ""),
        ("counters.keyframes>11", ""),
        ("trajectory.ate_m<4", "trajectory.ate_m is 4, where < 4 was required"),
        ("trajectory.ate_m>4", "trajectory.ate_m is 4, where > 4 was required"),
        ("trajectory.online_ate_m<=4", "online_ate_m is undefined, where"),
        ("closures.recall>=1", "closures.recall is undefined (no candidate), where"),
        ("trajectory.ate<=4", "did you mean trajectory.ate_m?"),
        ("trajectory.note<=4", "undefined"),
        ("trajectory<=4", "undefined"),
    ],
)
def test_bars_are_met_or_told(text: str, told: str) -> None:
    is_met, found = check_requirement(text, RESULTS)
    assert is_met == (not told)
    assert told in found
