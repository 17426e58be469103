"""Arrays into a store."""

import esker
import numpy as np
import pytest

N = 1000


def columns():
    x = np.arange(N) * 0.25
    return {
        "x": x,
        "y": x % 7,
        "z": -x,
        "intensity": np.arange(N, dtype=np.uint16),
        "score": np.linspace(0, 1, N, dtype=np.float32),
        "id": np.arange(N, dtype=np.int64) - 2**60,
        "flag": np.arange(N) % 2 == 0,
    }


def structured(made):
    records = np.empty(N, [(name, values.dtype) for name, values in made.items()])
    for name, values in made.items():
        records[name] = values
    return records


def test_every_form_of_points_is_the_same_scan(tmp_path):
    made = columns()
    path = tmp_path / "s.esker"
    report = esker.ingest_points(path, made, "made", quantum=0.25, crs="EPSG:25832")
    assert report["points"] == N and report["scans"][0]["max_error"] == 0
    with esker.open(path) as store:
        found = store.query().points
        order = np.argsort(found["Intensity"])
        for name, values in made.items():
            name = {"intensity": "Intensity"}.get(name, name)
            expected = values.astype(np.uint8) if values.dtype == bool else values
            assert found[name].dtype == expected.dtype and (found[name][order] == expected).all(), name
        scan = store.scans[0]
        assert (scan["name"], scan["format"], scan["source"]) == ("made", "table", "")
        assert store.info["crs"]["horizontal_epsg"] == 25832
        assert store.verify(deep=True)["whole"]
        # Under whatever name, the same points are there already.
        swapped = {name: values.astype(values.dtype.newbyteorder()) for name, values in made.items()}
        for again in (made, structured(made), swapped):
            report = store.ingest_points(again, "again")
            assert report["points"] == 0 and "already in the store as 'made'" in report["skipped"][0]["reason"]
        with pytest.raises(esker.IngestError, match="can't be read again"):
            store.replace("made")
    esker.ingest_points(tmp_path / "rows.esker", np.stack([made["x"], made["y"], made["z"]], axis=1), "rows")
    with esker.open(tmp_path / "rows.esker") as rows:
        assert rows.query().points.dtype.names == ("x", "y", "z") and rows.count() == N


def test_answers_go_back_and_poses_apply(tmp_path, site):
    with esker.open(site.path) as store:
        found = store.query(where="Classification = 2", attributes=["Intensity", "Red"])
        count, lattice = len(found), site.path
    path = tmp_path / "back.esker"
    assert esker.ingest_points(path, found, "ground", lattice=lattice)["points"] == count
    with esker.open(path) as store:
        key = ["x", "y", "z", "Intensity", "Red"]
        both = [np.sort(points[key], order=key) for points in (store.query().points, found.points)]
        assert (both[0] == both[1]).all()
    quarter = [[0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30], [0, 0, 0, 1]]
    esker.ingest_points(tmp_path / "p.esker", {"X": [1.0], "Y": [2.0], "Z": [3.0]}, "p", poses=[quarter])
    with esker.open(tmp_path / "p.esker") as store:
        assert [store.query().points[0][axis] for axis in "xyz"] == [8, 21, 33]


def test_what_is_no_table_of_points_is_told(tmp_path):
    path, made = tmp_path / "s.esker", columns()

    def refused(points, message, name="n", kind=TypeError, **keywords):
        with pytest.raises(kind, match=message):
            esker.ingest_points(path, points, name, **keywords)

    refused({"x": [1.0], "y": [1.0]}, "points have no z")
    refused(np.zeros((4, 2)), "rows of x, y, z")
    refused({**made, "word": np.array(["a"] * N)}, "word must be whole or real numbers")
    refused({**made, "pair": np.zeros((N, 2))}, "pair must have one value a point")
    refused({**made, "score": np.ma.array(made["score"], mask=[True] + [False] * (N - 1))}, "score is masked")
    refused({**made, "short": np.zeros(3)}, "short has 3 values for 1000 points", kind=esker.EskerError)
    refused({**made, "Intensity": made["intensity"]}, "Intensity .u16. is there twice", kind=esker.EskerError)
    refused(made, "name must be a string", name=" ")
    refused(made, "unexpected keyword", keep_going=True)
    assert not path.exists()
    bad = {**made, "x": np.where(np.arange(N) < 3, np.nan, made["x"])}
    report = esker.ingest_points(path, bad, "n")
    assert (report["scans"][0]["rejected_not_finite"], report["points"]) == (3, N - 3)


def test_what_would_be_other_points_is_refused(tmp_path, site):
    path = tmp_path / "s.esker"
    rows = {"x": [1.0, 2.0], "y": [3.0, 4.0], "z": [5.0, 6.0]}
    lattice = site.store.query(positions="lattice", capacity=10)
    with pytest.raises(TypeError, match="lattice steps; ask for them with positions="):
        esker.ingest_points(path, lattice, "p")
    with pytest.raises(TypeError, match="two columns are called the same"):
        esker.ingest_points(path, {**rows, 1: [1, 2], "1": [3, 4]}, "p")
    for pose, why in [(np.diag([1, 1, 3, 1]), "stretches"), (np.diag([1, 1, -1, 1]), "mirrors")]:
        with pytest.raises(esker.IngestError, match=why):
            esker.ingest_points(path, rows, "p", poses=[pose])
    assert not path.exists()
    # A field that is called like an attribute of numpy's arrays, or of ours, is a field.
    table = np.zeros(3, [("x", "f8"), ("y", "f8"), ("z", "f8"), ("points", "u1")]).view(np.recarray)
    table.points = [7, 8, 9]
    esker.ingest_points(path, table, "p")
    with esker.open(path) as store:
        assert sorted(store.query()["points"]) == [7, 8, 9]
