"""What the tests of the command line share."""

import contextlib
import io
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from logs.messages import Odometry, Transform
from logs.writer import LogWriter
from tests.helpers.landmarks import detections_of
from tests.helpers.poses import pose_at
from tools import cli

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "logs" / "samples" / "short_drive.mcap"


@dataclass(frozen=True)
class Result:
    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)

    @property
    def text(self) -> str:
        """What was printed, on one line."""
        return " ".join(self.out.split())


Run = Callable[..., Result]


def run_well(*arguments: object) -> str:
    """What the command line prints in this process, where it must end well."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        code = cli.run([str(argument) for argument in arguments])
    assert code == 0, arguments
    return out.getvalue()


def run_python(*arguments: object, folder: Path = ROOT) -> Result:
    """What another interpreter says that is started in ``folder``."""
    done = subprocess.run([sys.executable, *map(str, arguments)], cwd=folder, capture_output=True, text=True)
    return Result(done.returncode, done.stdout, done.stderr)


def loaded_by(code: str, modules: str) -> str:
    """Those of some modules that another interpreter has loaded after ``code``."""
    told = f"print(*(name for name in {modules.split()!r} if name in sys.modules))"
    return run_python("-c", f"import sys; {code}; {told}").out.splitlines()[-1]


def text_of(path: Path | str) -> str:
    """What stands in a file of the repository, or in any."""
    return (ROOT / path).read_text(encoding="utf-8")


def assert_well(result: Result) -> Result:
    """It ended with nothing on standard error."""
    assert (result.code, result.err) == (0, "")
    return result


def assert_refused(result: Result, *told: str, code: int = 2) -> None:
    """One line on standard error that tells ``told``, and nothing on standard output."""
    assert result.code == code
    assert result.out == ""
    assert result.err.startswith("dslam: ")
    assert result.err.endswith("\n")
    assert result.err.count("\n") == 1
    for text in told:
        assert text in result.err


def write_drive(
    path: Path,
    *,
    odometry: tuple[str, ...] = ("/odom",),
    detections: tuple[str, ...] = ("/objects",),
    transforms: tuple[Transform, ...] = (),
    delay_ns: int = 0,
    **changed: Any,
) -> Path:
    """Three seconds on which a tree is passed; of its scans the stamps are late, and other fields ``changed``."""
    with LogWriter(path) as writer:
        for transform in transforms:
            writer.write("/tf_static", transform)
        for stamp_ns in range(0, 3 * 10**9, 10**8):
            x_m = 1e-9 * stamp_ns
            for topic in odometry:
                writer.write(topic, Odometry(stamp_ns, pose_at(x_m)))
            scan = detections_of([5.0 - x_m, 2.0, 1.0], stamp_ns=stamp_ns + delay_ns, frame_id="base_link")
            for topic in detections:
                writer.write(topic, replace(scan, **changed), stamp_ns)
    return path
