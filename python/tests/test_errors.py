"""Errors are exceptions by what a caller can do, with the library's messages."""

import os
import pickle
import select
import shutil
import signal
import sqlite3
import subprocess
import sys

import esker
import numpy as np
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
        ({"raw": "no"}, TypeError, "raw must be True or False"),
        ({"max_error_px": 2}, esker.QueryError, "max_error_px says where a view stops"),
        ({"polygon": [(0, 0), (float("nan"), 0), (9, 9)]}, esker.QueryError, "polygon has a number that is NaN or infinite"),
        ({"frustum": np.full((4, 4), np.inf)}, esker.QueryError, "frustum has a number that is NaN or infinite"),
        ({"frustum": 5}, TypeError, "frustum must be a view or the rows of a clip matrix"),
        ({"view": {"eye": [0, 0, float("nan")]}}, esker.QueryError, "view has a number that is NaN or infinite"),
        ({"attributes": b"Intensity"}, TypeError, "attributes must be names"),
        ({"z": (500, None)}, TypeError, "z must be numbers"),
        ({"box": ((0, 1), (0, 1), (0, 1))}, esker.QueryError, "a low and a high corner as two rows"),
        ({"sphere": [[1, 2], [3, 4]]}, esker.QueryError, "sphere is one row of numbers"),
        ({"view": "/"}, esker.QueryError, "/: reading the view failed: Is a directory"),
        ({"view": {"eye": object()}}, TypeError, "view has <object"),
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


def test_what_stays_in_its_process_says_so(site):
    for what in (site.store.snapshot(), site.store.batches()):
        with what, pytest.raises(TypeError, match="can be pickled"):
            pickle.dumps(what)


def test_files_that_can_not_be_written(site, tmp_path):
    with pytest.raises(esker.NotThereError, match="the folder .*nowhere does not exist"):
        site.store.export(tmp_path / "nowhere" / "a.las", capacity=10)
    if sys.platform == "linux":
        with pytest.raises(esker.ReadOnlyError, match="creating failed"):
            site.store.export("/sys/a.las", capacity=10)


def in_a_forked_process(work):
    """What ``work`` comes to: "done", or what it raises; "it hangs" after some seconds."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            signal.alarm(20)
            work()
            os.write(write, b"done")
        except BaseException as error:
            os.write(write, repr(error).encode())
        finally:
            os._exit(0)
    os.close(write)
    os.waitpid(child, 0)
    with os.fdopen(read) as said:
        return said.read() or "it hangs"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_forked_process_is_told_that_it_has_no_threads(site):
    path, answer = site.store.path, site.store.query()

    def of_its_own(ask):
        with esker.open(path) as own:
            ask(own)

    works = {
        "its parent's store": site.store.count,
        "a store of its own": lambda: of_its_own(lambda own: own.count()),
        "points": lambda: of_its_own(lambda own: own.query()),
        "batches": lambda: of_its_own(lambda own: list(own.batches())),
        "verify": lambda: of_its_own(lambda own: own.verify()),
        "an answer's arrays": lambda: answer.columns,
        "an answer's records": lambda: answer.points,
    }
    for what, work in works.items():
        assert "forked" in in_a_forked_process(work), what


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_forked_process_whose_parent_only_opened_a_store_works(site):
    script = f"""
import esker, os
store = esker.open({str(site.store.path)!r})
store.scans
child = os.fork()
if child == 0:
    with esker.open(store.path) as own:
        os._exit(0 if own.count() == {site.store.count()} and len(own.query()) > 0 else 1)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), store.count())
"""
    said = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert said.stdout.split() == ["0", str(site.store.count())]


def test_an_int_is_a_scans_number_though_another_is_called_so(tmp_path):
    for name in ("1", "10", "2", "3"):
        points = "\n".join(f"{name} {i} 0" for i in range(int(name)))
        (tmp_path / f"{name}.xyz").write_text(f"{points}\n{name} -1 0\n")
    files = [tmp_path / f"{name}.xyz" for name in ("1", "10", "2", "3")]
    esker.ingest(tmp_path / "s.esker", files)
    with esker.open(tmp_path / "s.esker") as store:
        numbers = {scan["name"]: scan["id"] for scan in store.scans}
        assert numbers["2"] != 2 and numbers["10"] == 2
        assert store.count(scans=2) == store.count(scans=np.int64(2)) == store.count(scans=[2]) == 11
        assert store.count(scans="2") == 3
        assert store.count(scans=["2", 2]) == 14
        with pytest.raises(esker.QueryError, match="no scan number 10; there are 1, 2, 3, 4"):
            store.count(scans=10)
        assert store.hide(2) == ["10"] and store.show([2]) == ["10"]
        store.remove(2)
        assert sorted(scan["name"] for scan in store.scans) == ["1", "2", "3"]


def test_a_closed_store_is_not_changed(site, tmp_path):
    esker.ingest(tmp_path / "s.esker", site.files[0])
    store = esker.open(tmp_path / "s.esker")
    store.close()
    for change in (lambda: store.ingest(site.files[1]), lambda: store.remove("site_1"), store.compact, store.digest):
        with pytest.raises(esker.EskerError, match="closed"):
            change()


def test_keywords_that_would_do_nothing_are_refused(site, tmp_path):
    store = esker.open(shutil.copy(site.path, tmp_path / "copy.esker"))
    for change, keywords in [
        (lambda **k: store.hide("site_1", **k), {"quantum": 5}),
        (lambda **k: store.show("site_1", **k), {"strict": True}),
        (lambda **k: store.remove("site_1", **k), {"name": "x"}),
        (lambda **k: store.replace("site_1", **k), {"recursive": True}),
        (store.compact, {"crs": "EPSG:32632"}),
        (store.digest, {"keep_going": True}),
        (lambda **k: esker.merge(tmp_path / "m.esker", [site.path], **k), {"phase": 0.5}),
        (lambda **k: store.ingest([], **k), {"foo": 1}),
    ]:
        with pytest.raises(TypeError, match=f"unexpected keyword argument '{next(iter(keywords))}'"):
            change(**keywords)
    for change in (store.hide, store.show, store.remove):
        with pytest.raises(TypeError, match="scans must be names, not None"):
            change(None)
    assert len(store.scans) == 3 and not (tmp_path / "m.esker").exists()


def test_messages_name_what_the_package_has(site, tmp_path):
    store = esker.open(shutil.copy(site.path, tmp_path / "copy.esker"))
    (tmp_path / "empty").mkdir()
    for change, message in [
        (lambda: store.ingest(tmp_path / "empty"), "recursive=True looks into folders below"),
        (lambda: store.ingest(site.files, quantum=0.5), "quantum, phase and lattice apply"),
        (lambda: store.ingest(site.files[:1], name=" "), "name can't be empty"),
        (lambda: store.hide("site_9"), "store.scans lists them"),
    ]:
        with pytest.raises(esker.EskerError) as caught:
            change()
        assert message in str(caught.value) and "--" not in str(caught.value)


def test_regions_that_hold_nothing_are_told(site):
    for ask in (site.store.query, site.store.count, site.store.summary):
        with pytest.warns(esker.EskerWarning, match="outside the site") as caught:
            ask(box=(0, 0, 1, 1))
        assert caught[0].filename == __file__


def test_paths_that_are_no_text(site, tmp_path):
    path = os.fsdecode(os.path.join(os.fsencode(tmp_path), b"e\xff.las"))
    report = site.store.export(path, capacity=3)
    assert os.path.exists(path) and [part["points"] for part in report["outputs"]] == [3]


def test_a_forked_process_is_told_at_once(site):
    """It waited for threads that had not come along, or for a lock that one of them held."""
    store = esker.open(site.path)
    batches = store.batches(1000)
    next(batches)
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        told = []
        for ask in (lambda: next(batches), lambda: store.closed, lambda: store.count()):
            try:
                ask()
            except esker.EskerError as error:
                told.append("forked" in str(error))
        batches.close()
        store.close()
        told.append("forked" in repr(store))
        os.write(writing, b"y" if told == [True] * 4 else repr(told).encode())
        os._exit(0)
    os.close(writing)
    # A minute is long enough for what should come at once.
    there, _, _ = select.select([reading], [], [], 60)
    if not there:
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    assert there and os.read(reading, 1000) == b"y"
    os.close(reading)
