"""P(lost) of each scan compared with the truth: ``python docs/lost_probability.py MAP.mcap ...``.

The maps are of drives with at most one kidnapping, a step of more than 5 m of the ground truth.
"""

import sys

import numpy as np

from dslam import GroundTruthPose, LogReader, Selection
from logs.messages import LocalizationRecord
from logs.topics import RecordKind

TOPICS = {"/ground_truth": RecordKind.GROUND_TRUTH, "/slam/localization": RecordKind.LOCALIZATION}

is_lost, predicted, crossed_m, quiet = [], [], [], []
for path in sys.argv[1:]:
    with LogReader(path) as log:
        records = [entry.record for entry in log.records(Selection.of(TOPICS))]
    truth = {each.stamp_ns: each.T_world_body[:2, 3] for each in records if isinstance(each, GroundTruthPose)}
    stamps, steps_m = np.array(list(truth)), np.linalg.norm(np.diff(list(truth.values()), axis=0), axis=1)
    first = np.argmax(steps_m > 5.0) + 1 if steps_m.max() > 5.0 else len(stamps)  # of the scans after the kidnapping
    scans = {each.stamp_ns: each.lost_probability for each in records if isinstance(each, LocalizationRecord)}
    row = np.searchsorted(stamps, list(scans))
    values = np.array(list(scans.values()))
    predicted += values.tolist()
    is_lost += (row >= first).tolist()
    quiet.append(values[row < first].max())
    if first < len(stamps):
        since_m = np.append(0.0, np.cumsum(np.where(steps_m > 5.0, 0.0, steps_m)))
        over = row[(row >= first) & (values > 0.5)]
        crossed_m.append(since_m[over[0]] - since_m[first] if len(over) else np.inf)
bins = np.minimum((10.0 * np.array(predicted)).astype(int), 9)
print("P(lost)     scans  predicted %  lost %")
for number in np.unique(bins):
    mine = bins == number
    shares = 100.0 * np.mean(np.array(predicted)[mine]), 100.0 * np.mean(np.array(is_lost)[mine])
    print(f"{number / 10:.1f} to {number / 10 + 0.1:.1f} {mine.sum():6d}  {shares[0]:11.2f} {shares[1]:7.2f}")
crossed_m = np.array(crossed_m)
print(f"above 0.5 within 15 m of the kidnapping: {np.sum(crossed_m <= 15.0)} of {len(crossed_m)}")
print("after", " ".join(f"{each:.1f}" for each in np.sort(crossed_m)), "m")
print(f"greatest P(lost) of a robot that was not kidnapped: {max(quiet):.1e}, in {len(quiet)} drives")
