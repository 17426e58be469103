"""How long points take to numpy, warm: `python bench/query.py STORE`, with a wheel that was built with --release.

Asks for boxes about the middle of the site until one has some million points, then times it in each form.
"""

import statistics
import sys
import time

import esker

RUNS = 15


def timed(work):
    times = []
    for _ in range(RUNS):
        begun = time.perf_counter()
        work()
        times.append((time.perf_counter() - begun) * 1e3)
    return f"median {statistics.median(times):6.1f} ms, least {min(times):6.1f}, most {max(times):6.1f}"


def main(path, wanted=1_000_000):
    with esker.open(path) as store:
        bounds = store.info["bounds"]
        low, high = bounds["min"], bounds["max"]

        def box(part):
            middle = [(a + b) / 2 for a, b in zip(low, high)]
            half = [(b - a) / 2 * part for a, b in zip(low, high)]
            return [m + sign * h for sign in (-1, 1) for m, h in list(zip(middle, half))[:2]]

        few, many = 0.0, 1.0
        for _ in range(30):
            part = (few + many) / 2
            if store.count(box=box(part)) > wanted:
                many = part
            else:
                few = part
        here = {"box": box(few)}
        print(f"{store.count(**here):,} of {store.info['points']:,} points, {RUNS} runs")
        print("count                   ", timed(lambda: store.count(**here)))
        for name, attributes in (("positions", []), ("positions and RGB", ["Red", "Green", "Blue"]), ("all", None)):
            for form in ("columns", "points"):
                work = lambda: getattr(store.query(**here, attributes=attributes), form)
                print(f"{name:17} {form:7}", timed(work))


if __name__ == "__main__":
    main(*sys.argv[1:2])
