"""Reads stores, from docs/format.md and docs/format-codec.md alone: plain and slow, to compare Esker with.

Written without a look at Esker's code; where that did not suffice, the pages were mended. Sections cited are of docs/format.md.
"""

import pathlib
import sqlite3
import struct
from decimal import Decimal

import numpy as np
import xxhash
from reference_codec import Damaged, Piece, check, column, cut, positions

BIAS = 0x5555_5555_5555
POSITIONS, SCANS, PACKED = 0, 1, 65_535
FOLLOWS = {"Green": ["Red"], "Blue": ["Red", "Green"], "NumberOfReturns": ["ReturnNumber"]}


def checksum(table, values):
    """Section "Checksums"."""
    digest = xxhash.xxh3_64()

    def put(letter, data):
        digest.update(letter + struct.pack("<Q", len(data)) + data)

    put(b"T", table.encode())
    for value in values:
        if value is None:
            put(b"n", b"")
        elif isinstance(value, int):
            put(b"i", struct.pack("<q", value))
        elif isinstance(value, float):
            put(b"r", struct.pack("<d", value))
        elif isinstance(value, str):
            put(b"t", value.encode())
        else:
            put(b"b", value)
    return struct.unpack("<q", struct.pack("<Q", digest.intdigest()))[0]


def check_pieces(pieces, data, blocks):
    """Section "Checksums": of each piece its length, its block and one, and its checksum."""
    piece, at = Piece(pieces), 0
    while piece.at < len(pieces):
        length, block, said = piece.varint(), piece.varint(), piece.integer(8)
        check(block <= len(blocks), "block of a piece")
        check(said == xxhash.xxh3_64_intdigest(data[at : at + length]), "checksum of chunk, a piece")
        at += length
    check(at == len(data), "lengths of pieces")


def read_box(piece):
    return [[piece.integer(6) for _ in range(3)] for _ in range(2)]


def read_step(piece):
    return struct.unpack("<Bb", piece.take(2))


class Node:
    """A row of the table ``node`` (section "node")."""

    def __init__(self, layer, key, head):
        check(len(key) == 19, "length of a node's key")
        self.layer, self.key, self.k = layer, key, 48 - key[18]
        morton = int.from_bytes(key[:18], "big")
        self.corner = [sum((morton >> 3 * bit + axis & 1) << bit for bit in range(48)) for axis in range(3)]
        check(all(low % (1 << self.k) == 0 for low in self.corner), "a cube that is not aligned")
        piece = Piece(head)
        flags, self.children = piece.integer(1), piece.integer(1)
        check(flags < 8, "flags")
        self.leaf = bool(flags & 1)
        self.own, self.subtree, self.nodes = piece.varint(), piece.varint(), piece.varint()
        self.scans = {}
        for _ in range(piece.varint()):
            scan = piece.varint()
            self.scans[scan] = piece.varint(), piece.varint()
        self.bounds = read_box(piece)
        self.own_bounds = read_box(piece) if flags & 2 else None
        self.spacing, *rest = struct.unpack("<11d", piece.take(88))
        self.mean, self.moments, self.radius = rest[:3], rest[3:9], rest[9]
        self.color = struct.unpack("<3H", piece.take(6)) if flags & 4 else None
        self.chunk_base = struct.unpack("<q", piece.take(8))[0]
        self.parts = [Part(piece) for _ in range(piece.varint())]
        piece.end()

    def child_key(self, octant):
        k = self.k - 1
        corner = [low + ((octant >> axis & 1) << k) for axis, low in enumerate(self.corner)]
        morton = sum((low >> bit & 1) << 3 * bit + axis for axis, low in enumerate(corner) for bit in range(48))
        return morton.to_bytes(18, "big") + bytes([48 - k])


class Part:
    """A part, as its node's row says (section "node")."""

    def __init__(self, piece):
        self.points, exponent = piece.varint(), piece.integer(1)
        check(4 <= exponent <= 12, "size of blocks")
        self.blocks = cut(self.points, 1 << exponent)
        self.first_step, self.last_complete_step = read_step(piece), read_step(piece)
        self.rows = {piece.varint(): piece.varint() for _ in range(piece.varint())}
        self.packed = {piece.varint(): piece.varint() for _ in range(piece.varint())}
        self.packed_bytes = piece.varint()


class Store:
    """A store at its newest generation.

    Esker must not have it open in the same process meanwhile: two libraries of SQLite there take each other's locks away.
    """

    def __init__(self, path):
        uri = pathlib.Path(path).absolute().as_uri()
        self.database = sqlite3.connect(uri + "?mode=ro", uri=True)
        if pathlib.Path(f"{path}-wal").exists():
            # Section "Logs and journals of other stores".
            without = sqlite3.connect(uri + "?mode=ro&immutable=1", uri=True)
            marks = "SELECT store_id, log, log_before FROM site"
            here, file = (database.execute(marks).fetchone() for database in (self.database, without))
            without.close()
            check(here[0] == file[0] and file[1] in here[1:], "the log of another store")
        check(self.database.execute("PRAGMA application_id").fetchone() == (0x45736B72,), "application id")
        check(self.database.execute("PRAGMA user_version").fetchone() == (1,), "version")
        self.database.execute("BEGIN")
        (self.site,) = self.rows("site")
        self.scans = {scan["id"]: scan for scan in self.rows("scan")}
        for scan in self.scans.values():
            ids = scan["attributes"]
            scan["attributes"] = [int.from_bytes(ids[i : i + 2], "little") for i in range(0, len(ids), 2)]
        self.attributes = {attribute["id"]: attribute for attribute in self.rows("attribute")}
        self.quantum = [Decimal(word) for word in self.site["quantum"].split(" ")]
        self.phase = [Decimal(word) for word in self.site["phase"].split(" ")]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.database.close()

    def rows(self, table, where="", values=()):
        """Rows as dictionaries, each of which has the checksum that it says."""
        cursor = self.database.execute(f"SELECT * FROM {table} {where}", values)
        names = [item[0] for item in cursor.description]
        for row in cursor:
            row = dict(zip(names, row))
            said = row.pop("checksum")
            hashed = [value for name, value in row.items() if (table, name) != ("chunk", "bytes")]
            check(said == checksum(table, hashed), f"checksum of {table}")
            yield row

    def roots(self):
        """Per layer that is not empty its root's key (section "site")."""
        piece, layer = Piece(self.site["roots"]), 0
        while piece.at < len(piece.data):
            there = piece.integer(1)
            check(there <= 1, "roots")
            if there:
                yield layer, piece.take(19)
            layer += 1

    def nodes(self):
        """All nodes, in pre-order, layer by layer, found from the roots by the names of children."""
        count = 0
        for layer, root in self.roots():
            waiting = [root]
            while waiting:
                rows = list(self.rows("node", "WHERE layer = ? AND key = ?", (layer, waiting.pop())))
                check(len(rows) == 1, "a node that is not there")
                node = Node(layer, rows[0]["key"], rows[0]["head"])
                waiting += [node.child_key(octant) for octant in reversed(range(8)) if node.children >> octant & 1]
                count += 1
                yield node
        check(count == self.site["nodes"], "number of nodes")
        check(self.database.execute("SELECT count(*) FROM node").fetchone() == (count,), "number of node rows")

    def chunk(self, node, number, slot, part, length):
        """A chunk row's bytes (section "chunk")."""
        id = node.chunk_base + number * 65_536 + slot
        rows = list(self.rows("chunk", "WHERE id = ?", (id,)))
        check(len(rows) == 1, "a chunk that is not there")
        expected = {"layer": node.layer, "key": node.key, "part": number, "slot": slot, "points": part.points}
        check(all(rows[0][name] == value for name, value in expected.items()), "a chunk of something else")
        check(len(rows[0]["bytes"]) == length, "length of a chunk")
        check(rows[0]["codec"] == (0 if slot == PACKED else rows[0]["bytes"][0]), "codec of a chunk")
        check_pieces(rows[0]["pieces"], rows[0]["bytes"], part.blocks)
        return rows[0]["bytes"]

    def columns(self, node, number):
        """The bytes of a part's columns, by slot."""
        part = node.parts[number]
        found = {slot: self.chunk(node, number, slot, part, length) for slot, length in part.rows.items()}
        if part.packed:
            piece = Piece(self.chunk(node, number, PACKED, part, part.packed_bytes))
            lengths = {piece.varint(): piece.varint() for _ in range(piece.varint())}
            check(lengths == part.packed and list(lengths) == sorted(lengths), "columns of a packed row")
            found.update({slot: piece.take(length) for slot, length in lengths.items()})
            piece.end()
        return found

    def part(self, node, number):
        """A part's lattice positions (n x 3 int64), scan ids, and values by attribute id."""
        blocks, columns = node.parts[number].blocks, self.columns(node, number)
        places, passes = positions(columns.pop(POSITIONS), blocks, node.k)
        found = {}

        def decoded(slot):
            if slot not in found:
                dtype = "u4"
                leaders = []
                if slot != SCANS:
                    attribute = self.attributes[slot]
                    dtype = dtype_of(attribute)
                    follows = dtype in ("u1", "u2") and is_plain(attribute)
                    for name in FOLLOWS.get(attribute["name"], []) if follows else []:
                        leader = self.id_of(name, attribute["type"])
                        if leader not in columns:
                            break
                        leaders.append(decoded(leader))
                found[slot] = column(columns[slot], dtype, blocks, places, passes, leaders)
            return found[slot]

        for slot in columns:
            decoded(slot)
        scans = found.pop(SCANS)
        check(set(scans.tolist()) <= set(self.scans), "a scan that is not there")
        return places + np.array(node.corner), scans, found

    def id_of(self, name, type):
        """The id of an attribute without scaling and no-data value, or None."""
        plain = filter(is_plain, self.attributes.values())
        return next((a["id"] for a in plain if (a["name"], a["type"]) == (name, type)), None)

    def contents(self):
        """Per node what it holds: for each of its parts what :meth:`part` gives."""
        for node in self.nodes():
            check(sum(part.points for part in node.parts) == node.own, "points of a node's parts")
            yield node, [self.part(node, number) for number in range(len(node.parts))]

    def points(self, contents):
        """The points of these nodes: lattice positions, scan ids, and values by attribute, zero where a scan lacks it."""
        parts = [part for _, parts in contents for part in parts]
        places = np.concatenate([np.zeros((0, 3), np.int64), *(part[0] for part in parts)])
        scans = np.concatenate([np.zeros(0, np.uint32), *(part[1] for part in parts)])
        values = {}
        for id, attribute in self.attributes.items():
            none = np.zeros(0, "<" + dtype_of(attribute))
            columns = [part[2].get(id, np.zeros(len(part[0]), none.dtype)) for part in parts]
            values[id] = np.concatenate([none, *columns])
        return places, scans, values

    def world(self, places):
        """World coordinates: the f64 nearest to ``phase + quantum * (index - BIAS)``."""
        found = np.empty(places.shape)
        for axis in range(3):
            quantum, phase = self.quantum[axis], self.phase[axis]
            digits = max(0, -quantum.as_tuple().exponent, -phase.as_tuple().exponent)
            step, start, unit = int(quantum.scaleb(digits)), int(phase.scaleb(digits)), 10**digits
            # Python divides integers of any size to the nearest float.
            found[:, axis] = [(start + step * (index - BIAS)) / unit for index in places[:, axis].tolist()]
        return found


def is_plain(attribute):
    return attribute["scaling"] is None and attribute["no_data"] is None


def dtype_of(attribute):
    """`u8` is numpy's `u1`."""
    return attribute["type"][0] + str(int(attribute["type"][1:]) // 8)
