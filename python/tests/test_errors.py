"""Errors are exceptions by what a caller can do, with the library's messages."""

import os
import pickle
import shutil
import sqlite3

import esker
import pytest


@pytest.mark.parametrize(
    "keywords, error, message",
    [
        ({"box": (0, 0, 1)}, esker.QueryError, "a box has 4 numbers"),
        ({"policy": "distance"}, esker.QueryError, "give a view"),
        ({"box": (5, 0, 1, 1)}, esker.QueryError, "the box has x from 5 to 1; give the smaller number first"),
        ({"box": (0, 0, float("nan"), 1)}, esker.QueryError, "NaN"),
        ({"box": "0,0,1,1"}, TypeError, "box must be numbers"),
        ({"box": (0, 0, "one", 1)}, ValueError, "one"),
        ({"sphere": (0, 0, 0, -1)}, esker.QueryError, "the radius of the sphere is -1"),
        ({"sphere": (0, 0, 0)}, esker.QueryError, "a sphere has 4 numbers"),
        ({"obox": (0, 0, 0, 1, -1, 1, 0)}, esker.QueryError, "a side of the oriented box is -1"),
        ({"polygon": "POLYGON ((0 0, 1 x))"}, esker.QueryError, "olumn|haracter"),
        ({"polygon": "POLYGON ((0 0, 1 1, 1 0, 0 1, 0 0))"}, esker.QueryError, "cross"),
        ({"polygon": "POLYGON ((11 48, 12 48, 12 49, 11 48))"}, esker.QueryError, "degrees"),
        ({"polygon": 7}, TypeError, "polygon must be WKT"),
        ({"z": (1,)}, esker.QueryError, "z has 2 numbers"),
        ({"z": (2, 1)}, esker.QueryError, "give the smaller number first"),
        ({"frustum": {"eye": [0, 0, 0]}}, esker.QueryError, "the frustum is no view"),
        ({"region": "box(0,0,1,1) nor z(0,1)"}, esker.QueryError, "expected \"and\""),
        ({"closed": True}, esker.QueryError, "closed"),
        ({"where": "Intensity >"}, esker.FilterError, "Intensity >"),
        ({"where": "Intensty > 3"}, esker.FilterError, "did you mean"),
        ({"where": 3}, TypeError, "where"),
        ({"scans": ["site_9"]}, esker.UnknownNameError, 'there is no scan "site_9"; did you mean "site_'),
        ({"scans": [1.5]}, TypeError, "scans must be names"),
        ({"attributes": ["Intensty"]}, esker.UnknownNameError, 'did you mean "Intensity"'),
        ({"max_error": -1}, esker.QueryError, "max error"),
        ({"max_error": float("nan")}, esker.QueryError, "NaN"),
        ({"spacing": 0}, esker.QueryError, "spacing"),
        ({"spacing": 1, "level": 2}, esker.QueryError, "one of max_error, spacing and level"),
        ({"level": -1}, esker.QueryError, "the level is -1; it must be 0 or more"),
        ({"level": 1.5}, TypeError, "level must be a whole number"),
        ({"capacity": -5}, esker.QueryError, "the capacity is -5; it must be 0 or more"),
        ({"capacity": "many"}, TypeError, "capacity must be a whole number"),
        ({"view": {"eye": [0, 0, 0]}}, esker.QueryError, "target"),
        ({"view": "nowhere.json"}, esker.QueryError, "nowhere.json"),
        ({"positions": "globe"}, esker.QueryError, "positions"),
        ({"bax": (0, 0, 1, 1)}, TypeError, "bax"),
        ({"polygon": [(0, 0, 1), (1, 0, 1), (1, 1, 1)]}, TypeError, "rows of x and y"),
        ({"polygon": [(0, 0), (1, 1), (1, 0), (0, 1)]}, esker.QueryError, "cross"),
        ({"scans": 1.5}, TypeError, "scans must be names"),
        ({"spacing": "fine"}, TypeError, "spacing must be a number"),
    ],
)
def test_what_makes_no_query(site, keywords, error, message):
    for ask in (site.store.query, site.store.count, site.store.batches, site.store.summary):
        with pytest.raises(error, match=message) as caught:
            list(ask(**keywords))
        if error.__module__ == "esker":
            assert isinstance(caught.value, esker.EskerError) and isinstance(caught.value, ValueError)


def test_a_filter_says_where(site):
    with pytest.raises(esker.FilterError) as caught:
        site.store.query(where="Intensity > 3 and (Red")
    assert caught.value.at == 22 and "^" in str(caught.value)


def test_what_is_no_store(tmp_path):
    with pytest.raises(esker.NotThereError) as caught:
        esker.open(tmp_path / "nowhere.esker")
    assert isinstance(caught.value, FileNotFoundError)
    for content in (b"", b"not a database at all", b"SQLite format 3\0" + bytes(200)):
        (tmp_path / "other.esker").write_bytes(content)
        with pytest.raises(esker.NotAStoreError, match="other.esker"):
            esker.open(tmp_path / "other.esker")
    with pytest.raises(esker.NotAStoreError, match="directory"):
        esker.open(tmp_path)
    with pytest.raises(TypeError):
        esker.open(7)


def test_a_damaged_store_says_so(site, tmp_path):
    copy = tmp_path / "copy.esker"
    shutil.copy(site.path, copy)
    with sqlite3.connect(copy) as database:
        (row,) = database.execute("select max(rowid) from chunk").fetchone()
        database.execute("update chunk set bytes = zeroblob(length(bytes)) where rowid = ?", (row,))
    database.close()
    with esker.open(copy) as store:
        with pytest.raises(esker.DamagedError, match="copy.esker: damaged"):
            store.query()
        report = store.verify()
        assert not report["whole"] and report["findings"]


def test_a_closed_store_is_closed(site):
    store = esker.open(site.path)
    batches = store.batches(1000)
    answer = store.query(capacity=10)
    store.close()
    store.close()
    with pytest.raises(esker.EskerError, match="closed"):
        store.query()
    with pytest.raises(esker.EskerError, match="closed"):
        store.info
    assert "closed" in repr(store) and len(answer.points) == 10
    assert len(next(batches)) == 1000
    batches.close()
    assert list(batches) == []


def test_files_that_can_not_be_read(tmp_path):
    with pytest.raises(esker.NotThereError, match="nowhere.las"):
        esker.ingest(tmp_path / "s.esker", tmp_path / "nowhere.las")
    (tmp_path / "bad.las").write_bytes(b"LASF" + bytes(100))
    with pytest.raises(esker.FormatError, match="bad.las"):
        esker.ingest(tmp_path / "s.esker", tmp_path / "bad.las")
    assert not (tmp_path / "s.esker").exists()
    with pytest.raises(esker.EskerError, match="no model 'cube'"):
        esker.generate("cube", 10, tmp_path / "cube.las")
    with pytest.raises(TypeError):
        esker.ingest(tmp_path / "s.esker", tmp_path / "bad.las", colour="red")


def test_a_store_goes_to_another_process_by_its_name(site):
    with pickle.loads(pickle.dumps(site.store)) as other:
        assert other.count() == site.store.count()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_forked_process_is_told_to_open_its_own(site):
    site.store.count()
    child = os.fork()
    if child == 0:
        try:
            site.store.count()
            os._exit(1)
        except esker.EskerError as error:
            os._exit(0 if "forked" in str(error) else 2)
        except BaseException:
            os._exit(3)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0
