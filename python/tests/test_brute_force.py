"""Answers are those of a test of every point, in numpy."""

import conftest
import numpy as np
import pytest
from conftest import Site, assert_same_points


def random_regions(site, records, rng, count):
    """Keywords of a region, and which points are inside by the documented test."""
    world = site.world(records)
    for i in range(count):
        # Faces and centres on points, so that ties are met.
        a, b = world[rng.integers(len(world), size=2)]
        low, high = np.minimum(a, b), np.maximum(a, b)
        kind = i % 4
        if kind == 0:
            inside = np.all((world[:, :2] >= low[:2]) & (world[:, :2] < high[:2]), axis=1)
            yield {"box": (*low[:2], *high[:2])}, inside
        elif kind == 1:
            inside = np.all((world >= low) & (world < high), axis=1)
            yield {"box": (*low, *high)}, inside
        elif kind == 2:
            inside = np.all((world >= low) & (world <= high), axis=1)
            yield {"box": (*low, *high), "closed": True}, inside
        else:
            radius = rng.uniform(0, np.linalg.norm(high - low))
            d = world - a
            inside = (d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1]) + d[:, 2] * d[:, 2] <= radius * radius
            yield {"sphere": (*a, radius)}, inside


def random_filter(records, rng):
    """An expression, and the points for which it is true."""
    name = rng.choice(["Intensity", "Classification", "ReturnNumber", "GpsTime"])
    if name not in records.dtype.names:
        name = "Intensity"
    a, b = sorted(rng.choice(records[name], 2))
    a, b = a.item(), b.item()
    values = records[name]
    expressions = [
        (f"{name} >= {a!r}", values >= a),
        (f"{name} = {a!r} or {name} > {b!r}", (values == a) | (values > b)),
        (f"not {name} between {a!r} and {b!r}", ~((values >= a) & (values <= b))),
    ]
    return expressions[rng.integers(len(expressions))]


def check_random_queries(site, seed, count):
    records = site.truth()
    rng = np.random.default_rng(seed)
    for keywords, inside in random_regions(site, records, rng, count):
        if rng.integers(2):
            keywords["where"], matches = random_filter(records, rng)
            inside = inside & matches
        expected = records[inside]
        answer = site.store.query(**keywords, positions="lattice", with_scan=True)
        assert answer.error_bound == 0.0, keywords
        form = answer.points if rng.integers(2) else answer.columns
        assert_same_points(form if isinstance(form, np.ndarray) else answer, expected)
        assert site.store.count(**keywords) == len(expected), keywords


def test_random_regions_and_filters_of_a_site_are_exact(site):
    check_random_queries(site, 11, 60)


@pytest.mark.parametrize(
    "tile",
    [
        "pdal_autzen/autzen-utm.las",
        "pdal_las/simple.laz",
        "pdrf_permutations/pdrf6-1.4.laz",
        "pdrf_permutations/pdrf8-1.4.las",
        "laspy_testdata/plane.laz",
        "pdal_copc/1.2-with-color.copc.laz",
    ],
)
def test_real_tiles_are_what_laspy_reads(data, tmp_path, tile):
    file = data / tile
    if not file.exists():
        pytest.skip(f"{file} is not there")
    site = Site(tmp_path / "tile.esker", [file])
    scan = site.store.scans[0]
    assert scan["positions"] == "exact"
    assert_same_points(site.store.query(positions="lattice", with_scan=True, raw=True), site.truth())
    check_random_queries(site, 5, 12)


def in_ring(ring, x, y):
    """Even-odd; points on edges are left to the caller."""
    inside = np.zeros(len(x), bool)
    for (x0, y0), (x1, y1) in zip(ring, np.roll(ring, -1, axis=0)):
        crosses = (y0 > y) != (y1 > y)
        with np.errstate(divide="ignore", invalid="ignore"):
            inside ^= crosses & (x < (x1 - x0) * (y - y0) / (y1 - y0) + x0)
    return inside


def test_polygons_with_holes(site):
    """Corners halfway between lattice points, so that no point is on an edge."""
    records = site.truth()
    world = site.world(records)
    x, y, z = world.T
    rng = np.random.default_rng(8)
    low, high = site.bounds[:, :2]
    for _ in range(8):
        center = rng.uniform(low, high)
        angles = np.sort(rng.uniform(0, 2 * np.pi, 9))
        radii = rng.uniform(4, 30, 9)
        star = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        outer = np.floor((center + star * radii[:, None]) * 1000) / 1000 + 0.0005
        hole = np.floor((center + star * 0.5) * 1000) / 1000 + 0.0005
        if not in_ring(outer, *hole.T).all() or np.ptp(angles) < 4:
            continue
        inside = in_ring(outer, x, y) & ~in_ring(hole, x, y) & (z >= 500) & (z < 503)
        rings = [[*map(tuple, ring.tolist()), tuple(ring[0].tolist())] for ring in (outer, hole)]
        geojson = {"type": "Polygon", "coordinates": rings}
        wkt = "POLYGON (" + ", ".join("(" + ", ".join(f"{a!r} {b!r}" for a, b in ring) + ")" for ring in rings) + ")"
        shape = type("Shape", (), {"__geo_interface__": geojson})()
        for polygon in (wkt, geojson, shape):
            answer = site.store.query(polygon=polygon, z=(500, 503), positions="lattice", with_scan=True)
            assert_same_points(answer, records[inside])


def test_shapes_that_are_given_together_are_all_meant(site):
    x, y = np.floor(site.bounds[:, :2].mean(axis=0))
    box, sphere = (x - 10, y - 10, x + 10, y + 10), (x + 5, y, 502, 9)
    both = site.store.query(box=box, sphere=sphere, positions="lattice", with_scan=True)
    records = site.truth()
    d = site.world(records) - sphere[:3]
    flat = site.world(records)[:, :2]
    inside = np.all((flat >= (x - 10, y - 10)) & (flat < (x + 10, y + 10)), axis=1)
    inside &= (d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1]) + d[:, 2] * d[:, 2] <= 81
    assert_same_points(both, records[inside])
    words = "box(%s, %s, %s, %s) and sphere(%s, %s, %s, %s)" % (*box, *sphere)
    assert np.array_equal(site.store.query(region=words).points, site.store.query(box=box, sphere=sphere).points)
    without = site.store.query(region=f"not ({words})", positions="lattice", with_scan=True)
    assert_same_points(without, records[~inside])


def test_oriented_boxes_and_frusta(site):
    x, y = np.floor(site.bounds[:, :2].mean(axis=0))
    turned = site.store.query(obox=(x, y, 500, 20, 10, 2000, 30), attributes=[])
    angle = np.radians(30)
    axes = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    ahead, aside = ((turned.xyz[:, :2] - (x, y)) @ axes).T
    assert len(turned) > 100 and np.abs(ahead).max() <= 10.001 and np.abs(aside).max() <= 5.001
    assert np.abs(aside).max() > 4.5 and np.abs(ahead).max() > 9.5
    # An orthographic camera that looks down sees a box; so does the matrix that makes it a cube.
    view = {"eye": [x, y, 700], "target": [x, y, 500], "up": [0, 1, 0], "projection": "orthographic", "height": 20}
    seen = site.store.query(frustum={**view, "size": [100, 100]}, attributes=[])
    clip = np.diag([0.1, 0.1, 0.001, 1.0])
    clip[:3, 3] = -0.1 * x, -0.1 * y, 0.0
    same = site.store.query(frustum=clip, attributes=[])
    flat = site.world(site.truth())[:, :2] - (x, y)
    expected = np.all(np.abs(flat) <= 10, axis=1).sum()
    assert 0 < expected and abs(len(seen) - expected) <= 3 and abs(len(same) - expected) <= 3


def test_world_coordinates_are_the_lattices(site):
    lattice = site.store.query(positions="lattice", attributes=[])
    world = site.store.query(attributes=[])
    steps = np.stack([lattice[axis] for axis in "XYZ"], axis=1)
    # The quantum is a thousandth: the nearest number to the decimal is the quotient.
    np.testing.assert_array_equal(world.xyz, steps / 1000)
    assert world.xyz.dtype == np.float64 and lattice["X"].dtype == np.int64


def test_a_level_is_one_matching_point_per_cell(site):
    records = site.truth()
    ground = records[records["Classification"] == 2]
    world = site.world(ground)
    for max_error in (0.5, 2.0, 8.0):
        answer = site.store.query(max_error=max_error, where="Classification = 2", attributes=[])
        assert answer.error_bound <= max_error
        found = answer.xyz
        assert 0 < len(found) < len(world)
        for point in world[:: len(world) // 500]:
            assert np.linalg.norm(found - point, axis=1).min() <= answer.error_bound


def test_capacities_nest(site):
    sets = []
    for capacity in (10, 1000, 20_000, 1e6):
        answer = site.store.query(capacity=capacity, scans=["site_1", 2], positions="lattice", attributes=["GpsTime"])
        assert len(answer) == min(capacity, 40_000)
        sets.append(set(map(tuple, answer.points.tolist())))
    assert all(small <= large for small, large in zip(sets, sets[1:]))


def test_nearest_neighbours(site):
    world = site.world(site.truth())
    heavy = site.truth()["Intensity"] > 100
    rng = np.random.default_rng(4)
    asked = np.concatenate([world[rng.integers(len(world), size=20)], rng.uniform(*site.bounds, size=(10, 3))])
    for where, among in ((None, world), ("Intensity > 100", world[heavy])):
        found = site.store.nearest(asked, k=5, radius=1.5, where=where, attributes=["Intensity"])
        for i, point in enumerate(asked):
            d = among - point
            distances = np.sort(np.sqrt((d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1]) + d[:, 2] * d[:, 2]))
            mine = slice(found.offsets[i], found.offsets[i + 1])
            expected = distances[:5][distances[:5] <= 1.5]
            np.testing.assert_array_equal(found.distances[mine], expected)
            d = found.xyz[mine] - point
            again = np.sqrt((d[:, 0] * d[:, 0] + d[:, 1] * d[:, 1]) + d[:, 2] * d[:, 2])
            np.testing.assert_array_equal(again, expected)
    assert len(found) and len(found.distances) == len(found) == found.offsets[-1]


def test_density(site):
    world = site.world(site.truth())
    density = site.store.density(2.5, where="Classification = 2")
    x, y, z = world[site.truth()["Classification"] == 2].T
    i = (np.floor(x / 2.5) - density.x0 / 2.5).astype(int)
    j = (np.floor(y / 2.5) - density.y0 / 2.5).astype(int)
    counts = np.zeros_like(density.counts)
    np.add.at(counts, (j, i), 1)
    np.testing.assert_array_equal(density.counts, counts)
    highest = np.full(counts.shape, -np.inf)
    np.maximum.at(highest, (j, i), z)
    np.testing.assert_array_equal(density.highest, np.where(counts > 0, highest, np.nan))


def test_helpers_find_a_difference(site):
    """The comparison itself can fail."""
    expected = site.truth()
    changed = expected.copy()
    changed["Intensity"][7] += 1
    with pytest.raises(AssertionError):
        conftest.assert_same_points(changed, expected)
