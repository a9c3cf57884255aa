"""Writes made-up drives of many kinds of robots as text files: ``python docs/robot_kinds.py FOLDER [NAME ...]``.

``dslam benchmark robots FOLDER`` maps them. The seed of a drive is its name.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
START_S = 1.6e9
POSE_ROW = "{:.6f} {:.5f} {:.5f} {:.5f} {:.8f} {:.8f} {:.8f} {:.8f}\n"


@dataclass(frozen=True)
class Kind:
    """``objects`` (N, 3) m and their ``labels``; the ``way`` (K, 2 or 3) m, driven at ``speed`` [m/s] with corners
    rounded over ``corner`` [m]; ``odometry_hz``, its noise ``translation`` [m/sqrt(m)], ``heading`` [rad/sqrt(m)] and
    ``by_turn`` [rad/sqrt(rad)]; of the sensor the range [m], rate, field of view, noise along the ray [m], by the range
    and by its square, of the bearing [rad], probability of detection and false objects a scan. ``swing``: roll and
    pitch [rad]; ``turned``: the body against its way [rad], and how fast it spins [rad/s]; ``every``: one scan in so
    many is kept; ``tracked``: positions are in the frame of the odometry, which nobody says.
    """

    objects: Array
    labels: Sequence[str]
    way: Array
    speed: float = 3.0
    corner: float = 8.0
    odometry_hz: float = 10.0
    translation: float = 0.05
    heading: float = 0.006
    by_turn: float = 0.02
    range_m: float = 25.0
    scan_hz: float = 5.0
    field_deg: float = 360.0
    along: float = 0.1
    by_range: float = 0.0
    by_square: float = 0.0
    bearing: float = 0.01
    detected: float = 0.9
    false: float = 0.0
    swing: float = 0.0
    turned: float = 0.0
    spin: float = 0.0
    every: int = 1
    tracked: bool = False


def scattered(rng: np.random.Generator, count: int, width: float, height: float, top: float = 0.0) -> Array:
    """Objects (N, 3) m, evenly over an area up to some height."""
    return np.asarray(rng.uniform((0.0, 0.0, 0.0), (width, height, top), (count, 3)))


def classes(objects: Array, count: int) -> list[str]:
    """A class for each object, in turns."""
    return [f"class_{number % count}" for number in range(len(objects))]


def rounds(width: float, height: float, margin: float, count: int = 3) -> Array:
    """Corners (K, 2) m of rounds in a rectangle, at some distance from its sides."""
    corners = [(margin, margin), (width - margin, margin), (width - margin, height - margin), (margin, height - margin)]
    return np.array([*corners * count, corners[0]])


def park(rng: np.random.Generator) -> Kind:
    """A robot on a loop among scattered objects, which other kinds vary."""
    objects = scattered(rng, 120, 100.0, 80.0)
    return Kind(objects, classes(objects, 4), rounds(100.0, 80.0, 15.0))


def office(rng: np.random.Generator) -> Kind:
    """A robot with a camera for tags, each of a class of its own, in one room."""
    objects = scattered(rng, 20, 10.0, 8.0, 2.0)
    return Kind(objects, classes(objects, 20), rounds(10.0, 8.0, 1.5, 6), speed=0.4, corner=1.5, odometry_hz=20.0,
                translation=0.02, heading=0.03, by_turn=0.05, range_m=4.0, scan_hz=2.0, along=0.03)  # fmt: skip


def orchard(rng: np.random.Generator) -> Kind:
    """Rows of trees of one class, lane by lane, then across."""
    places = [(x, 4.0 * row) for row in range(10) for x in np.arange(0.0, 80.0, 3.0) if rng.random() < 0.93]
    objects = np.pad(np.array(places) + rng.normal(scale=0.15, size=(len(places), 2)), ((0, 0), (0, 1)))
    lanes = [[(-4.0, y), (84.0, y)][:: 1 if number % 2 == 0 else -1] for number, y in enumerate(np.arange(2, 38, 4))]
    way = [*(point for lane in lanes for point in lane), (-4, 34), (-4, 2), (84, 2), (84, 6), (-4, 6)]
    return Kind(objects, classes(objects, 1), np.array(way), speed=1.2, corner=2.0, translation=0.03, by_turn=0.03,
                range_m=8.0, along=0.05)  # fmt: skip


def motorway(rng: np.random.Generator) -> Kind:
    """A car at 35 m/s on a ring, two and a half rounds."""
    angles = np.repeat(np.arange(0.0, 2.0 * np.pi, 40.0 / 600.0), 2) + rng.normal(scale=0.01, size=190)
    radii = 600.0 + np.tile([-12.0, 12.0], 95) + rng.normal(size=190)
    objects = np.column_stack([radii * np.cos(angles), radii * np.sin(angles), rng.uniform(0.0, 4.0, 190)])
    turns = np.linspace(0.0, 4.8 * np.pi, 960)
    way = 600.0 * np.column_stack([np.cos(turns), np.sin(turns)])
    return Kind(objects, [f"class_{k}" for k in rng.integers(4, size=190)], way, speed=35.0, corner=30.0,
                odometry_hz=20.0, translation=0.03, heading=0.0005, by_turn=0.005, range_m=80.0, scan_hz=10.0,
                field_deg=120.0, along=0.2, bearing=0.005)  # fmt: skip


def drone(rng: np.random.Generator) -> Kind:
    """Rolls and pitches by 20 deg, between 1 and 9 m above ground."""
    objects, way = scattered(rng, 80, 60.0, 60.0, 15.0), rounds(60.0, 60.0, 10.0)
    heights = 5.0 + 4.0 * np.sin(1.3 * np.arange(len(way)))
    return Kind(objects, classes(objects, 5), np.column_stack([way, heights]), odometry_hz=50.0, translation=0.03,
                heading=0.005, range_m=20.0, swing=0.35)  # fmt: skip


def floors(rng: np.random.Generator) -> Kind:
    """Two floors, one above the other, and down again."""
    upstairs = np.array([0.0, 0.0, 4.0])
    objects = np.concatenate([scattered(rng, 40, 30.0, 20.0, 2.0), scattered(rng, 40, 30.0, 20.0, 2.0) + upstairs])
    ring = np.pad(rounds(30.0, 20.0, 3.0, 2), ((0, 0), (0, 1)))
    up = np.array([(15.0, 3.0, 0.0), (15.0, 10.0, 4.0), (15.0, 3.0, 4.0)])
    way = np.concatenate([ring, up, ring + upstairs, up[::-1], ring])
    return Kind(objects, classes(objects, 4), way, speed=1.0, corner=2.0, odometry_hz=20.0, translation=0.03,
                heading=0.02, range_m=6.0, along=0.03)  # fmt: skip


def spiral(rng: np.random.Generator) -> Kind:
    """Arms 6 m apart, no round is driven twice."""
    objects, turns = scattered(rng, 200, 110.0, 110.0) - [55.0, 55.0, 0.0], np.linspace(0.0, 14.0 * np.pi, 3000)
    way = (3.0 + turns)[:, None] * np.column_stack([np.cos(turns), np.sin(turns)])
    return Kind(objects, classes(objects, 2), way, speed=1.5, corner=3.0, range_m=10.0, along=0.03)


def eight(rng: np.random.Generator) -> Kind:
    """A figure eight, two rounds, with 120 deg of view."""
    objects, turns = scattered(rng, 90, 140.0, 80.0) - [70.0, 40.0, 0.0], np.linspace(0.0, 8.0 * np.pi, 2000)
    way = np.column_stack([60.0 * np.sin(turns), 30.0 * np.sin(2.0 * turns)])
    return Kind(objects, classes(objects, 4), way, corner=3.0, heading=0.008, range_m=15.0, field_deg=120.0)


KINDS: dict[str, Callable[[np.random.Generator], Kind]] = {
    "park": park,
    "office, tags": office,
    "office, one class": lambda rng: (kind := office(rng)) and replace(kind, labels=classes(kind.objects, 1)),
    "orchard": orchard,
    "motorway": motorway,
    "drone": drone,
    "two floors": floors,
    "spiral": spiral,
    "figure eight": eight,
    "slow, 0.05 m per s": lambda rng: replace(office(rng), speed=0.05, way=rounds(10.0, 8.0, 1.5, 2)),
    "backwards": lambda rng: replace(park(rng), turned=np.pi),
    "sideways": lambda rng: replace(park(rng), turned=0.5),
    "spinning": lambda rng: replace(park(rng), spin=0.7),
    "stereo camera": lambda rng: replace(park(rng), field_deg=60.0, along=0.02, by_square=0.004, bearing=0.003),
    "radar": lambda rng: replace(park(rng), field_deg=120.0, bearing=0.07),
    "one camera": lambda rng: replace(park(rng), field_deg=90.0, along=0.0, by_range=0.2, bearing=0.004),
    "two thirds false": lambda rng: replace(park(rng), false=45.0),
    "one scan in ten": lambda rng: replace(park(rng), scan_hz=10.0, every=10),
    "detects one in four": lambda rng: replace(park(rng), detected=0.25),
    "odometry at 1 Hz": lambda rng: replace(park(rng), odometry_hz=1.0),
    "tracker": lambda rng: replace(park(rng), tracked=True),
}


def drive(kind: Kind) -> tuple[Array, Array, Rotation]:
    """Times (T,) s, positions (T, 3) m and orientations of the body."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(kind.way[:, :2], axis=0), axis=1))])
    at = np.arange(0.0, along[-1], kind.speed / kind.odometry_hz)
    points = np.stack([np.interp(at, along, column) for column in kind.way.T], axis=1)
    width = max(int(kind.corner / kind.speed * kind.odometry_hz), 1)
    window = np.hanning(width + 2)[1:-1]
    padded = np.pad(points, ((width, width), (0, 0)), mode="edge")
    smooth = [np.convolve(column, window / window.sum(), "same")[width:-width] for column in padded.T]
    positions = np.zeros((len(at), 3))
    positions[:, : len(smooth)] = np.stack(smooth, axis=1)
    times = np.arange(len(at)) / kind.odometry_hz
    heading = np.unwrap(np.arctan2(np.gradient(smooth[1]), np.gradient(smooth[0]))) + kind.turned + kind.spin * times
    tilts = kind.swing * np.stack([0.75 * np.sin(0.9 * times), np.sin(0.7 * times + 1.0)], axis=1)
    return times, positions, Rotation.from_euler("ZYX", np.column_stack([heading, tilts]))


def odometry(kind: Kind, rng: np.random.Generator, positions: Array, body: Rotation) -> tuple[Array, Rotation]:
    """The same by the odometry: steps with errors, summed up."""
    steps, turns = body[:-1].inv().apply(np.diff(positions, axis=0)), body[:-1].inv() * body[1:]
    length, turn = np.linalg.norm(steps, axis=1), turns.magnitude()
    steps = steps + rng.normal(size=steps.shape) * (kind.translation * np.sqrt(length))[:, None] * [1.0, 1.0, 0.0]
    errors = rng.normal(size=len(turn)) * np.sqrt(kind.heading**2 * length + kind.by_turn**2 * turn)
    found, poses = positions[:1].tolist(), [body[0]]
    for step, change in zip(steps, turns * Rotation.from_euler("z", errors[:, None]), strict=True):
        found.append(found[-1] + poses[-1].apply(step))
        poses.append(poses[-1] * change)
    return np.array(found), Rotation.concatenate(poses)


def detections(
    kind: Kind, rng: np.random.Generator, times: Array, positions: Array, body: Rotation
) -> list[tuple[int, Array, str, str]]:
    """Of each its scan, position (3,) m in the body frame, label and true object, empty where it is false."""
    found, half = list[tuple[int, Array, str, str]](), np.deg2rad(0.5 * kind.field_deg)
    names = sorted(set(kind.labels))
    step = kind.every * kind.odometry_hz / kind.scan_hz
    for scan in np.unique(np.arange(0, len(times), max(step, 1.0)).astype(int)).tolist():
        seen = body[scan].inv().apply(kind.objects - positions[scan])
        distances, angles = np.linalg.norm(seen, axis=1), np.arctan2(seen[:, 1], seen[:, 0])
        in_view = (distances < kind.range_m) & (np.abs(angles) < half) & (rng.random(len(seen)) < kind.detected)
        for row in np.flatnonzero(in_view).tolist():
            r = distances[row]
            sigma = kind.along + kind.by_range * r + kind.by_square * r**2
            turned = Rotation.from_euler("z", kind.bearing * rng.normal()).apply(seen[row])
            found.append((scan, turned * max(1.0 + sigma / r * rng.normal(), 0.1), kind.labels[row], f"object_{row}"))
        for _ in range(rng.poisson(kind.false)):
            r, angle = kind.range_m * np.sqrt(rng.random()), half * rng.uniform(-1.0, 1.0)
            at = np.array([r * np.cos(angle), r * np.sin(angle), 0.0])
            found.append((scan, at, names[rng.integers(len(names))], ""))
    return found


def write(folder: Path, name: str) -> None:
    """The three text files of one kind."""
    rng = np.random.default_rng(list(name.encode()))
    kind = KINDS[name](rng)
    times, positions, body = drive(kind)
    by_odometry, turned = odometry(kind, rng, positions, body)
    folder.mkdir(parents=True, exist_ok=True)
    for file, at, orientations in (("groundtruth", positions, body), ("odometry", by_odometry, turned)):
        rows = np.column_stack([START_S + times, at, orientations.as_quat()])
        (folder / f"{file}.tum").write_text("".join(POSE_ROW.format(*row) for row in rows), encoding="utf-8")
    lines = ["stamp_s,x_m,y_m,z_m,label,object_id\n"]
    for scan, seen, label, identity in detections(kind, rng, times, positions, body):
        x, y, z = turned[scan].apply(seen) + by_odometry[scan] if kind.tracked else seen
        lines.append(f"{START_S + times[scan]:.6f},{x:.4f},{y:.4f},{z:.4f},{label},{identity}\n")
    (folder / "detections.csv").write_text("".join(lines), encoding="utf-8")


if __name__ == "__main__":
    for kind_name in sys.argv[2:] or KINDS:
        write(Path(sys.argv[1]) / kind_name.replace(", ", "_").replace(" ", "_"), kind_name)
