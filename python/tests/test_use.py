"""What numpy's users expect to work."""

import os
import pickle

import esker
import numpy as np
import pytest
from test_command_line import X, Y


def test_numpys_numbers_are_numbers(site):
    store = site.store
    for keywords, plain in [
        ({"capacity": np.int32(500)}, {"capacity": 500}),
        ({"capacity": np.float32(500)}, {"capacity": 500}),
        ({"level": np.uint8(1)}, {"level": 1}),
        ({"spacing": np.float32(0.5)}, {"spacing": 0.5}),
        ({"max_error": np.array(0.5)}, {"max_error": 0.5}),
        ({"scans": np.int64(2)}, {"scans": 2}),
        ({"scans": np.array(["site_1", "site_3"])}, {"scans": ["site_1", "site_3"]}),
        ({"sphere": np.array([X, Y, 500, 9], np.int32)}, {"sphere": (X, Y, 500, 9)}),
        ({"z": np.array([495, 505])}, {"z": (495, 505)}),
        ({"box": (X, Y, X + 9, Y + 9), "closed": np.bool_(True)}, {"box": (X, Y, X + 9, Y + 9), "closed": True}),
    ]:
        assert np.array_equal(store.query(**keywords).points, store.query(**plain).points), keywords
    assert len(next(store.batches(np.int64(700)))) == 700
    assert store.density(np.float32(5)).counts.sum() == 60_000


def test_edges_of_squares_are_multiples_of_the_side_as_it_is_written():
    """Products of floats gave 770519.3999999999."""
    density = esker.Density(0.7, [np.zeros(1)] * 3, (1100742, -3), (1, 1))
    assert (density.x0, density.y0) == (770519.4, -2.1)


def test_corners_and_rings_of_arrays_are_regions(site):
    low, high = [X - 5, Y - 5, 490], [X + 5, Y + 5, 510]
    assert site.store.count(box=np.array([low, high])) == site.store.count(box=low + high) > 0
    assert site.store.count(box=site.store.bounds) == 60_000
    ring = np.array([(X, Y), (X + 20, Y), (X + 15.5, Y + 20)])
    wkt = f"POLYGON(({X} {Y}, {X + 20} {Y}, {X + 15.5} {Y + 20}, {X} {Y}))"
    expected = site.store.count(polygon=wkt)
    for polygon in (ring, ring.tolist(), np.vstack([ring, ring[:1]])):
        assert site.store.count(polygon=polygon) == expected > 0


def test_neighbours_of_one_place_and_of_many(site):
    places = site.store.query(capacity=50, attributes=[]).xyz
    many = site.store.nearest(places, k=2)
    assert many.offsets.tolist() == list(range(0, 101, 2)) and (many.distances[::2] == 0).all()
    one = site.store.nearest(places[7], k=2)
    assert np.array_equal(one.xyz, many.xyz[14:16])
    # Not in the order of rows, and not of float64.
    turned = np.asfortranarray(places)
    assert np.array_equal(site.store.nearest(turned, k=2).distances, many.distances)
    assert len(site.store.nearest([], k=2)) == 0
    for wrong, error in [([1, 2], ValueError), ([[1, 2, 3, 4]], ValueError), ("abc", ValueError), ([[1, None, 3]], ValueError)]:
        with pytest.raises((error, TypeError)):
            site.store.nearest(wrong)
    with pytest.raises(ValueError, match="k is 0"):
        site.store.nearest(places, k=0)


def test_points_are_arrays_for_numpy_and_go_to_other_processes(site):
    answer = site.store.query(capacity=1000, max_error=0.3)
    assert np.asarray(answer) is answer.points
    again = pickle.loads(pickle.dumps(answer))
    assert np.array_equal(again.points, answer.points) and again.error_bound == answer.error_bound
    assert np.array_equal(again["intensity"], answer["intensity"]) and repr(again) == repr(answer)
    batch = next(site.store.batches(10, masked=True))
    again = pickle.loads(pickle.dumps(batch))
    assert np.array_equal(np.ma.getmaskarray(again.points), np.ma.getmaskarray(batch.points))
    with pytest.raises(TypeError, match="pickle"):
        pickle.dumps(site.store.batches(10))
    with site.store.snapshot() as snapshot, pytest.raises(TypeError, match="pickle"):
        pickle.dumps(snapshot)


def test_a_store_is_found_from_another_folder(site, tmp_path, monkeypatch):
    """A relative path was looked for in whatever folder the process went to: the store was said to be gone."""
    folder, name = os.path.split(site.path)
    monkeypatch.chdir(folder)
    with esker.open(name) as store:
        monkeypatch.chdir(tmp_path)
        assert os.path.samefile(store.path, site.path)
        assert len(store.query()) == store.count() == 60_000
        assert pickle.loads(pickle.dumps(store)).count() == 60_000
        with store.snapshot() as snapshot:
            assert snapshot.path == store.path
        store.hide("site_1")
        assert store.count() == 40_000
        store.show("site_1")


def test_whole_numbers_keep_all_their_digits(tmp_path):
    (tmp_path / "ids.csv").write_text("x,y,z,id\n1,2,3,9007199254740993\n4,5,6,-9007199254740995\n")
    esker.ingest(tmp_path / "ids.esker", [tmp_path / "ids.csv"])
    with esker.open(tmp_path / "ids.esker") as store:
        told = next(a for a in store.info["attributes"] if a["name"] == "id")
        assert [told["min"], told["max"]] == [-9007199254740995, 9007199254740993]
        found = next(a for a in store.summary()["attributes"] if a["name"] == "id")
        assert (found["min"], found["max"]) == (-9007199254740995, 9007199254740993)


def test_files_of_a_split_answer_tell_their_scan(site, tmp_path):
    outputs = site.store.export(tmp_path / "out.las", split_by="scan")["outputs"]
    assert [part["scan"] for part in outputs] == ["site_1", "site_2", "site_3"]
    outputs = site.store.export(tmp_path / "out.las", split_by="class")["outputs"]
    assert all(part["path"].endswith(f"_class{part['class']}.las") for part in outputs)


def test_stores_say_what_they_are(site, tmp_path):
    assert len(site.store) == 60_000 and bool(site.store)
    assert repr(site.store) == f"<esker.Store {site.path!r}: 60,000 points>"
    path = tmp_path / "hidden.esker"
    esker.ingest(path, site.files)
    with esker.open(path) as store:
        store.hide(["site_1", "site_2"])
        assert len(store) == store.count() == 20_000
        store.remove(["site_1", "site_2", "site_3"])
        assert len(store) == 0 and bool(store) and store.bounds is None
        path.unlink()
        assert "hidden.esker" in repr(store)
    assert esker.__version__.count(".") == 2


def test_the_cache_keeps_what_it_may(site):
    def cost(store):
        return store.query(attributes=["Intensity"], capacity=20_000).statistics

    with esker.open(site.path) as store:
        first, again = cost(store), cost(store)
        assert first["bytes_read"] > 0 and again["bytes_read"] == 0
        assert store.cache["block_bytes"] > 0 and store.cache["block_hits"] > 0
        with pickle.loads(pickle.dumps(store)) as other:
            assert cost(other)["bytes_read"] > 0 and cost(other)["bytes_read"] == 0
    for few in (0, 100_000, 1e6):
        with esker.open(site.path, cache=few) as store:
            first, again = cost(store), cost(store)
            store.query()
            assert store.cache["block_bytes"] + store.cache["row_bytes"] <= few
            assert first["bytes_read"] > 0 and (few > 0 or again["bytes_read"] == first["bytes_read"])
            with pickle.loads(pickle.dumps(store)) as other:
                cost(other), cost(other)
                assert other.cache["block_bytes"] <= few
    for wrong, error in [(-1, ValueError), ("much", TypeError), (1.5, TypeError)]:
        with pytest.raises(error, match="cache"):
            esker.open(site.path, cache=wrong)
