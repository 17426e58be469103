"""Work can be interrupted, lets other threads run, and takes the memory that it says."""

import subprocess
import sys
import textwrap
import threading
import time

import esker
import esker._arguments
import pytest

#: Prints how long the work took when nobody interrupted it and when Ctrl-C came early on.
INTERRUPTED = """
    import os, signal, sys, threading, time
    import esker
    # Started in the background by a shell, Python would ignore Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    def timed(work):
        begun = time.perf_counter()
        try:
            work()
            ended = "ended"
        except KeyboardInterrupt:
            ended = "interrupted"
        return ended, time.perf_counter() - begun
    def interrupt(work, after):
        timer = threading.Timer(after, lambda: os.kill(os.getpid(), signal.SIGINT))
        timer.start()
        result = timed(work)
        try:
            # The signal of a timer that was too late.
            timer.join()
            time.sleep(0.01)
        except KeyboardInterrupt:
            pass
        return result
"""


def run(script, *arguments):
    script = textwrap.dedent(INTERRUPTED) + textwrap.dedent(script)
    done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return eval(done.stdout)


@pytest.mark.parametrize("work", ["store.query()", "[store.summary() for _ in range(4)]", "list(store.batches(10_000))"])
def test_ctrl_c_interrupts_a_query(large, work):
    """And the store can be asked again."""
    script = f"""
        # Without a cache: signals are looked for every 20 ms.
        store = esker.open(sys.argv[1], cache=0)
        work = lambda: {work}
        timed(work)
        _, alone = timed(work)
        tries = [interrupt(work, alone / 5) for _ in range(4)]
        print((min(took for ended, took in tries if ended == "interrupted"), alone, store.count()))
    """
    took, alone, count = run(script, large.path)
    # Were it not interrupted, Ctrl-C would come after its end.
    assert count == 1_000_000 and took < 0.8 * alone, (took, alone)


#: Calls that take long, after what they need.
LONG = {
    "verify": ("", "store.verify()"),
    "verify deeply": ("", "store.verify(deep=True)"),
    "digest": ("", "store.digest()"),
    "density": ("", "store.density(0.2, where='Z > 0')"),
    "nearest": ("places = store.query(attributes=[], capacity=5000).xyz", "store.nearest(places, k=8)"),
    "compact": ("", "[store.compact(f'{sys.argv[2]}/{next(number)}.esker') for _ in range(8)]"),
    "export": ("", "store.export(f'{sys.argv[2]}/{next(number)}.laz')"),
    "export in parts": ("", "store.export(f'{sys.argv[2]}/{next(number)}.las', split_by='class')"),
}


@pytest.mark.parametrize("setup, work", LONG.values(), ids=LONG.keys())
def test_ctrl_c_interrupts_whatever_takes_long(large, tmp_path, setup, work):
    """Soon, and leaves nothing behind."""
    script = f"""
        import itertools
        number = itertools.count()
        store = esker.open(sys.argv[1])
        {setup}
        work = lambda: {work}
        timed(work)
        _, alone = timed(work)
        tries = []
        for _ in range(4):
            before = set(os.listdir(sys.argv[2]))
            ended, took = interrupt(work, alone / 5)
            if ended == "interrupted":
                tries.append(took)
                left = set(os.listdir(sys.argv[2])) - before
                # Stores that were done when Ctrl-C came are whole; of all that was under way nothing is left.
                whole = lambda name: esker.open(f"{{sys.argv[2]}}/{{name}}").count() == 1_000_000
                assert all(name.endswith(".esker") and whole(name) for name in left), left
        print((min(tries), alone, store.count()))
    """
    took, alone, count = run(script, large.path, str(tmp_path))
    assert count == 1_000_000 and took < 0.8 * alone, (took, alone)


def test_ctrl_c_leaves_a_store_at_its_last_commit(large, site, tmp_path):
    path = tmp_path / "site.esker"
    esker.ingest(path, site.files)
    script = """
        ended, _ = interrupt(lambda: esker.ingest(sys.argv[1], sys.argv[2:]), 0.1)
        with esker.open(sys.argv[1]) as store:
            print((ended, store.count(), len(store.scans)))
    """
    assert run(script, str(path), *large.files) == ("interrupted", 60_000, 3)
    with esker.open(path) as store:
        assert store.verify()["whole"]
        # Nothing is left locked.
        assert store.ingest(large.files)["points"] == 1_000_000


def test_other_threads_run_while_a_query_does(large):
    ticks, done = [], threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.perf_counter())
            time.sleep(0.001)

    thread = threading.Thread(target=tick)
    thread.start()
    begun = time.perf_counter()
    # One call from beginning to end.
    large.store._reader.query(esker._arguments.query({}))
    ended = time.perf_counter()
    done.set()
    thread.join()
    # The thread that waits wakes up some fifty times a second; were the lock held, this one would never.
    assert sum(begun < t < ended for t in ticks) >= 10 * (ended - begun), (len(ticks), ended - begun)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_batches_take_the_memory_of_a_batch(large):
    """Beside the store's caches, which both fill alike."""
    script = """
        import re
        peak = lambda: int(re.search(r"VmHWM:\\s*(\\d+) kB", open("/proc/self/status").read()).group(1)) / 1024
        store = esker.open(sys.argv[1])
        store.query(capacity=1000).points
        before = peak()
        if sys.argv[2] == "batches":
            points = sum(len(batch.points) for batch in store.batches(50_000))
        else:
            points = len(store.query().points)
        print((points, peak() - before))
    """
    (few, batches_mib), (all, query_mib) = run(script, large.path, "batches"), run(script, large.path, "query")
    assert few == all == 1_000_000
    answer_mib = large.store.query(capacity=1).dtype.itemsize * few / 2**20
    # The answer has its points twice for a while, decoded and as an array; batches that are gone have neither.
    assert batches_mib < query_mib - 1.2 * answer_mib, (batches_mib, query_mib, answer_mib)
