"""The first streets of a generated town as a map of labelled objects."""

import numpy as np

from slam.common.arrays import FloatArray
from tests.helpers.driven_maps import town
from tools.lab.retrieval.labelled_map import LabelledMap, labelled_map


def start_of_street(length_m: float) -> tuple[LabelledMap, FloatArray]:
    """The objects within 30 m of the first part of the tour, and that part."""
    world = town(4).shortened(length_m)
    objects = labelled_map(world)
    near = np.flatnonzero(np.min([np.hypot(*(objects.positions[:, :2] - p).T) for p in world.tour], axis=0) < 30.0)
    return LabelledMap(objects.positions[near], objects.labels[near], objects.vocabulary), world.tour
