"""Python gives the command line's answers: the same points in the same order, with the same bound."""

import io
import json

import numpy as np
import pytest

X, Y, Z = 690_000, 5_330_000, 500

VIEW = {"eye": [X - 30, Y - 30, Z + 60], "target": [X, Y, Z], "size": [640, 480]}

#: A square with a corner on a point's place, and a hole.
WORDS = (
    f"polygon(({X - 9} {Y - 9}, {X + 9} {Y - 9}, {X + 9} {Y + 9}, {X - 9} {Y + 9}, {X - 9} {Y - 9}), "
    f"({X} {Y}, {X + 3} {Y}, {X} {Y + 3}, {X} {Y}))"
)
WKT = WORDS.upper()

#: Arguments of `esker query`, and the keywords that mean the same.
KINDS = [
    ([], {}),
    (["--box", f"{X},{Y},{X + 15.5},{Y + 20}"], {"box": (X, Y, X + 15.5, Y + 20)}),
    (["--box", f"{X},{Y},-inf,{X + 15},{Y + 20},{Z + 12}"], {"box": (X, Y, -np.inf, X + 15, Y + 20, Z + 12)}),
    (["--box", f"{X},{Y},{X + 15},{Y + 20}", "--closed"], {"box": (X, Y, X + 15, Y + 20), "closed": True}),
    (["--sphere", f"{X},{Y},{Z},12.5"], {"sphere": (X, Y, Z, 12.5)}),
    (["--obox", f"{X},{Y},{Z},30,8,100,25"], {"obox": (X, Y, Z, 30, 8, 100, 25)}),
    (["--polygon", WKT, "--z", f"{Z},{Z + 12}"], {"polygon": WKT, "z": (Z, Z + 12)}),
    (["--frustum", "VIEW"], {"frustum": VIEW}),
    (["--region", f"{WORDS} and not sphere({X},{Y},{Z},4)"], {"region": f"{WORDS} and not sphere({X},{Y},{Z},4)"}),
    (["--box", f"{X},{Y},{X + 15},{Y + 20}", "--sphere", f"{X},{Y},{Z},9"], {"box": (X, Y, X + 15, Y + 20), "sphere": (X, Y, Z, 9)}),
    (["--where", "Classification = 2 and Intensity > 100"], {"where": "Classification = 2 and Intensity > 100"}),
    (["--where", "scan = 'site_2' or Z > 502"], {"where": "scan = 'site_2' or Z > 502"}),
    (["--scan", "site_1", "--scan", "3"], {"scans": ["site_1", 3]}),
    (["--max-error", "0.7"], {"max_error": 0.7}),
    (["--spacing", "0.5", "--where", "Classification <> 2"], {"spacing": 0.5, "where": "Classification <> 2"}),
    (["--level", "1"], {"level": 1}),
    (["--capacity", "5k"], {"capacity": 5000}),
    (["--capacity", "5000", "--max-error", "0.2"], {"capacity": 5000, "max_error": 0.2}),
    (["--attributes", "gps_time,Red"], {"attributes": ["gps_time", "Red"]}),
    (["--attributes", "none"], {"attributes": []}),
    (["--view", "VIEW"], {"view": VIEW}),
    (["--view", "VIEW", "--max-error-px", "3", "--capacity", "9000"], {"view": VIEW, "max_error_px": 3, "capacity": 9000}),
    (["--view", "VIEW", "--policy", "distance,amount=2", "--capacity", "9000"], {"view": VIEW, "policy": "distance,amount=2", "capacity": 9000}),
]


@pytest.mark.parametrize("arguments, keywords", KINDS, ids=[" ".join(a) or "everything" for a, _ in KINDS])
def test_every_kind_of_query(site, program, tmp_path, arguments, keywords):
    view = tmp_path / "view.json"
    view.write_text(json.dumps(VIEW))
    arguments = [str(view) if a == "VIEW" else a for a in arguments]
    text, report = program("query", site.path, *arguments, "-o", "-", "--format", "csv", "--json")
    report = json.loads(report.splitlines()[-1])
    names = text[: text.index("\n")].split(",")
    table = np.loadtxt(io.StringIO(text), delimiter=",", skiprows=1, ndmin=2)
    assert len(table) > 0

    answer = site.store.query(**keywords)
    assert len(answer) == len(table) == report["points"] == site.store.count(**keywords)
    assert answer.error_bound == report["error_bound"]
    assert answer.error_bound_px == report["error_bound_px"]
    assert [name.lower() for name in names] == [name.lower() for name in answer.names]
    for i, name in enumerate(answer.names):
        np.testing.assert_array_equal(answer[name], table[:, i], err_msg=name)

    batches = list(site.store.batches(7001, **keywords))
    assert [len(b) for b in batches[:-1]] == [7001] * (len(batches) - 1)
    assert np.array_equal(np.concatenate([b.points for b in batches]), answer.points)


def test_info_scans_and_summary_are_the_command_lines(site, report_of):
    assert site.store.info == report_of("info", site.path)
    assert site.store.scans == report_of("scans", site.path)["scans"]
    ours = site.store.summary(where="Classification = 2")
    theirs = report_of("query", site.path, "--where", "Classification = 2")
    # What it cost depends on what is in memory.
    for word in ("points", "error_bound", "region_misses_site", "attributes"):
        assert ours[word] == theirs[word]
    assert ours.keys() == theirs.keys()


def test_explanations_are_the_command_lines(site, program):
    for arguments, keywords in [
        (["--capacity", "5000"], {"capacity": 5000}),
        (["--where", "Z > 502", "--spacing", "1"], {"where": "Z > 502", "spacing": 1}),
    ]:
        text, _ = program("query", site.path, *arguments, "--explain", "--json")
        ours, theirs = site.store.explain(**keywords), json.loads(text)
        assert ours["nodes"] == theirs["nodes"] and ours["answer"]["points"] == theirs["answer"]["points"]


def test_a_view_file_will_do(site, tmp_path):
    file = tmp_path / "view.json"
    file.write_text(json.dumps(VIEW))
    in_file, here = site.store.query(view=file), site.store.query(view={**VIEW, "eye": np.array(VIEW["eye"])})
    assert len(in_file) == len(here) > 0


def test_digest_and_verify(site, program):
    text, _ = program("digest", site.path)
    assert site.store.digest() == dict(line.split() for line in text.splitlines())
    assert site.store.verify(deep=True)["whole"]
