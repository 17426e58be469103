"""Esker's answers are what a reader gets that was written from the documents of the store file alone."""

import shutil
import sqlite3

import esker
import laspy
import numpy as np
import pytest
import xxhash
from reference_codec import MET, Damaged
from reference_reader import Store, checksum
from reference_tree import assert_is_the_tree_of_its_points

#: Of docs/format-codec.md: every packing, kind, way and unit.
ALL_RULES = {
    *(("packing", n) for n in range(3)),
    *(("keys", width) for width in ("narrow", "wide")),
    *(("kind", n) for n in range(8)),
    *(("numbers", n) for n in range(4)),
    *(("indices", n) for n in range(3)),
    *(("joint", leaders, n) for leaders in (1, 2) for n in range(2)),
    *(("lines", pulse) for pulse in ("one tick a pulse", "many ticks a pulse")),
    *(("lines", tick) for tick in ("one number a tick", "many numbers a tick")),
    "one value",
}


def rows(columns):
    """The bytes of each point, in an order of their own: equal lists are equal multisets of points, bit for bit."""
    if len(columns[0]) == 0:
        return []
    octets = [np.ascontiguousarray(c).view(np.uint8).reshape(len(c), -1) for c in columns]
    return sorted(row.tobytes() for row in np.concatenate(octets, axis=1))


def names_of(attributes):
    """What Esker calls attributes in an answer, by id: with the type where it is not the only one, and numbered."""
    types = ["u8", "i8", "u16", "i16", "u32", "i32", "u64", "i64", "f32", "f64"]

    def order(attribute):
        scaling = np.frombuffer(attribute["scaling"] or b"", "<u8").tolist()
        return attribute["name"].encode(), types.index(attribute["type"]), scaling, attribute["no_data"] or b""

    names, all_names = {}, [attribute["name"] for attribute in attributes.values()]
    for id, attribute in sorted(attributes.items(), key=lambda item: order(item[1])):
        plain = attribute["name"]
        if all_names.count(plain) > 1:
            plain += f":{attribute['type']}"
        numbered = (f"{plain}.{number}" for number in range(2, 1000))
        names[id] = next(name for name in [plain, *numbered] if name not in names.values())
    return names


def check_store(path):
    """Every point of the store, with all its attributes, and the tree that the points are in."""
    with Store(path) as reader:
        contents = list(reader.contents())
    places, scans, values = reader.points(contents)
    name_of = names_of(reader.attributes)
    with esker.open(path) as store:
        answer = store.query(positions="lattice", with_scan=True, raw=True)
        world = store.query(attributes=[]).xyz
    found, expected = [scans], [np.asarray(answer["scan"]).astype(scans.dtype)]
    for axis in range(3):
        found.append(places[:, axis] - 0x5555_5555_5555)
        expected.append(np.asarray(answer["XYZ"[axis]]).astype(np.int64))
    for id in reader.attributes:
        found.append(values[id])
        expected.append(np.asarray(answer.columns[name_of[id]]))
        assert found[-1].dtype == expected[-1].dtype
    assert set(answer.points.dtype.names) == {"X", "Y", "Z", "scan", *name_of.values()}
    assert rows(found) == rows(expected)
    assert rows([reader.world(places)]) == rows([world])
    for layer in {node.layer for node, _ in contents}:
        nodes = [(node, [part[0] for part in parts]) for node, parts in contents if node.layer == layer]
        assert_is_the_tree_of_its_points(nodes, reader.site["g"], reader.site["leaf_capacity"])
    return reader


def write_ply(path, **columns):
    """A binary PLY file of these columns."""
    words = dict(f4="float", f8="double", u1="uchar", i1="char", u2="ushort", i2="short", u4="uint", i4="int")
    records = np.rec.fromarrays(list(columns.values()), names=list(columns))
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(records)}"]
    lines += [f"property {words[column.dtype.str[1:]]} {name}" for name, column in columns.items()]
    path.write_bytes("\n".join([*lines, "end_header", ""]).encode() + records.tobytes())
    return path


def surface(rng, points, side=100.0):
    x, y = rng.uniform(0, side, (2, points))
    return {"x": x, "y": y, "z": np.sin(x / 9) * 4}


def terrain(tmp_path, rng):
    """An airborne survey: times and angles follow from where its points are, colours and returns from each other."""
    return [esker.generate("terrain", 25_000, tmp_path / "terrain.las")]


def changed(tmp_path, rng):
    """Scans that were removed and replaced, of which one has attributes of its own."""
    files = esker.generate("site", 12_000, tmp_path / "scans", scans=3)
    other = write_ply(tmp_path / "other.ply", **surface(rng, 3000), roughness=rng.normal(size=3000).astype("f4"))

    def change(store):
        store.remove("site_2")
        store.replace("site_3", other)
        store.hide("site_1")
        store.show("site_1")

    return [files, change]


def layers(tmp_path, rng):
    """A thin scan all over a dense one is a layer of its own; the dense one fills an inner node below the root."""
    x, y, z = rng.uniform(0, 12, (3, 80_000)) + [[40], [30], [20]]
    x[0] = 0
    many = write_ply(tmp_path / "many.ply", x=x, y=y, z=z)
    few = write_ply(tmp_path / "few.ply", x=x[1::200], y=y[1::200] + 1e-3, z=z[1::200], i=np.arange(400, dtype="i2"))
    return [many, few]


def bits(tmp_path, rng):
    """Any bits in values of all types, in a cube of the lattice's whole width; repeated positions."""
    points = 9000
    place = rng.uniform(-9.3e10, 1.87e11, (3, points))
    place[:, :2000] = place[:, :1]

    def noise(dtype):
        return rng.integers(0, 256, points * np.dtype(dtype).itemsize, dtype=np.uint8).view(dtype)

    columns = {name: noise(dtype) for name, dtype in zip("abcdefgh", ["u1", "i1", "u2", "i2", "u4", "i4", "f4", "f8"])}
    columns["special"] = np.resize(np.array([np.nan, -0.0, 0.0, np.inf, -np.inf, 1e-320]), points)
    columns["sawtooth"] = (np.arange(points) % 251).astype("u1")
    return [write_ply(tmp_path / "bits.ply", x=place[0], y=place[1], z=place[2], **columns)]


def colors(tmp_path, rng):
    """Colours of 8 and of 16 bits under the same names, and some without the colours that they would follow."""
    points = 6000
    shade = rng.integers(0, 200, points)
    red, green, blue = shade, shade + rng.integers(0, 9, points), shade // 2 + rng.integers(0, 5, points)
    eight = {"red": red.astype("u1"), "green": green.astype("u1"), "blue": blue.astype("u1")}
    two = {"green": eight["green"], "blue": eight["blue"]}
    noise = rng.integers(0, 2000, (2, points))
    green, blue = red * 300 + noise[0], red * 290 + noise[1]
    sixteen = {"red": (red * 257).astype("u2"), "green": green.astype("u2"), "blue": blue.astype("u2")}
    steep = {"red": eight["red"], "blue": (shade * 7 % 256).astype("u1")}
    files = {"eight": eight, "sixteen": sixteen, "two": two, "steep": steep}
    return [[write_ply(tmp_path / f"{name}.ply", **surface(rng, points), **c) for name, c in files.items()]]


def kinds(tmp_path, rng):
    """Extra bytes of one name and type that mean something else in each scan; one of these scans is removed."""
    files = []
    for i, options in enumerate([{}, {"scales": [0.1]}, {"scales": [0.01]}, {"no_data": 7}]):
        header = laspy.LasHeader(version="1.4", point_format=6)
        full = {key: np.array(value, "i2" if key == "no_data" else "f8").reshape(1) for key, value in options.items()}
        if "scales" in full:
            full["offsets"] = np.zeros(1)
        header.add_extra_dims([laspy.ExtraBytesParams(name="height", type="i2", **full)])
        las = laspy.LasData(header)
        place = surface(rng, 700)
        las.x, las.y, las.z = place["x"], place["y"], place["z"]
        las.points.array["height"] = rng.integers(-9, 9, 700)
        las.write(tmp_path / f"kind{i}.las")
        files.append(tmp_path / f"kind{i}.las")
    return [files[:2], lambda store: store.remove("kind0"), files[2:]]


def one_point(tmp_path, rng):
    one = np.array([1.5])
    return [write_ply(tmp_path / "one.ply", x=one, y=one, z=-one, f=np.array([np.nan], "f4"))]


def few(tmp_path, rng):
    """Little of most: each byte of the store weighs."""
    points, shade = 500, np.arange(500) % 90
    channels = {name: (shade + 3 * i).astype("u1") for i, name in enumerate(["red", "green", "blue"])}
    files = esker.generate("terrain", 1000, tmp_path / "terrain.las")
    return [[*files, write_ply(tmp_path / "a.ply", **surface(rng, points), **channels, f=rng.normal(size=points))]]


GENERATED = [terrain, changed, layers, bits, colors, few, kinds, one_point]


@pytest.fixture(scope="session")
def generated(tmp_path_factory):
    """Makes, once, a store of what a function above gives: files to ingest one after the other, and changes."""
    made = {}

    def store_of(steps_of):
        if steps_of not in made:
            folder = tmp_path_factory.mktemp(steps_of.__name__)
            for step in steps_of(folder, np.random.default_rng(5)):
                if callable(step):
                    with esker.open(folder / "a.esker") as store:
                        step(store)
                else:
                    esker.ingest(folder / "a.esker", step)
            made[steps_of] = folder / "a.esker"
        return made[steps_of]

    return store_of


@pytest.fixture(scope="session")
def checked(generated):
    """Checks, once, such a store: its layers, and the rules that it took to read it."""
    found = {}

    def check(steps_of):
        if steps_of not in found:
            MET.clear()
            found[steps_of] = len(list(check_store(generated(steps_of)).roots())), set(MET)
        return found[steps_of]

    return check


@pytest.mark.parametrize("steps_of", GENERATED)
def test_a_reader_of_the_documents_gets_the_same_points(checked, steps_of):
    assert checked(steps_of)[0] == (2 if steps_of is layers else 1)


def test_every_rule_of_the_codec_was_needed(checked):
    met = set().union(*(checked(steps_of)[1] for steps_of in GENERATED))
    assert met == ALL_RULES


@pytest.mark.parametrize(
    "tile",
    [
        "pdal_las/extrabytes.las",
        "pdrf_permutations/pdrf8-1.4.las",
        "pdal_las/simple.laz",
        "odd_las/1.2-empty-geotiff-vlrs.las",
        "ign_tiles/crop_duplicate.laz",
        "cryinc_e57/tiny_pc_with_extension.e57",
        "cryinc_e57/tinyCartesianFloatRgb.e57",
        "pdal_pts_ptx/multiple-and-transform.ptx",
        "pdal_pts_ptx/test.pts",
        "trimesh_ply_xyz/points_cloudcompare.xyz",
    ],
)
def test_real_tiles_are_read_by_the_documents(data, tmp_path, tile):
    if not (data / tile).exists():
        pytest.skip(f"{tile} is not there")
    esker.ingest(tmp_path / "a.esker", data / tile)
    check_store(tmp_path / "a.esker")


@pytest.fixture
def copy(generated, tmp_path):
    """A store whose rows can be changed."""

    def copy_of(steps_of):
        return shutil.copy(generated(steps_of), tmp_path / "copy.esker")

    return copy_of


def read_all(path):
    with Store(path) as reader:
        places, scans, values = reader.points(list(reader.contents()))
    return rows([places, scans, *values.values()])


@pytest.mark.parametrize("table, column", [("site", "roots"), ("scan", "pose"), ("node", "head"), ("chunk", "bytes")])
def test_a_flipped_byte_is_found_by_the_checksum_of_its_row(copy, table, column):
    path = copy(few)
    with sqlite3.connect(path) as database:
        (data,) = database.execute(f"SELECT {column} FROM {table}").fetchone()
        changed = data[:-1] + bytes([data[-1] ^ 1])
        database.execute(f"UPDATE {table} SET {column} = ? WHERE {column} = ?", (changed, data))
    with pytest.raises(Damaged, match=f"checksum of {table}"):
        read_all(path)


def varint(number):
    return bytes([number]) if number < 128 else bytes([number & 127 | 128]) + varint(number >> 7)


def test_every_byte_of_a_chunk_counts(copy):
    """Changed ones, under a checksum that fits, are an error or other points."""
    path, rng = copy(few), np.random.default_rng(9)
    expected = read_all(path)
    database = sqlite3.connect(path)
    chunks = database.execute("SELECT id, layer, key, part, slot, points, codec, bytes FROM chunk").fetchall()

    def put(row):
        *others, data = row
        # One piece, which is needed with any block.
        pieces = varint(len(data)) + bytes([0]) + xxhash.xxh3_64_intdigest(data).to_bytes(8, "little")
        values = data, pieces, checksum("chunk", [*others, pieces]), row[0]
        database.execute("UPDATE chunk SET bytes = ?, pieces = ?, checksum = ? WHERE id = ?", values)
        database.commit()

    refused = 0
    for _ in range(40):
        row = chunks[rng.integers(len(chunks))]
        at, data = rng.integers(len(row[-1])), row[-1]
        put((*row[:-1], data[:at] + bytes([data[at] ^ 1 << rng.integers(8)]) + data[at + 1 :]))
        try:
            assert read_all(path) != expected
        except Damaged:
            refused += 1
        put(row)
    assert read_all(path) == expected and 0 < refused < 40
