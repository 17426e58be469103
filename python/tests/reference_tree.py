"""Which node holds a point, and of which step it is: the definitions of docs/octree.md, whose sections are cited."""

import numpy as np

M = 0x5555_5555_5555


def keys_of(places):
    """Section 1: digits of three bits, of which each is a bit of x, y and z XOR M."""
    octets = np.ascontiguousarray((places ^ M).astype("<u8")).view(np.uint8).reshape(len(places), 3, 8)
    bits = np.unpackbits(octets, axis=2, bitorder="little")[:, :, :48].transpose(0, 2, 1).reshape(len(places), 144)
    return [int.from_bytes(row.tobytes(), "little") for row in np.packbits(bits, axis=1, bitorder="little")]


def exponent(a, b):
    """Of the smallest aligned cube that holds both keys."""
    return ((a ^ b).bit_length() + 2) // 3


def wins_of(keys, k):
    """Section 1: the exponent of the largest cell that each point wins, in a tree whose root has exponent ``k``."""
    return [k] + [exponent(a, b) - 1 for a, b in zip(keys, keys[1:])]


def steps_of(keys, wins):
    """Section 7: win and group of each point, as a pair that ascends from coarse to fine."""
    found, ranks = [], {}
    for i, (key, win) in enumerate(zip(keys, wins)):
        group = 1
        if win >= 0 and i > 0:
            cell = win, key >> 3 * (win + 1)
            ranks[cell] = ranks.get(cell, 0) + 1
            group = 1 if ranks[cell] == 1 else 2 if ranks[cell] <= 4 else 3
        found.append((-win, group))
    return found


def build(keys, g, capacity):
    """Section 2: per cube, as its exponent and its run of keys, if it is a leaf and which points it stores."""
    k = max(g, exponent(keys[0], keys[-1]))
    wins, nodes = wins_of(keys, k), {}

    def node(k, run, taken):
        remaining = [i for i in run if wins[i] < taken]
        if not remaining:
            return
        leaf = len(remaining) <= capacity or k == g
        nodes[k, keys[run[0]] >> 3 * k] = leaf, [i for i in remaining if leaf or wins[i] >= k - g]
        if not leaf:
            octants = {}
            for i in run:
                octants.setdefault(keys[i] >> 3 * (k - 1), []).append(i)
            for octant in octants.values():
                node(k - 1, octant, k - g)

    node(k, range(len(keys)), k + 1)
    return nodes, steps_of(keys, wins)


def assert_is_the_tree_of_its_points(nodes, g, capacity):
    """Nodes of a layer, in pre-order, each with the places of its parts' points, are what ``build`` makes of all points.

    Of points at one place the one that is stored coarsest is taken for the first.
    """
    stored = []
    for order, (node, parts) in enumerate(nodes):
        for number, places in enumerate(parts):
            stored += [(key, order, number) for key in keys_of(places)]
    stored.sort()
    expected, steps = build([key for key, _, _ in stored], g, capacity)
    cubes = {(node.k, keys_of(np.array([node.corner]))[0] >> 3 * node.k): i for i, (node, _) in enumerate(nodes)}
    assert set(cubes) == set(expected)
    for cube, (leaf, points) in expected.items():
        node = nodes[cubes[cube]][0]
        assert node.leaf == leaf
        assert all(stored[i][1] == cubes[cube] for i in points)
        by_part = [[steps[i] for i in points if stored[i][2] == number] for number in range(len(node.parts))]
        assert [len(part) for part in by_part] == [part.points for part in node.parts]
        complete = None
        for number, (part, found) in enumerate(zip(node.parts, by_part)):
            assert (-part.first_step[1], part.first_step[0]) == min(found)
            next_step = min((min(finer) for finer in by_part[number + 1 :]), default=(49, 0))
            # Only repeated positions, of win -1, are cut within a step.
            assert max(found) < next_step or next_step == (1, 1)
            complete = max((step for step in found if step < next_step), default=complete)
            win, group = (-complete[0], complete[1]) if complete else (0, 0)
            assert part.last_complete_step == (group, win)
