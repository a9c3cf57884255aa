"""Place recognition by descriptors at the revisits of a drive with truth, with the retrieval of a replay.

The drive is mapped without closing a loop, so that no descriptor influences its later queries, and every descriptor
gets the same submaps.
"""

import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.errors import EvaluationError
from slam.common.geometry import gravity_frame, invert
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.loop_closure.loop_closer import Outcome
from slam.object_map.submap import recent_submap
from slam.odometry.keyframe import Keyframe
from slam.place_recognition.retrieval import PlaceRetriever
from slam.system import Slam
from tools.console import progress_bar
from tools.lab.drives.true_drive import read_true_drive
from tools.lab.retrieval.labelled_map import RECALL_AT, rank_of


def measure_revisits(
    path: Path, descriptors: Sequence[str], config: Config, *, topics: Mapping[str, str] | None = None
) -> list[dict[str, Any]]:
    """Map a drive with truth, and ask each descriptor at its revisits.

    Args:
        path: the log.
        descriptors: names, as the registry has them.
        config: of the estimator; what it leaves open is estimated from the log.
        topics: kind -> topic, where the log leaves a choice.

    Returns:
        For each descriptor ``places_at_k``, the share of the ``queries`` with a right pose among the first k proposals,
        by k of :data:`RECALL_AT`; ``index_s``, the time to describe the map, and ``query_ms``, the median of a query.

    Raises:
        LogError: the log cannot be read.
        DescriptorError: a descriptor that does not fit the drive.
        SlamError: it cannot be mapped, holds no truth, or never comes back.
    """
    records, truth, config = read_true_drive(path, config, topics)
    with threadpool_limits(1), progress_bar(f"mapping {path.name}") as show_done:
        asking = _AskingSlam(config, truth, descriptors)
        for done, record in enumerate(records, start=1):
            asking.process(record)
            show_done(done / len(records))
    if not asking.answers:
        raise EvaluationError(f"{path}: the drive never revisits a place, so there is nothing to recognise")
    return [
        {
            "drive": path.stem,
            "descriptor": name,
            "queries": len(answers),
            **{f"places_at_{k}": (answers["rank"] < k).mean() for k in RECALL_AT},
            "query_ms": 1e3 * answers["seconds"].median(),
            "index_s": asking.index_s[name],
        }
        for name, answers in pd.DataFrame(asking.answers).groupby("descriptor", sort=False)
    ]


class _AskingSlam(Slam):
    """Maps a drive, and queries the descriptors at each keyframe instead of closing loops."""

    def __init__(self, config: Config, truth: PoseSeries, descriptors: Sequence[str]) -> None:
        super().__init__(config)
        self._truth = truth
        self._protocol = Protocol(revisit_m=config.closure_travel_m)
        self._asked_m = -np.inf
        # As many places are proposed as are counted.
        configs = {name: config.closing(descriptor=name, max_candidates=RECALL_AT[-1]) for name in descriptors}
        self._retrievers = {name: PlaceRetriever(each, self._object_map) for name, each in configs.items()}
        self.answers: list[dict[str, Any]] = []
        self.index_s = defaultdict[str, float](float)

    def _close_loops(self, keyframe: Keyframe) -> Outcome:
        for name, retriever in self._retrievers.items():
            started = time.perf_counter()
            retriever.index_inactive_landmarks(keyframe.odometry)
            self.index_s[name] += time.perf_counter() - started
        travelled_m = self._truth.travelled_at_m(np.array([keyframe.odometry.stamp_ns]))[0]
        if travelled_m - self._asked_m >= self._protocol.query_spacing_m:
            self._ask(keyframe, travelled_m)
        return Outcome([])

    def _ask(self, keyframe: Keyframe, travelled_m: float) -> None:
        T_local_query_gt = self._true_poses(keyframe)
        submap = recent_submap(self._object_map, keyframe, self._config.calibration)
        before_m = keyframe.odometry.travel_m - self._config.closure_travel_m
        still_associated = self._object_map.rows["first_seen_travel_m"][submap.rows] < before_m
        # Where most landmarks were never lost there is nothing to recognise.
        if not len(T_local_query_gt) or 2 * np.count_nonzero(still_associated) > len(submap):
            return
        self._asked_m = travelled_m
        for name, retriever in self._retrievers.items():
            started = time.perf_counter()
            places = retriever.propose(submap, before_m=before_m)
            seconds = time.perf_counter() - started
            poses = np.array([place.T_local_query for place in places]).reshape(-1, 4, 4)
            rank = rank_of(poses, T_local_query_gt)
            self.answers.append({"descriptor": name, "rank": rank, "seconds": seconds})

    def _true_poses(self, keyframe: Keyframe) -> FloatArray:
        """Poses (R, 4, 4) of the query in the local frame, by the earlier keyframes that it truly comes back to."""
        keyframes = self._mapper.keyframes
        stamps_ns = np.array([each.odometry.stamp_ns for each in keyframes], dtype=np.int64)
        T_world_body = self._truth.poses_at(stamps_ns)
        travelled_m = self._truth.travelled_at_m(stamps_ns)
        apart_m = np.linalg.norm(T_world_body[:, :3, 3] - T_world_body[-1, :3, 3], axis=1)
        near = apart_m <= self._protocol.revisit_distance_m
        near &= travelled_m <= travelled_m[-1] - self._protocol.revisit_m
        T_local_body = np.array([keyframes[row].T_local_body for row in np.flatnonzero(near)]).reshape(-1, 4, 4)
        return gravity_frame(T_local_body @ invert(T_world_body[near]) @ T_world_body[-1])
