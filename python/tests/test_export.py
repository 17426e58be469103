"""Files of points: the program's, byte for byte, and what laspy reads in them."""

import os

import esker
import laspy
import numpy as np
import pytest
from conftest import assert_same_points
from test_command_line import KINDS, VIEW, X, Y

#: Arguments of `esker query -o`, and the keywords that mean the same.
FILES = [
    ("a.las", [], {}),
    ("a.laz", ["--where", "Classification = 2"], {"where": "Classification = 2"}),
    ("a.laz", ["--capacity", "5k", "--attributes", "Intensity"], {"capacity": 5000, "attributes": ["Intensity"]}),
    ("a.las", ["--scale", "0.01"], {"scale": 0.01, "scans": None}),
    ("a.ply", ["--max-error", "0.7"], {"max_error": 0.7}),
    ("a.csv", ["--box", f"{X},{Y},{X + 15},{Y + 20}"], {"box": [(X, Y, -np.inf), (X + 15, Y + 20, np.inf)]}),
    ("a.npy", ["--scan", "site_1"], {"scans": "site_1"}),
    ("a.points", ["--format", "csv", "--level", "1"], {"format": "csv", "level": 1}),
    ("a.las", ["--split-by", "class"], {"split_by": "class"}),
    ("a.laz", ["--split-by", "scan", "--frame", "scan"], {"split_by": "scan", "frame": "scan"}),
]


@pytest.mark.parametrize("name, arguments, keywords", FILES, ids=[" ".join([n, *a]) for n, a, _ in FILES])
def test_files_are_the_programs(site, program, tmp_path, name, arguments, keywords):
    ours, theirs = tmp_path / "ours", tmp_path / "theirs"
    ours.mkdir(), theirs.mkdir()
    program("query", site.path, *arguments, "-o", theirs / name)
    report = site.store.export(ours / name, **keywords)
    written = {os.path.basename(part["path"]) for part in report["outputs"]}
    assert written == set(os.listdir(ours)) == set(os.listdir(theirs))
    assert sum(part["points"] for part in report["outputs"]) == report["points"] > 0
    for file in written:
        assert (ours / file).read_bytes() == (theirs / file).read_bytes(), file


@pytest.mark.parametrize("ending", ["las", "laz"])
def test_laspy_reads_the_points_that_were_asked_for(site, tmp_path, ending):
    path = tmp_path / f"some.{ending}"
    site.store.export(path, where="Classification = 2 and Intensity > 100")
    truth = site.truth()
    truth = truth[(truth["Classification"] == 2) & (truth["Intensity"] > 100)]
    # All scans have one grid, which is the store's.
    found = site.of_file(0, path)
    names = [name for name in truth.dtype.names if name != "scan"]
    assert len(found) > 1000
    assert_same_points(found[names], truth[names])


def test_points_are_in_the_order_of_the_answer(site, tmp_path):
    for keywords in ({"capacity": 3000}, {"view": VIEW, "max_error_px": 3}):
        path = tmp_path / "answer.las"
        report = site.store.export(path, overwrite=True, **keywords)
        answer = site.store.query(positions="lattice", **keywords)
        las = laspy.read(path)
        assert report["error_bound"] == answer.error_bound
        for axis in range(3):
            steps = np.rint(las.header.offsets[axis] / site.quantum[axis]).astype(np.int64) + las["XYZ"[axis]]
            np.testing.assert_array_equal(steps, answer["XYZ"[axis]])
        np.testing.assert_array_equal(las.intensity, answer["intensity"])


def test_a_file_that_is_there_stays_unless_it_is_to_be_replaced(site, tmp_path):
    path = tmp_path / "there.laz"
    path.write_bytes(b"mine")
    with pytest.raises(esker.ExistsError, match="there.laz: exists already; overwrite=True replaces it") as caught:
        site.store.export(path)
    assert isinstance(caught.value, FileExistsError) and path.read_bytes() == b"mine"
    site.store.export(str(path), overwrite=True, capacity=100)
    assert len(laspy.read(path)) == 100
    assert os.listdir(tmp_path) == ["there.laz"]


def test_progress_is_told_and_may_stop_the_work(large, tmp_path):
    told = []
    large.store.export(tmp_path / "all.laz", progress=lambda *state: told.append(state))
    points = [done for _, done, _ in told]
    assert {(stage, total) for stage, _, total in told} == {("writing", None)}
    assert len(told) >= 2 and points == sorted(points) and points[-1] == 1_000_000

    def enough(stage, done, total):
        if done > 0:
            raise RuntimeError("enough")

    for split_by in (None, "class"):
        with pytest.raises(RuntimeError, match="enough"):
            large.store.export(tmp_path / "part.laz", progress=enough, split_by=split_by)
    assert os.listdir(tmp_path) == ["all.laz"]


@pytest.mark.parametrize(
    "name, keywords, error, message",
    [
        ("a.shp", {}, esker.FormatError, "'shp' is no ending"),
        ("a.las", {"format": "shp"}, esker.QueryError, "format is 'shp'"),
        ("a.las", {"split_by": "colour"}, esker.QueryError, "split_by is 'colour'"),
        ("a.las", {"frame": "moon"}, esker.QueryError, "frame is 'moon'"),
        ("a.las", {"frame": "scan"}, esker.QueryError, "for the points of one scan"),
        ("a.las", {"scale": 1e-9}, esker.FormatError, "too wide for 32-bit coordinates in steps of"),
        ("a.las", {"scale": (1, 2)}, ValueError, "scale is one number, or one per axis"),
        ("nowhere/a.las", {}, esker.NotThereError, "does not exist"),
        ("a.las", {"masked": True}, TypeError, "masked is about arrays"),
        ("a.las", {"bax": 1}, TypeError, "bax"),
        ("a.las", {"where": "Intensty > 1"}, esker.FilterError, "did you mean"),
    ],
)
def test_what_can_not_be_written(site, tmp_path, name, keywords, error, message):
    with pytest.raises(error, match=message):
        site.store.export(tmp_path / name, **keywords)
    assert os.listdir(tmp_path) == []


def test_points_are_split_by_classes_that_exist_and_need_not_be_written(site, tmp_path):
    report = site.store.export(tmp_path / "a.npy", split_by="class", attributes=[])
    for part in report["outputs"]:
        assert np.load(part["path"]).dtype.names == ("X", "Y", "Z")
        assert part["points"] == site.store.count(where=f"Classification = {part['class']}")
    (tmp_path / "bare.csv").write_text("x,y,z\n1,2,3\n")
    esker.ingest(tmp_path / "bare.esker", tmp_path / "bare.csv")
    with esker.open(tmp_path / "bare.esker") as bare, pytest.raises(esker.QueryError, match="no Classification"):
        bare.export(tmp_path / "b.las", split_by="class")


def test_every_kind_of_query_can_be_exported():
    """No keyword that says which points is missing."""
    named = set(esker._store.ExportedKeywords.__annotations__)
    assert set().union(*(keywords for _, keywords in KINDS)) <= named
    arrays = {"positions", "raw", "masked", "with_scan"}
    assert named == esker._arguments.DEFAULTS.keys() - arrays


def test_files_say_the_scan_of_each_point(tmp_path, site):
    with esker.open(site.path) as store:
        report = store.export(tmp_path / "s.npy", attributes=["Intensity"], with_scan=True)
        found = np.load(tmp_path / "s.npy")
        assert found.dtype.names[-1] == "Scan" and len(found) == report["points"]
        counts = {scan["id"]: scan["stored"] for scan in store.scans}
        assert dict(zip(*(part.tolist() for part in np.unique(found["Scan"], return_counts=True)))) == counts
        store.export(tmp_path / "rows.xyz", attributes=["Intensity"])
        rows = np.loadtxt(tmp_path / "rows.xyz")
        assert rows.shape == (report["points"], 4) and rows[:, 3].sum() == found["Intensity"].sum()
