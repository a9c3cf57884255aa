import numpy as np
import pytest

from logs.errors import DatasetError
from logs.importers.measurement_tables import DetectionTable, read_detections
from logs.importers.tables import read_table
from logs.importers.text_files import SourceText
from logs.messages import DetectionTruth, ObjectDetections


def read(text: str) -> DetectionTable:
    return read_detections(read_table(SourceText("det.csv", text, "")))


def scans(table: DetectionTable) -> list[ObjectDetections]:
    return [record for record in table.records if isinstance(record, ObjectDetections)]


def test_read_detections_needs_stamp_x_and_y() -> None:
    table = read("# from a hall\nstamp_s,x_m,y_m\n0.5,1,2\n")
    (found,) = scans(table)
    np.testing.assert_array_equal(found.positions, [[1, 2, 0]])
    assert (found.labels, found.frame_id, len(table.records)) == (("object",), "base_link", 1)
    np.testing.assert_array_equal(found.scores, [1.0])
    assert found.covariances is None


@pytest.mark.parametrize(
    ("name", "cell", "stamp_ns"),
    [
        ("stamp", "1.5", 1_500_000_000),
        ("time [s]", "1.5", 1_500_000_000),
        ("t_ms", "1500", 1_500_000_000),
        ("stamp_us", "1.5e6", 1_500_000_000),
        ("timestamp_ns", "1500000000", 1_500_000_000),
        ("time", "2024-05-01T12:00:00Z", 1_714_564_800_000_000_000),
        ("time", "2024-05-01 14:00:00.000000001+02:00", 1_714_564_800_000_000_001),
        ("time", "2024-05-01 12:00", 1_714_564_800_000_000_000),
    ],
)
def test_read_stamps_by_unit_of_column_or_as_dates(name: str, cell: str, stamp_ns: int) -> None:
    assert scans(read(f"{name},x,y\n{cell},1,2\n"))[0].stamp_ns == stamp_ns


def test_read_detections_by_unit_of_column() -> None:
    (found,) = scans(read("stamp_s,x_mm,y_cm,z [m]\n0,1500,250,3\n"))
    np.testing.assert_allclose(found.positions, [[1.5, 2.5, 3.0]])


def test_read_detections_finds_labels_quoted_and_foreign_ones_too() -> None:
    (found,) = scans(read('stamp_s;class;x;y\n0;"pole; tall";1;2\n0;\N{GREEK SMALL LETTER PI};1;2\n'))
    assert found.labels == ("pole; tall", "\N{GREEK SMALL LETTER PI}")
    assert [scans(read(f"stamp_s,{name},x,y\n0,7,1,2\n"))[0].labels for name in ("Class", "name")] == [("7",)] * 2


def test_empty_cells_at_the_end_of_a_line_between_tabs() -> None:
    found, truth = read("stamp_s\tx\ty\tlabel\tobject_id\n0\t1\t2\ta\t\n0\t1\t2\t\t7\n").records
    assert isinstance(found, ObjectDetections)
    assert isinstance(truth, DetectionTruth)
    assert (found.labels, truth.object_ids) == (("a", "object"), ("", "7"))


def test_scans_by_stamp_and_frame() -> None:
    table = read("stamp_s,label,x,y,frame,object_id\n0,a,1,2,front,1\n0,b,3,4,rear,-1\n0,c,5,6,front,3\n1,,,,,\n")
    assert [(d.stamp_ns, d.frame_id, d.labels) for d in scans(table)] == [
        (0, "front", ("a", "c")),
        (0, "rear", ("b",)),
        (1_000_000_000, "base_link", ()),
    ]
    truths = [record.object_ids for record in table.records if isinstance(record, DetectionTruth)]
    assert truths == [("1", "3"), ("",), ()]
    assert scans(table)[2].positions.shape == (0, 3)


@pytest.mark.parametrize(
    ("columns", "cells", "expected"),
    [
        ("sigma_x_m,sigma_y_m,sigma_z_cm", "0.1,0.2,30", np.diag([0.01, 0.04, 0.09])),
        ("sigma_x,sigma_y", "0.1,0.3", np.diag([0.01, 0.09, 0.05])),
        ("sigma_x,sigma_y", "0.1,", np.zeros((3, 3))),
    ],
)
def test_read_covariances(columns: str, cells: str, expected: object) -> None:
    (found,) = scans(read(f"stamp_s,x,y,{columns}\n0,1,2,{cells}\n"))
    np.testing.assert_allclose(found.covariances, [expected])


ROW = "stamp_s,label,x_m,y_m,z_m,score,sigma_x\n0,a,1,2,3,0.5,0.2\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"det\.csv does not begin with the names of its columns"),
        ("0,1,2\n", r"det\.csv does not begin with the names of its columns; begin it with a header"),
        ("stamp_s,label,y_m\n0,a,2\n", r"det\.csv: no column for x among stamp_s, label, y_m; name .* x_m"),
        ("label,x_m,y_m\na,1,2\n", r"det\.csv: no column for the stamp among .*; name .* stamp_s"),
        ("stamp_s,x_m,y_m," + "9" * 200_000 + "\n0,1,2,3\n", r"det\.csv, line 1: not CSV \(field larger"),
        ("stamp_s,x_m,x_m,y_m\n0,1,1,2\n", r"det\.csv: column x_m occurs twice"),
        ("stamp_s,time,x_m,y_m\n0,0,1,2\n", r"det\.csv: columns stamp_s and time have the same meaning"),
        (ROW + "0,a,1,2\n", r"det\.csv, line 3: 4 values where 7 are expected"),
        (ROW + "0,a,1,two,3,0.5,0.2\n", r"det\.csv, line 3, column y_m: 'two' is not a finite.* decimal point"),
        (ROW + "1,a,,,,,\n", r"det\.csv, line 3, column x_m: empty; give a number"),
        (ROW + "0,a,1,2,3,95,0.2\n", r"det\.csv, line 3, column score: 95 is not in \[0, 1\]; scale"),
        (ROW + "0,a,1,2,3,0.5,-1\n", r"det\.csv, line 3, column sigma_x: -1 is not a length; leave it empty"),
        (ROW + "0.2,a,1,2,3,,\n\n0.1,a,1,2,3,,\n", r"line 5, column stamp_s: 0\.1 comes after a later stamp; sort"),
        (ROW + ",a,1,2,3,0.5,1\n", r"line 3, column stamp_s: '' is not a time"),
        ("time,x,y\n2024-05-41 12:00:00,1,2\n", r"line 2, column time: '2024-05-41 12:00:00' is not a time"),
        ("stamp_ns,x,y\n0.5,1,2\n", r"line 2, column stamp_ns: '0\.5' is not whole nanoseconds; .*stamp_s"),
        ("timestamp,x,y\n1700000000000000000,1,2\n", r"line 2, column timestamp: .*year 2116; .*stamp_ns"),
        ("timestamp,x,y\n1e999999999999999999,1,2\n", r"line 2, column timestamp: .*not a time"),
        ("stamp_s,x_m,y_m\n0,1,2\n0,2400,1\n0,-2600,2\n", r"column x_m: the median is 2400 m.*name the column x_mm"),
        ("stamp_s,x,y,sigma_x\n0,1,2,.1\n", r"det\.csv: noise needs at least .*sigma_y_m"),
    ],
)
def test_read_detections_refuses(text: str, message: str) -> None:
    with pytest.raises(DatasetError, match=message) as caught:
        read(text)
    assert "\n" not in str(caught.value)
