"""A drive in text files that a test may damage: five poses, 1 m and 0.1 s apart, and three scans."""

import gzip
from dataclasses import dataclass
from pathlib import Path

TUM = "# stamp x y z qx qy qz qw\n" + "".join(f"{100 + 0.1 * i:.3f} {i} 0 0 0 0 0 1\n" for i in range(5))
DETECTIONS = """stamp_s,label,x_m,y_m,z_m,object_id
100.000,pole,1,2,3,7
100.000,tree,4,5,6,
100.100,pole,0,2,3,7
100.400,pole,-3,2,3,7
"""


@dataclass(frozen=True)
class TextDrive:
    """The files of the drive, below ``root``."""

    root: Path

    @staticmethod
    def make(root: Path) -> "TextDrive":
        drive = TextDrive(root)
        drive.write("odometry.tum", TUM)
        drive.write("truth.tum", TUM)
        drive.write("detections.csv", DETECTIONS)
        return drive

    @property
    def output(self) -> Path:
        return self.root / "out.mcap"

    def write(self, name: str, text: str) -> Path:
        path = self.root / name
        path.write_bytes(gzip.compress(text.encode()) if name.endswith(".gz") else text.encode())
        return path

    def files(self, **changed: str | None) -> dict[str, Path]:
        """Role -> path; ``changed`` names other files, or None for no file."""
        names = {"odometry": "odometry.tum", "detections": "detections.csv", "ground_truth": "truth.tum", **changed}
        return {role: self.root / name for role, name in names.items() if name is not None}
