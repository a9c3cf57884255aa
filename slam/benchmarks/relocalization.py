"""How soon a robot finds out where it is in a saved map, and whether it is right: it is carried off to random places.

``benchmark_relocalization`` is where to begin reading.
"""

from __future__ import annotations

import multiprocessing
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from logs.messages import GroundTruthPose, LoopClosureRecord, ObjectDetections, Odometry, SlamPose
from slam.benchmarks.kidnaps import Kidnap, change_world, draw_kidnaps, worsen
from slam.benchmarks.relocalization_figures import (
    HOLDS_FOR_M,
    Outcome,
    RelocalizationBenchmark,
    Verdict,
    deviation,
    is_right,
    judge,
    sum_up,
)
from slam.config import Config
from slam.evaluation.alignment import align_path
from slam.evaluation.trajectory import compute_absolute_error
from slam.geometry import FloatArray, IntArray, invert, travelled_m
from slam.saved_map import SavedMap, confirmed
from slam.simulation.config import SimulationConfig
from slam.simulation.simulation import SimulatedRecord, simulate
from slam.simulation.world import World
from slam.system import Slam, State


@dataclass(frozen=True, slots=True, eq=False)
class KnownMap:
    """A map that one drive made, of which ``T_map_body`` and ``T_world_body_gt`` (K, 4, 4) are the poses.

    ``T_world_map`` (4, 4) lays the whole drive on the truth, from which it then is ``ate_m`` away (rmse).
    """

    saved: SavedMap
    T_map_body: FloatArray
    T_world_body_gt: FloatArray
    T_world_map: FloatArray
    ate_m: float

    def to_world(self, T_map_body: FloatArray) -> FloatArray:
        """Where a pose (4, 4) in the map is, by the whole drive."""
        return self.T_world_map @ T_map_body

    def to_world_nearby(self, T_map_body: FloatArray, T_world_near: FloatArray) -> FloatArray:
        """The same by the pose of the drive that came nearest to a place: without the distortion of the map."""
        offsets = self.T_world_body_gt[:, :2, 3] - T_world_near[:2, 3]
        row = int(np.argmin(np.einsum("ij,ij->i", offsets, offsets)))
        return np.asarray(self.T_world_body_gt[row] @ invert(self.T_map_body[row]) @ T_map_body)


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """Where the robot is carried off: the map, the world as it is now, and how both are seen."""

    known: KnownMap
    world: World
    config: Config
    simulation: SimulationConfig
    first_seed: int


def benchmark_relocalization(
    world: World,
    config: Config,
    *,
    kidnaps: int,
    seed: int = 0,
    noise: float = 1.0,
    changed: float = 0.0,
    max_travel_m: float = 60.0,
    jobs: int = 1,
    on_progress: Callable[[float], None] | None = None,
) -> RelocalizationBenchmark:
    """Map the tour of ``world`` once, and then be put down somewhere on it again and again.

    The same arguments give the same places, drives and verdicts, whatever ``jobs`` is; only times differ.

    Args:
        world: with a tour.
        config: of the estimator, for the map and for the search.
        kidnaps: how often.
        seed: of the drive that makes the map, of the places and of what changes; the drives after that follow from it.
        noise: factor on the errors of the sensor that searches.
        changed: share of the objects near the tour that are others by then.
        max_travel_m: length of each search.
        jobs: processes that search at a time.
        on_progress: called with the fraction done, in [0, 1].

    Raises:
        SlamError: the world cannot be driven or mapped, or a number is out of range.
    """
    simulation = SimulationConfig()
    worse = simulation.model_copy(update={"sensor": worsen(simulation.sensor, noise)})
    rng = np.random.default_rng([seed, 1])
    places = draw_kidnaps(world.tour, count=kidnaps, length_m=max_travel_m, rng=rng)
    now = change_world(world, changed, reach_m=simulation.sensor.max_range_m, rng=np.random.default_rng([seed, 2]))
    with threadpool_limits(1):
        known = map_tour(world, config, simulation, seed=seed)
    outcomes = list[Outcome]()
    for outcome in search_all(Search(known, now, config, worse, seed + 1), places, jobs=jobs):
        outcomes.append(outcome)
        if on_progress is not None:
            on_progress(len(outcomes) / len(places))
    return sum_up(
        outcomes,
        world=world.name,
        tour_m=world.tour_length_m,
        landmarks=len(known.saved.objects.ids),
        map_ate_m=known.ate_m,
    )


def map_tour(world: World, config: Config, simulation: SimulationConfig, *, seed: int) -> KnownMap:
    """The map that a simulated drive along the tour leaves behind.

    Raises:
        SlamError: it cannot be driven or mapped.
    """
    slam = Slam(config)
    records = [record for _, _, record in simulate(world, simulation, seed=seed)]
    for record in _perceived(records):
        slam.process(record)
    final = slam.finish()
    stamps_ns, T_world_body = _truth(records)
    estimate = final.trajectory.T_map_body
    truth = T_world_body[np.searchsorted(stamps_ns, final.trajectory.stamps_ns)]
    alignment = align_path(estimate[:, :3, 3], truth[:, :3, 3])
    return KnownMap(
        saved=SavedMap(confirmed(final.object_map), final.graph),
        T_map_body=estimate,
        T_world_body_gt=truth,
        T_world_map=alignment.T_world_map,
        ate_m=compute_absolute_error(estimate[:, :3, 3], truth[:, :3, 3], alignment).rmse_m,
    )


def search_all(search: Search, kidnaps: list[Kidnap], *, jobs: int) -> Iterator[Outcome]:
    """The outcome of each kidnapping, in their order, on one thread a process."""
    if jobs == 1:
        with threadpool_limits(1):
            yield from (relocalize(search, kidnap) for kidnap in kidnaps)
        return
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(kidnaps)), spawn, _begin, (search,)) as processes:
        yield from processes.map(_relocalize, kidnaps)


def relocalize(search: Search, kidnap: Kidnap) -> Outcome:
    """Put the robot down, let it drive until it believes to know where it is, and 10 m more."""
    piece = replace(search.world, tour=kidnap.tour)
    records = [record for _, _, record in simulate(piece, search.simulation, seed=search.first_seed + kidnap.number)]
    stamps_ns, T_world_body = _truth(records)
    travel_m = dict(zip(stamps_ns.tolist(), travelled_m(T_world_body).tolist(), strict=True))
    tried = _drive(search, records, travel_m)
    fix = tried.fix

    def truth_of(pose: SlamPose) -> FloatArray:
        return np.asarray(T_world_body[np.searchsorted(stamps_ns, pose.stamp_ns)])

    def errors(pose: SlamPose) -> tuple[float, float]:
        return deviation(search.known.to_world(pose.T_map_body), truth_of(pose))

    def local_errors(pose: SlamPose) -> tuple[float, float]:
        truth = truth_of(pose)
        return deviation(search.known.to_world_nearby(pose.T_map_body, truth), truth)

    best = max(tried.refusals, key=lambda each: each.score, default=None)
    error_m, error_deg = errors(fix) if fix else (None, None)
    local_error_m, local_error_deg = local_errors(fix) if fix else (None, None)
    return Outcome(
        number=kidnap.number,
        start_m=kidnap.start_m,
        is_along=kidnap.is_along,
        objects=_objects_in_range(search, T_world_body[0]),
        verdict=judge(travel_m[fix.stamp_ns], errors(fix)) if fix else Verdict.NOT_FOUND,
        distance_m=travel_m[fix.stamp_ns] if fix else None,
        seconds=1e-9 * (fix.stamp_ns - records[0].stamp_ns) if fix else None,
        error_m=error_m,
        error_deg=error_deg,
        local_error_m=local_error_m,
        local_error_deg=local_error_deg,
        later_right=is_right(*errors(tried.last)) if tried.last else None,
        refusals=dict(sorted(Counter(each.stage for each in tried.refusals).items())),
        best_refusal=f"{best.stage}: {best.reason}" if best else "",
        load_s=tried.load_s,
        query_ms=tried.query_ms,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """``fix``: the first pose in the map; ``last``: the one believed at the end; None if the robot is lost."""

    fix: SlamPose | None
    last: SlamPose | None
    refusals: list[LoopClosureRecord]
    load_s: float
    query_ms: tuple[float, ...]


def _drive(search: Search, records: list[SimulatedRecord], travel_m: dict[int, float]) -> _Trial:
    """Search for the place of a drive whose true travel is known by stamp."""
    started = time.perf_counter()
    slam = Slam(search.config, search.known.saved, extend=False)
    load_s = time.perf_counter() - started
    fix: SlamPose | None = None
    last: SlamPose | None = None
    refusals: list[LoopClosureRecord] = []
    query_s: list[float] = []
    for record in _perceived(records):
        if fix is not None and travel_m[record.stamp_ns] > travel_m[fix.stamp_ns] + HOLDS_FOR_M:
            break
        updates = slam.process(record)
        last = next((each for each in reversed(updates) if isinstance(each, SlamPose)), last)
        if fix is None:
            fix = last
            query_s = list(slam.closing_seconds)
            refusals += [each for each in updates if isinstance(each, LoopClosureRecord) and not each.accepted]
    # The first search enters the whole map into the index of places before it begins.
    return _Trial(
        fix,
        last if slam.state != State.LOST else None,
        refusals,
        load_s + sum(query_s[:1]),
        tuple(1e3 * seconds for seconds in query_s[1:]),
    )


def _perceived(records: list[SimulatedRecord]) -> Iterator[Odometry | ObjectDetections]:
    return (record for record in records if isinstance(record, Odometry | ObjectDetections))


def _truth(records: list[SimulatedRecord]) -> tuple[IntArray, FloatArray]:
    """Stamps (K,) and ``T_world_body`` (K, 4, 4)."""
    poses = [record for record in records if isinstance(record, GroundTruthPose)]
    return np.array([pose.stamp_ns for pose in poses]), np.stack([pose.T_world_body for pose in poses])


def _objects_in_range(search: Search, T_world_body: FloatArray) -> int:
    offsets = search.world.positions[:, :2] - T_world_body[:2, 3]
    return int(np.count_nonzero(np.hypot(*offsets.T) <= search.simulation.sensor.max_range_m))


_searches: list[Search] = []
"""Of a process of its own: what is the same for all kidnappings travels to it only once."""


def _begin(search: Search) -> None:
    threadpool_limits(1)
    _searches.append(search)


def _relocalize(kidnap: Kidnap) -> Outcome:
    return relocalize(_searches[-1], kidnap)
