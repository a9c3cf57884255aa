import numpy as np

from logs.importers.maps.map_objects import MapObjects
from tests.tools.lab.retrieval.test_path_queries import forest
from tools.lab.retrieval.contest import run_contest


def town(count: int, extent_m: float) -> MapObjects:
    """Objects of six classes, the first as frequent as all others together."""
    labels = np.random.default_rng(1).choice(6, count, p=[0.5, 0.1, 0.1, 0.1, 0.1, 0.1])
    names = tuple(str(row) for row in range(count))
    return MapObjects("town", forest(count, extent_m), tuple(f"class {label}" for label in labels), names, False, "")


def test_descriptors_find_more_places_than_chance_in_each_map() -> None:
    proposers = ("descriptellation_lr", "gosmatch_vertex", "random")
    cells = run_contest(town(1500, 700.0), proposers, sizes=(400, 1000), classes=(4,), queries=4)
    assert cells["proposer"].tolist() == list(proposers) * 2
    assert set(cells["map_classes"]) == {4}
    assert cells["map_objects"].tolist() == [400] * 3 + [1000] * 3
    by_proposer = cells.set_index("proposer")
    chance = by_proposer.loc["random", "at_1"].to_numpy()
    for name in proposers[:2]:
        assert (by_proposer.loc[name, "at_1"].to_numpy() > chance).all()
    assert (cells["at_1"] <= cells["at_5"]).all()
    assert (cells["at_5"] <= cells["at_25"]).all()
    assert (cells["wrong"] == 0.0).all()
    assert cells["right"].iloc[0] == 1.0
    assert (cells[["bytes_per_object", "build_s", "propose_ms"]] > 0.0).all(axis=None)


def test_the_same_paths_are_asked_with_any_classes() -> None:
    alone, after_another = (
        run_contest(town(600, 400.0), ("descriptellation_lr",), sizes=(600,), classes=classes, queries=3).iloc[-1]
        for classes in ((6,), (1, 6))
    )
    same = ["map_classes", "at_1", "right"]
    assert alone[same].tolist() == after_another[same].tolist()
