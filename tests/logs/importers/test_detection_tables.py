from __future__ import annotations

import numpy as np
import pytest

from logs.errors import DatasetError
from logs.importers.detection_tables import DetectionTable, read_detections
from logs.importers.tables import read_table
from logs.importers.text_files import SourceText


def read(text: str) -> DetectionTable:
    return read_detections(read_table(SourceText("det.csv", text, "")))


def test_only_stamp_x_and_y_are_needed() -> None:
    table = read("stamp_s,x_m,y_m\n0.5,1,2\n")
    np.testing.assert_array_equal(table.positions, [[1, 2, 0]])
    assert (table.labels, table.frames, table.unlabelled_count) == (("object",), ("base_link",), 1)
    np.testing.assert_array_equal(table.scores, [1.0])
    assert (table.covariances, table.sizes, table.track_ids, table.true_ids) == (None, None, None, None)
    assert table.stamps.stamps_ns.tolist() == [500_000_000]


@pytest.mark.parametrize(
    ("name", "cell"),
    [("stamp", "1.5"), ("Timestamp", "1.5"), ("time [s]", "1.5"), ("t_ms", "1500"), ("stamp_us", "1.5e6"),
     ("timestamp_ns", "1500000000"), ("time", "1970-01-01T00:00:01.5Z"), ("time", "1970-01-01 00:00:01.500000+00:00")],
)  # fmt: skip
def test_names_and_units_of_stamps(name: str, cell: str) -> None:
    assert read(f"{name},x,y\n{cell},1,2\n").stamps.stamps_ns.tolist() == [1_500_000_000]


def test_lengths_have_the_unit_of_their_column() -> None:
    table = read("stamp_s,x_mm,y_cm,z [m],diameter_cm\n0,1500,250,3,40\n")
    np.testing.assert_allclose(table.positions, [[1.5, 2.5, 3.0]])
    np.testing.assert_allclose(table.sizes, [[0.4, 0.4, np.nan]])


def test_json_lines_may_leave_out_what_is_not_known() -> None:
    table = read(
        '{"stamp_ns": 1700000000123456789, "x": 1.5, "y": -2, "label": "pole", "score": 0.25, "object_id": 9}\n'
        '{"stamp_ns": 1700000000123456789, "x": 3, "y": 4, "score": null}\n'
    )
    assert table.stamps.stamps_ns[0] == 1_700_000_000_123_456_789
    assert table.labels == ("pole", "object")
    assert table.true_ids == ("9", "")
    np.testing.assert_array_equal(table.scores, [0.25, 1.0])


@pytest.mark.parametrize("name", ["class_id", "name", "type", "category_id"])
def test_names_of_labels(name: str) -> None:
    assert read(f"stamp_s,{name},x,y\n0,7,1,2\n").labels == ("7",)


def test_labels_may_be_of_any_alphabet_and_quoted() -> None:
    table = read('stamp_s;class;x;y\n0;"pole; tall";1;2\n0;\N{GREEK SMALL LETTER PI};1;2\n')
    assert table.labels == ("pole; tall", "\N{GREEK SMALL LETTER PI}")


def test_the_header_may_be_a_comment_and_comments_may_be_anywhere() -> None:
    table = read("# from a detector, in the hall\n# stamp_s,x,y\n0,1,2\n# pause\n0.1,3,4\n")
    np.testing.assert_array_equal(table.positions, [[1, 2, 0], [3, 4, 0]])
    assert list(table.stamps.table.cells.index) == [3, 5]


def test_scans_are_stamps_and_frames_and_may_be_empty() -> None:
    table = read(
        "stamp_s,label,x,y,frame,track_id,object_id\n0,a,1,2,front,4,1\n0,b,3,4,rear,5,-1\n0,c,5,6,front,6,3\n1,,,,,,\n"
    )
    scans = list(table.scans())
    assert [(d.stamp_ns, d.frame_id, d.labels, d.track_ids) for d, _ in scans] == [
        (0, "front", ("a", "c"), ("4", "6")),
        (0, "rear", ("b",), ("5",)),
        (1_000_000_000, "base_link", (), ()),
    ]
    assert [truth.object_ids for _, truth in scans if truth is not None] == [("1", "3"), ("",), ()]
    assert scans[2][0].positions.shape == (0, 3)


def test_sigmas_become_covariances_and_empty_ones_are_unknown() -> None:
    table = read("stamp_s,x,y,z,sigma_x_m,sigma_y_m,sigma_z_cm\n0,1,2,3,0.1,0.2,30\n0,1,2,3,0.1,,30\n")
    assert table.covariances is not None
    np.testing.assert_allclose(table.covariances[0], np.diag([0.01, 0.04, 0.09]))
    np.testing.assert_array_equal(table.covariances[1], np.zeros((3, 3)))


def test_a_planar_covariance_gets_the_mean_of_its_variances_in_height() -> None:
    for header, cells in (("cxx,cxy,cyy", "0.4,0.1,0.2"), ("covariance_xx,cov_xy,cov_yy_m2", "0.4,0.1,0.2")):
        table = read(f"stamp_s,x,y,{header}\n0,1,2,{cells}\n")
        assert table.covariances is not None
        np.testing.assert_allclose(table.covariances[0], [[0.4, 0.1, 0.0], [0.1, 0.2, 0.0], [0.0, 0.0, 0.3]])
    table = read("stamp_s,x,y,sigma_x,sigma_y\n0,1,2,0.1,0.3\n")
    assert table.covariances is not None
    np.testing.assert_allclose(np.diagonal(table.covariances[0]), [0.01, 0.09, 0.05])


def test_sizes_are_sides_a_diameter_or_both() -> None:
    table = read("stamp_s,x,y,sx,sy,sz\n0,1,2,1,2,3\n0,1,2,0,,3\n")
    np.testing.assert_array_equal(table.sizes, [[1, 2, 3], [np.nan, np.nan, 3]])
    np.testing.assert_array_equal(read("stamp_s,x,y,size,height_m\n0,1,2,.5,4\n").sizes, [[0.5, 0.5, 4]])


ROW = "stamp_s,label,x_m,y_m,z_m,score,diameter_m\n0,a,1,2,3,0.5,0.2\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"det\.csv is empty"),
        ("stamp_s,x_m,y_m\n", r"det\.csv has no rows"),
        ("0,1,2\n", r"det\.csv, line 1: numbers where the names of the columns are expected; begin .* header"),
        ("stamp_s,label,y_m\n0,a,2\n", r"det\.csv: no column for x among stamp_s, label, y_m; call .* x_m"),
        ("label,x_m,y_m\na,1,2\n", r"det\.csv: no column for the stamp among .*; call .* stamp_s"),
        ("stamp_s,x_m,y_m," + "9" * 200_000 + "\n0,1,2,3\n", r"det\.csv, line 1: not CSV \(field larger"),
        ("stamp_s,x_m,x_m,y_m\n0,1,1,2\n", r"det\.csv: column x_m occurs twice"),
        ("stamp_s,time,x_m,y_m\n0,0,1,2\n", r"det\.csv: columns stamp_s and time have the same meaning"),
        (ROW + "0,a,1,2\n", r"det\.csv, line 3: 4 values where 7 are expected"),
        (
            ROW + "0,a,1,two,3,0.5,0.2\n",
            r"det\.csv, line 3, column y_m: 'two' is not a finite.* decimal point",
        ),
        (ROW + "0,a,1,inf,3,0.5,0.2\n", r"det\.csv, line 3, column y_m: 'inf' is not a finite number"),
        (ROW + "0,a,1,2,,0.5,0.2\n", r"det\.csv, line 3, column z_m: empty; give a number"),
        (ROW + "1,a,,,,,\n", r"det\.csv, line 3, column x_m: empty; give a number"),
        (ROW + "0,,,,,,\n", r"det\.csv, line 3, column x_m: empty, in a scan that has other rows"),
        (ROW + "0,a,1,2,3,high,0.2\n", r"det\.csv, line 3, column score: 'high' .*leave it empty"),
        (ROW + "0,a,1,2,3,95,0.2\n", r"det\.csv, line 3, column score: 95 is not in \[0, 1\]; scale"),
        (ROW + "0,a,1,2,3,0.5,-1\n", r"det\.csv, line 3, column diameter_m: -1 is not a length; leave it empty"),
        (
            ROW + "0.2,a,1,2,3,0.5,1\n\n0.1,a,1,2,3,0.5,1\n",
            r"line 5, column stamp_s: 0\.1 comes after a later stamp; sort",
        ),
        (ROW + ",a,1,2,3,0.5,1\n", r"line 3, column stamp_s: '' is not a time"),
        ("stamp_ns,x,y\n0.5,1,2\n", r"line 2, column stamp_ns: '0\.5' is not whole nanoseconds; .*stamp_s"),
        ("timestamp,x,y\n1700000000000000000,1,2\n", r"line 2, column timestamp: .*year 2262; .*stamp_ns"),
        ("stamp_s,x_m,y_m\n0,1,2\n0,2400,1\n0,-2600,2\n", r"line 3, column x_m: 2400: .*call the column x_mm"),
        ("stamp_s,x,y,sigma_x\n0,1,2,.1\n", r"det\.csv: a covariance needs at least .*sigma_y_m"),
        ("stamp_s,x,y,cxx,cxy\n0,1,2,.1,0\n", r"det\.csv: a covariance needs at least cxx, cxy and cyy"),
        ("stamp_s,x,y,cxx,cxy,cyy\n0,1,2,1,0,1\n0,1,2,1,2,1\n", r"line 3, column cxx cxy cyy: not positive definite"),
        ('{"stamp_s": 0, "x": 1,\n', r"det\.csv, line 1: not JSON .*one flat object per line"),
        ('{"stamp_s": 0, "position": [1, 2, 3]}\n', r"line 1, column position: \[.* is neither a number nor a text"),
        ('{"stamp_s": 0, "x": 1, "y": 1}\n3\n', r"det\.csv, line 2: not an object"),
        ('[{"stamp_s": 0}]', r"det\.csv: a JSON array; write one object per line"),
        ('{"stamp_s": 0, "x": NaN, "y": 1}\n', r"line 1, column x: 'NaN' is not a finite number"),
    ],
)
def test_what_is_wrong_is_told_with_its_place_and_the_remedy(text: str, message: str) -> None:
    with pytest.raises(DatasetError, match=message) as caught:
        read(text)
    assert "\n" not in str(caught.value)


def test_full_covariances_are_symmetric() -> None:
    table = read("stamp_s,x,y,z,cxx,cxy,cxz,cyy,cyz,czz\n0,1,2,3,1,.1,.2,1,.3,1\n0,1,2,3,,,,,,\n")
    assert table.covariances is not None
    np.testing.assert_allclose(table.covariances[0], [[1, 0.1, 0.2], [0.1, 1, 0.3], [0.2, 0.3, 1]])
    np.testing.assert_array_equal(table.covariances[1], np.zeros((3, 3)))
