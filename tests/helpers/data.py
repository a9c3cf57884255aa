"""Real data, which lie beside the repository or where DSLAM_DATA says; tests that need them are skipped without."""

import os
from pathlib import Path

import pytest

DATA = Path(os.environ.get("DSLAM_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
NAV2, KITTI, SCANS = DATA / "ros2" / "nav2_turtlebot.mcap", DATA / "kitti00", DATA / "scans"

needs_nav2 = pytest.mark.skipif(not NAV2.exists(), reason=f"{NAV2} is missing (set DSLAM_DATA)")
needs_kitti = pytest.mark.skipif(not KITTI.is_dir(), reason=f"no KITTI 00 in {KITTI}: set DSLAM_DATA")
needs_scans = pytest.mark.skipif(not SCANS.is_dir() or not KITTI.is_dir(), reason=f"no scans in {DATA}: set DSLAM_DATA")
ROBOTS = DATA / "robots"
needs_robots = pytest.mark.skipif(not ROBOTS.is_dir(), reason=f"no robots in {DATA}: set DSLAM_DATA")
