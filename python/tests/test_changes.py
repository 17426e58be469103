"""Stores change under those who read them, and tell how far they are."""

import sys
import threading

import esker
import numpy as np
import pytest


@pytest.fixture
def scans(tmp_path):
    return esker.generate("site", 30_000, tmp_path / "scans", scans=3)


def test_cameras_are_kept_and_let_go(tmp_path, scans):
    path = tmp_path / "s.esker"
    esker.ingest(path, scans[:1])
    view = {"eye": [0, 0, 90], "target": [0, 0, 0], "up": [0, 1, 0], "projection": "perspective", "fov_y_deg": 40,
            "size": [640, 480]}
    with esker.open(path) as store:
        assert store.bookmarks == {} and store.keep_bookmark("plan", view) is False
        kept = store.bookmarks["plan"]
        assert kept["projection"] == "perspective" and kept["fov_y_deg"] == pytest.approx(40, rel=1e-12)
        assert store.count(view=kept, max_error_px=1) == store.count(view=view, max_error_px=1)
        other = {**view, "eye": [0, 0, 50]}
        with pytest.raises(esker.ExistsError, match="a bookmark 'plan'.*force=True"):
            store.keep_bookmark("plan", other)
        assert store.keep_bookmark("plan", other, force=True) is True
        assert store.bookmarks["plan"]["eye"] == [0, 0, 50] and store.info["bookmarks"] == ["plan"]
        with pytest.raises(esker.UnknownNameError, match="no bookmark 'gate'; there are: 'plan'"):
            store.remove_bookmark("gate")
        with pytest.raises(esker.QueryError, match="no view"):
            store.keep_bookmark("x", {"eye": [0, 0, 0]})
        with pytest.raises(TypeError, match="view must be"):
            store.keep_bookmark("x", None)
        store.remove_bookmark("plan")
        assert store.bookmarks == {}


def test_names_and_the_crs_can_be_set(tmp_path, scans):
    path = tmp_path / "s.esker"
    esker.ingest(path, scans[:2])
    with esker.open(path) as store:
        assert store.rename("site_1", "roof") == "site_1"
        with pytest.raises(esker.IngestError, match="another scan named 'roof'"):
            store.rename("site_2", "roof")
        assert sorted(scan["name"] for scan in store.scans) == ["roof", "site_2"]
        with pytest.raises(TypeError, match="name must be a string"):
            store.rename("roof", None)
        with pytest.raises(esker.IngestError, match="force=True puts it in its place"):
            store.set_crs("EPSG:25832")
        before = store.set_crs("EPSG:25832", force=True)
        assert "32632" in before and store.info["crs"]["horizontal_epsg"] == 25832
        with pytest.raises(TypeError, match="to_wkt"):
            store.set_crs(25832)
        with pytest.raises(TypeError, match="unexpected keyword"):
            store.set_crs("EPSG:25832", name="x")


def test_answers_follow_the_store_and_snapshots_do_not(tmp_path, scans):
    path = tmp_path / "site.esker"
    esker.ingest(path, scans[0])
    with esker.open(path) as store, store.snapshot() as before:
        batches = store.batches(1000)
        first = next(batches)
        assert store.ingest(scans[1:])["points"] == 20_000
        assert (store.count(), before.count()) == (30_000, 10_000)
        assert (len(store.scans), len(before.scans)) == (3, 1)
        assert store.generation > before.generation
        assert len(first) + sum(len(b) for b in batches) == 10_000
        assert store.remove("site_2")["points"] == 10_000
        assert store.count() == 20_000
        assert store.hide(["site_1", 3]) == ["site_1", "site_3"] and store.count() == 0
        assert store.count(scans="site_1") == 10_000
        assert store.show("site_1") == ["site_1"] and store.show("site_1") == []
        assert store.replace("site_1", scans[1])["points"] == 10_000
        store.compact()
        digest = store.digest()
        store.compact(tmp_path / "copy.esker")
        with esker.open(tmp_path / "copy.esker") as copy:
            assert copy.digest() == digest
        with pytest.raises(esker.UnknownNameError, match="no scan 'site_7'"):
            store.remove("site_7")
        assert before.count() == 10_000


def test_shards_are_merged(tmp_path, scans):
    esker.ingest(tmp_path / "a.esker", scans[0])
    esker.ingest(tmp_path / "b.esker", scans[1:], lattice=tmp_path / "a.esker")
    merged = esker.merge(tmp_path / "ab.esker", [tmp_path / "a.esker", tmp_path / "b.esker"])
    assert merged["points"] == 30_000
    esker.ingest(tmp_path / "all.esker", scans)
    digests = []
    for name in ("ab.esker", "all.esker"):
        with esker.open(tmp_path / name) as store:
            digests.append(store.digest())
    assert digests[0] == digests[1]
    with pytest.raises(esker.ExistsError):
        esker.merge(tmp_path / "ab.esker", [tmp_path / "a.esker"])


def test_options_of_an_ingest(tmp_path, scans):
    pose = np.eye(4)
    pose[:3, 3] = [100, 0, 0]
    report = esker.ingest(
        tmp_path / "s.esker", scans[0], quantum=0.01, crs="EPSG:25832", name="moved", poses=[pose], memory=1 << 28, threads=1
    )
    assert report["scans"][0]["name"] == "moved"
    with esker.open(tmp_path / "s.esker") as store:
        info, scan = store.info, store.scans[0]
    assert info["quantum"] == [0.01] * 3 and info["crs"]["horizontal_epsg"] == 25832
    assert np.array_equal(np.reshape(scan["pose"], (4, 4)), pose)
    (tmp_path / "rows.txt").write_text("1 2 3 40\n5 6 7 80\n")
    esker.ingest(tmp_path / "t.esker", tmp_path / "rows.txt", columns=["x", "z", "y", "intensity"])
    with esker.open(tmp_path / "t.esker") as store:
        assert sorted(store.query()["z"]) == [2.0, 6.0]
    with pytest.raises(esker.IngestError, match="neither EPSG"):
        esker.ingest(tmp_path / "u.esker", scans[0], crs="here")
    with pytest.raises(esker.IngestError, match="poses"):
        esker.ingest(tmp_path / "u.esker", scans[0], poses=[np.eye(4)] * 2)


def test_progress_is_told_and_what_it_raises_stops_the_ingest(tmp_path, large):
    told = []
    esker.ingest(tmp_path / "a.esker", large.files, progress=lambda *what: told.append(what))
    assert {"reading", "building"} & {stage for stage, _, _ in told}
    assert all(done >= 0 and total <= 1_000_000 for _, done, total in told)

    def refuse(stage, done, total):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        esker.ingest(tmp_path / "b.esker", large.files, progress=refuse)
    assert esker.ingest(tmp_path / "b.esker", large.files)["points"] == 1_000_000


def test_what_progress_raises_when_all_is_committed_says_so(tmp_path, scans):
    # The exception alone looked as if nothing had been kept.
    def refuse(stage, done, total):
        raise RuntimeError("enough")

    (tmp_path / "one.xyz").write_text("1 2 3\n")
    # It mostly ends before progress is told for the first time; on a busy machine it may be told, and refused, in time.
    for attempt in range(50):
        path = tmp_path / f"{attempt}.esker"
        with pytest.raises(RuntimeError, match="enough") as raised:
            esker.ingest(path, tmp_path / "one.xyz", progress=refuse)
        committed = 0
        if path.exists():
            with esker.open(path) as store:
                committed = len(store)
        notes = ["esker: the change was complete by then, and is committed"] if committed else []
        if sys.version_info >= (3, 11):
            assert getattr(raised.value, "__notes__", []) == notes
        if committed:
            break
    assert committed == 1


def test_keywords_of_a_change_are_checked_by_name(tmp_path, scans):
    wrong = {
        "threads": (-1, ValueError),
        "memory": (0, ValueError),
        "name": (5, TypeError),
        "columns": ([1.5], TypeError),
        "crs": (25832, TypeError),
        "lattice": (5, TypeError),
        "phase": ([1, 2], ValueError),
        "poses": ([[1, 2, 3]], TypeError),
        "strict": ("no", TypeError),
        "keep_going": ("yes", TypeError),
        "progress": (5, TypeError),
    }
    for word, (value, error) in wrong.items():
        with pytest.raises(error, match=f"^{word} "):
            esker.ingest(tmp_path / "s.esker", scans[0], **{word: value})
    with pytest.raises(TypeError, match="^inputs must be paths, not 5"):
        esker.ingest(tmp_path / "s.esker", 5)
    # They were begun, one after the other, without end.
    with pytest.raises(esker.IngestError, match="1000000 threads are too many"):
        esker.ingest(tmp_path / "s.esker", scans[0], threads=10**6)
    with pytest.raises(esker.IngestError, match="no stores to join"):
        esker.merge(tmp_path / "s.esker", [])
    for word, value in {"points": -1, "seed": -1, "scans": 0}.items():
        keywords = {"points": 5, word: value}
        with pytest.raises(ValueError, match=f"^{word} is {value}"):
            esker.generate("torus", output=tmp_path / "t.las", **keywords)
    (tmp_path / "rows.txt").write_text("7 1 2 3\n8 5 6 7\n")
    esker.ingest(tmp_path / "t.esker", tmp_path / "rows.txt", columns="-,x,z,y")
    with esker.open(tmp_path / "t.esker") as store:
        assert sorted(store.query()["z"]) == [2.0, 6.0]


def test_what_cannot_be_read_is_left_out(tmp_path, scans):
    (tmp_path / "letter.las").write_text("to my aunt")
    inputs = [tmp_path / "letter.las", scans[0]]
    with pytest.raises(esker.EskerError, match="letter.las"):
        esker.ingest(tmp_path / "s.esker", inputs)
    report = esker.ingest(tmp_path / "s.esker", inputs, keep_going=True)
    assert len(report["scans"]) == 1
    ((path, reason),) = [left_out.values() for left_out in report["unreadable"]]
    assert path == str(inputs[0])
    assert "LASF" in reason


def test_a_second_writer_is_refused(tmp_path, large, scans):
    esker.ingest(tmp_path / "a.esker", scans[0])
    refused = []

    def meanwhile(stage, done, total):
        if stage == "building" and not refused:
            with pytest.raises(esker.InUseError, match="being written by this process already"):
                esker.ingest(tmp_path / "a.esker", scans[1])
            with pytest.raises(esker.EskerError, match="can't wait for a change to end"):
                esker.ingest(tmp_path / "a.esker", scans[1], wait=True)
            refused.append(stage)

    esker.ingest(tmp_path / "a.esker", large.files, progress=meanwhile)
    assert refused


def test_a_store_that_was_moved_is_not_begun_anew(scans, tmp_path):
    esker.ingest(tmp_path / "s.esker", scans[0])
    with esker.open(tmp_path / "s.esker") as store:
        (tmp_path / "s.esker").rename(tmp_path / "moved.esker")
        for change in (lambda: store.ingest(scans[1]), lambda: store.compact()):
            with pytest.raises(esker.EskerError, match="not the store any more that was opened"):
                change()
    assert not (tmp_path / "s.esker").exists()


def test_thirty_two_threads_on_one_store(tmp_path, site, large):
    """Every answer is that of one thread alone, while a scan is added to another store and the interpreter goes on."""
    x, y = site.bounds[:, :2].mean(axis=0)
    questions = [
        {"box": (x, y, x + 10, y + 10)},
        {"sphere": (x, y, 502, 8), "attributes": ["Intensity"]},
        {"where": "Classification = 2", "max_error": 0.4},
        {"capacity": 5000, "positions": "lattice"},
        {"scans": "site_2", "masked": True},
    ]
    alone = [site.store.query(**q).points for q in questions]
    wrong = []

    def ask(i):
        for round in range(5):
            which = (i + round) % len(questions)
            answer = site.store.query(**questions[which])
            if not np.array_equal(answer.points, alone[which]):
                wrong.append(which)
            if sum(len(b) for b in site.store.batches(3000, **questions[which])) != len(alone[which]):
                wrong.append(which)

    threads = [threading.Thread(target=ask, args=(i,)) for i in range(32)]
    adding = threading.Thread(target=esker.ingest, args=(tmp_path / "other.esker", large.files))
    for thread in [adding, *threads]:
        thread.start()
    for thread in [adding, *threads]:
        thread.join()
    assert not wrong


def test_readers_see_whole_generations_while_scans_come_and_go(tmp_path, scans):
    path = tmp_path / "site.esker"
    esker.ingest(path, scans[0])
    seen, done = [], threading.Event()
    with esker.open(path) as store:

        def read():
            while not done.is_set():
                seen.append(len(store.query(attributes=[])))

        readers = [threading.Thread(target=read) for _ in range(4)]
        for reader in readers:
            reader.start()
        for _ in range(3):
            store.ingest(scans[1:])
            store.remove(["site_2", "site_3"])
        done.set()
        for reader in readers:
            reader.join()
    assert seen and set(seen) <= {10_000, 30_000}
