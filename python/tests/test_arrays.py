"""What arrays answers give: both forms, nulls, scaled values, names."""

import esker
import laspy
import numpy as np
import pytest


def write(path, point_format, extra=(), points=50, seed=0, **columns):
    """A LAS file of points in a square, with what is asked for besides."""
    header = laspy.LasHeader(version="1.4", point_format=point_format)
    header.scales, header.offsets = [0.01] * 3, [0.0] * 3
    header.add_extra_dims([laspy.ExtraBytesParams(**e) for e in extra])
    las = laspy.LasData(header)
    rng = np.random.default_rng(seed)
    las.X, las.Y, las.Z = (rng.permutation(1000)[:points] for _ in range(3))
    for name, values in columns.items():
        las[name] = values
    las.write(path)


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    """One scan with colours and heights that are scaled and may be missing, one without."""
    folder = tmp_path_factory.mktemp("mixed")
    stored = np.arange(50, dtype=np.int16)
    height = {"name": "height", "type": "int16", "scales": [0.5], "offsets": [10.0], "no_data": [7]}
    write(folder / "rich.las", 7, [height], red=np.arange(1, 51), height=stored * 0.5 + 10.0)
    write(folder / "poor.las", 6, seed=1)
    esker.ingest(folder / "mixed.esker", [folder / "rich.las", folder / "poor.las"])
    with esker.open(folder / "mixed.esker") as store:
        yield store


def test_both_forms_are_the_same_whichever_comes_first(site):
    for masked in (False, True):
        keywords = {"masked": masked, "with_scan": True, "capacity": 5000}
        points_first, columns_first = site.store.query(**keywords), site.store.query(**keywords)
        a, b = points_first.points, columns_first.columns
        c, d = points_first.columns, columns_first.points
        assert a.dtype == d.dtype == points_first.dtype
        assert np.array_equal(a, d)
        for name in points_first.names:
            assert np.array_equal(a[name], b[name]) and np.array_equal(b[name], c[name])
            assert c[name].flags.c_contiguous and b[name].dtype == a.dtype[name]
        assert np.array_equal(points_first.xyz, columns_first.xyz)
        assert np.array_equal(points_first.xyz[:, 2], b["z"])
        assert points_first.points is a and columns_first.columns is b


def test_arrays_are_writable_and_outlive_the_store(site):
    with esker.open(site.path) as store:
        answer = store.query(attributes=["Intensity"], capacity=1000)
    assert store.closed
    column = answer["intensity"]
    before = column.copy()
    column += 1
    answer.points["z"] -= 1.0
    assert np.array_equal(column, before + 1) and len(answer.points) == 1000


def test_types_are_those_of_the_store(site):
    stored = {a["name"]: a["ty"] for a in site.store.attributes}
    dtype = site.store.query(capacity=1).dtype
    assert dtype.isnative
    for name, ty in stored.items():
        assert dtype[name] == np.dtype({"u": "uint", "i": "int", "f": "float"}[ty[0]] + ty[1:])


def test_an_empty_answer_has_its_fields(site):
    answer = site.store.query(where="Classification = 77")
    assert len(answer) == 0 and len(answer.points) == 0
    assert answer.points.dtype == site.store.query(capacity=1).points.dtype
    assert all(len(column) == 0 for column in answer.columns.values())
    assert list(site.store.batches(where="Classification = 77")) == []
    with pytest.warns(esker.EskerWarning, match="outside the site"):
        assert site.store.query(box=(0, 0, 1, 1), masked=True).region_misses_site


def test_nulls_are_zero_or_nan_or_masked(mixed):
    plain = mixed.query(with_scan=True)
    poor = plain["scan"] == 2
    assert poor.sum() == 50 and set(plain.nullable) == {"Red", "Green", "Blue", "height"}
    assert not plain["Red"][poor].any() and plain["Red"][~poor].all()
    assert not isinstance(plain.points, np.ma.MaskedArray)

    for first in ("points", "columns"):
        masked = mixed.query(with_scan=True, masked=True)
        getattr(masked, first)
        assert np.array_equal(masked["Red"].mask, poor)
        assert np.array_equal(masked.points.mask["Red"], poor)
        assert not masked.points.mask["Intensity"].any()
        assert not isinstance(masked["Intensity"], np.ma.MaskedArray)
        # Of the scan that has heights, the one that is 7 as stored.
        assert np.array_equal(masked["height"].mask, np.isnan(plain["height"]))
        assert np.isnan(plain["height"][poor]).all()
        assert masked["height"].count() == 49

    # An answer of one scan has no nulls of others.
    assert mixed.query(scans=["rich"]).nullable == ("height",)
    batches = list(mixed.batches(30, masked=True, with_scan=True))
    assert np.array_equal(np.concatenate([b["Red"].mask for b in batches]), plain["scan"] == 2)


def test_scaled_values_are_real_ones_unless_asked_otherwise(mixed):
    real, raw = mixed.query(scans="rich"), mixed.query(scans="rich", raw=True)
    assert real["height"].dtype == np.float64 and raw["height"].dtype == np.int16
    assert np.array_equal(np.sort(raw["height"]), np.arange(50))
    # 7 is its no-data value.
    expected = np.where(raw["height"] == 7, np.nan, raw["height"] * 0.5 + 10.0)
    assert np.array_equal(real["height"], expected, equal_nan=True)
    # As filters see them.
    assert mixed.count(where="height > 20") == (np.delete(np.arange(50), 7) * 0.5 + 10 > 20).sum()


def test_a_name_of_two_types_is_told_apart(tmp_path):
    write(tmp_path / "a.las", 6, [{"name": "quality", "type": "uint8"}], quality=np.full(50, 3))
    write(tmp_path / "b.las", 6, [{"name": "quality", "type": "float32"}], seed=1, quality=np.full(50, 0.5))
    esker.ingest(tmp_path / "s.esker", [tmp_path / "a.las", tmp_path / "b.las"])
    with esker.open(tmp_path / "s.esker") as store:
        answer = store.query(attributes="quality")
        assert answer.names == ("x", "y", "z", "quality:u8", "quality:f32")
        assert answer["quality:u8"].sum() == 150 and answer["quality:f32"].sum() == 25


def ply(path, x, ty, red):
    """Points in a row, of these levels of red in fields of this type; green is as many."""
    head = "ply\nformat ascii 1.0\nelement vertex {}\n".format(len(red))
    head += "".join(f"property double {axis}\n" for axis in "xyz")
    head += "".join(f"property {ty} {name}\n" for name in ("red", "green", "blue"))
    rows = "".join(f"{x + i} 0 0 {r} {r} {r}\n" for i, r in enumerate(red))
    path.write_text(head + "end_header\n" + rows)


def test_colours_of_two_kinds_are_one_field_unless_asked_otherwise(tmp_path):
    ply(tmp_path / "few.ply", 0, "uchar", [0, 1, 255])
    ply(tmp_path / "many.ply", 10, "ushort", [0, 256, 65535])
    # 8 bits in fields of 16.
    ply(tmp_path / "low.ply", 20, "ushort", [0, 1, 255])
    files = [tmp_path / name for name in ("few.ply", "many.ply", "low.ply")]
    esker.ingest(tmp_path / "s.esker", files)
    every = [0, 257, 65535, 0, 256, 65535, 0, 257, 65535]
    with esker.open(tmp_path / "s.esker") as store:

        def red(answers, name="Red"):
            points = np.concatenate([np.stack([a["x"], a[name]], 1) for a in answers])
            return points[np.argsort(points[:, 0])][:, 1].astype(int).tolist()

        answer = store.query(attributes="Red", masked=True)
        assert answer.names == ("x", "y", "z", "Red") and answer["Red"].dtype == np.uint16
        assert answer.nullable == () and red([answer]) == every
        assert red(store.batches(4, attributes="Red")) == every
        near = store.nearest([[2, 0, 0]], k=2, attributes="Red")
        assert sorted(near["Red"].tolist()) == [257, 65535]
        raw = store.query(attributes="Red", raw=True)
        assert raw.names == ("x", "y", "z", "Red:u8", "Red:u16")
        assert red([raw], "Red:u8") == [0, 1, 255] + 6 * [0]
        assert red([raw], "Red:u16") == 3 * [0] + [0, 256, 65535, 0, 1, 255]
        # Alone each is as it was read.
        assert store.query(scans="few", attributes="Red")["Red"].dtype == np.uint8
        assert red([store.query(scans="low", attributes="Red")]) == [0, 1, 255]


def test_names_are_looked_up_as_in_filters(site):
    answer = site.store.query(attributes=["gps_time", "return_num", "CLASSIFICATION"], capacity=10)
    assert answer.names == ("x", "y", "z", "Classification", "GpsTime", "ReturnNumber")
    assert answer["gps_time"] is answer["GpsTime"] and answer["return_num"] is answer["ReturnNumber"]
    assert "class" in answer and "Red" not in answer and list(answer) == list(answer.names)
    with pytest.raises(KeyError):
        answer["Red"]


def test_scans_that_scale_in_different_ways_have_one_field_of_real_values(tmp_path):
    # The first scan's scale and no-data value were taken for those of all.
    stored = np.arange(50, dtype=np.int16)
    kinds = {
        "a": {"scales": [0.5], "offsets": [10.0], "no_data": [7]},
        "b": {"scales": [0.01], "offsets": [0.0]},
        "c": {"no_data": [9]},
    }
    for seed, (name, kind) in enumerate(kinds.items()):
        path = tmp_path / f"{name}.las"
        write(path, 6, [{"name": "height", "type": "int16", **kind}], seed=seed)
        las = laspy.read(path)
        las.points.array["height"] = stored
        las.write(path)
    esker.ingest(tmp_path / "s.esker", [tmp_path / "c.las", tmp_path / "a.las", tmp_path / "b.las"])
    with esker.open(tmp_path / "s.esker") as store:
        answer = store.query(attributes=["height"], with_scan=True, masked=True)
        scan_of = {scan["name"]: scan["id"] for scan in store.scans}
        expected = {"a": stored * 0.5 + 10, "b": stored / 100, "c": stored.astype("f8")}
        no_data = {"a": 7, "b": None, "c": 9}
        for name, values in expected.items():
            found = answer["height"][np.asarray(answer["scan"]) == scan_of[name]]
            assert np.array_equal(np.sort(found.compressed()), np.sort(np.delete(values, no_data[name] or [])))
            assert found.mask.sum() == (no_data[name] is not None)
            assert store.count(scans=name, where="height is null") == (no_data[name] is not None)
        assert np.isnan(np.asarray(store.query()["height"])).sum() == 2
        raw = store.query(attributes=["height"], raw=True)
        assert raw.names == ("x", "y", "z", "height:i16", "height:i16.2", "height:i16.3")
        assert store.query(attributes=["height"], raw=True, scans="b").names == ("x", "y", "z", "height")
        (summary,) = [a for a in store.summary()["attributes"] if a["name"] == "height"]
        assert (summary["count"], summary["min"], summary["max"]) == (148, 0.0, 49.0)
