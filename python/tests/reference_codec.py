"""Decodes chunks, from docs/format-codec.md alone: plain and slow, to compare Esker with.

Sections cited are of that page.
"""

from collections import Counter
from itertools import accumulate

import numpy as np
import zstandard

BLOCK = 4096
MASK = (1 << 64) - 1
#: In the order of the type byte (section "Heads").
TYPES = ["u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8"]


#: How often each rule was needed, so that a test can say that all of them were.
MET = Counter()


class Damaged(Exception):
    """The bytes are not what the documents say."""


def check(truth, what):
    if not truth:
        raise Damaged(what)


def signed(number):
    """The number in 64-bit two's complement (section "Lines")."""
    number &= MASK
    return number - (1 << 64) if number >> 63 else number


def unzigzag(number):
    """0, -1, 1, -2 from 0, 1, 2, 3."""
    return number >> 1 ^ -(number & 1)


class Piece:
    """A run of bytes that is read from its beginning, and has to be read to its end."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        check(self.at + count <= len(self.data), "a piece ends too early")
        self.at += count
        return self.data[self.at - count : self.at]

    def rest(self):
        return self.take(len(self.data) - self.at)

    def integer(self, width):
        return int.from_bytes(self.take(width), "little")

    def varint(self):
        number = shift = 0
        while True:
            byte = self.integer(1)
            number |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                check((byte or shift == 7) and number <= MASK, "a varint is padded or too long")
                return number

    def zigzag(self):
        return unzigzag(self.varint())

    def piece(self):
        """A piece whose length comes first."""
        return Piece(self.take(self.varint()))

    def end(self):
        check(self.at == len(self.data), "a piece has bytes left over")


class Bits:
    """Bits, the lowest of each byte first."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        begin, self.at = self.at, self.at + count
        check(self.at <= 8 * len(self.data), "bits end too early")
        window = int.from_bytes(self.data[begin >> 3 : (self.at + 7) >> 3], "little")
        return window >> (begin & 7) & ((1 << count) - 1)

    def bytes_begun(self):
        """After the filling of the last byte, which must be zeros."""
        check(self.take(-self.at % 8) == 0, "bits are not filled with zeros")
        return self.at >> 3

    def end(self):
        check(self.bytes_begun() == len(self.data), "bits have bytes left over")


def stream(piece, length):
    """Section "Streams"."""
    head = piece.varint()
    data, packing = piece.take(head >> 2), head & 3
    MET["packing", packing] += 1
    if packing == 1:
        frame = b"\x28\xb5\x2f\xfd" + data
        try:
            data = zstandard.ZstdDecompressor().decompress(frame, max_output_size=BLOCK)
        except zstandard.ZstdError as error:
            raise Damaged("a frame") from error
    elif packing == 2:
        data = bytes(coded_symbols(data, length))
    else:
        check(packing == 0, "no such packing")
    check(len(data) == length, "a stream has another length")
    return data


def table_of_numbers(bits, symbols, total):
    """Per symbol its begin and its number (section "Coded symbols")."""
    weights, e = [], 0
    for _ in range(symbols):
        if bits.take(1):
            if bits.take(1):
                e = bits.take(4)
            else:
                e += -1 if bits.take(1) else 1
            check(0 <= e <= 15, "a weight's exponent is out of range")
        weights.append((4 + bits.take(2)) << (e - 1) if e else 0)
    whole = sum(weights)
    check(whole > 0, "a table without symbols")
    numbers = [max(1, (weight * total + whole // 2) // whole) if weight else 0 for weight in weights]
    lacks = total - sum(numbers)
    while lacks:
        largest = numbers.index(max(numbers))
        change = lacks if lacks > 0 else -min(-lacks, numbers[largest] - 1)
        check(change, "a table's numbers do not fit")
        numbers[largest] += change
        lacks -= change
    return list(accumulate(numbers, initial=0)), numbers


def coded_symbols(data, count, contexts=None, base=None):
    """Section "Coded symbols". A context is ``base[point]`` plus the symbol before in the run."""
    total = 1 << 11 if contexts is None else 1 << 9
    piece = Piece(data)
    symbols = piece.integer(1) + 1
    bits = Bits(piece.rest())
    tables = {}
    for context in range(contexts or 1):
        if (contexts or 1) == 1 or bits.take(1):
            begins, numbers = table_of_numbers(bits, symbols, total)
            tables[context] = np.repeat(np.arange(symbols), numbers).tolist(), begins, numbers
    piece = Piece(data[1 + bits.bytes_begun() :])
    states = [piece.integer(4) for _ in range(4)]
    run = max(1, -(-count // 4))
    found = [0] * count
    for step in range(run):
        for i in range(4):
            point = i * run + step
            if point >= count:
                continue
            context = 0
            if contexts is not None:
                context = (found[point - 1] if step else 0) + (0 if base is None else int(base[point]))
            check(context in tables, "a context without a table")
            symbol_at, begins, numbers = tables[context]
            v = states[i] % total
            symbol = symbol_at[v]
            state = numbers[symbol] * (states[i] // total) + v - begins[symbol]
            if state < 1 << 15:
                state = state << 16 | piece.integer(2)
            check(1 << 15 <= state < 1 << 31, "a state is out of range")
            states[i], found[point] = state, symbol
    check(states == [1 << 15] * 4, "a state does not end where it began")
    piece.end()
    return found


def residuals(piece, count):
    """Section "Residuals": to the end of the piece."""
    m = piece.integer(1)
    check(m <= 8, "no such m")
    symbols, bits, numbers = stream(piece, count), Bits(piece.rest()), []
    for symbol in symbols:
        g, low = symbol >> m, symbol & ((1 << m) - 1)
        t = max(g, 1) - 1
        number = ((g > 0) << m | low) << t | bits.take(t)
        check(number <= MASK, "a number of more than 64 bits")
        numbers.append(number)
    bits.end()
    return numbers


def cut(points, size):
    """The blocks of a part: slices of its points."""
    return [slice(begin, min(begin + size, points)) for begin in range(0, points, size)]


def points_of(blocks):
    return blocks[-1].stop if blocks else 0


def positions(data, blocks, k):
    """Sections "Heads" and "Blocks of positions": int64 relative to the cube's low corner.

    Also per block its passes, how many and each point's, or None.
    """
    piece = Piece(data)
    check(piece.integer(1) == 1, "codec")
    check(piece.varint() == points_of(blocks), "count")
    counts = [block.stop - block.start for block in blocks]
    width = -(-k // 8)
    bounds = [[piece.integer(width) for _ in range(6)] for _ in counts]
    lengths = [piece.varint() for _ in counts]
    pass_lengths = [piece.varint() for _ in counts]
    keys, places = [], []
    for count, length, bound in zip(counts, lengths, bounds):
        keys += block_of_keys(Piece(piece.take(length)), count, k)
        block = places_of_keys(keys[-count:], k)
        check([*block.min(axis=0), *block.max(axis=0)] == bound, "bounds of a block")
        places.append(block)
    check(all(a <= b for a, b in zip(keys, keys[1:])), "order of keys")
    passes = [block_of_passes(piece.take(length), count) for length, count in zip(pass_lengths, counts)]
    piece.end()
    return np.concatenate(places), passes


def block_of_keys(piece, count, k):
    """Section "Blocks of positions"."""
    first = piece.integer(-(-3 * k // 8))
    MET["keys", "narrow" if k <= 21 else "wide"] += 1
    if k <= 21:
        differences = residuals(piece, count - 1)
    else:
        symbols = stream(piece, count - 1)
        check(max(symbols, default=0) <= 144, "a difference of too many bits")
        bits = Bits(piece.rest())
        differences = [1 << b - 1 | bits.take(b - 1) if b else 0 for b in symbols]
        bits.end()
    piece.end()
    keys = list(accumulate(differences, initial=first))
    check(keys[-1] < 1 << 3 * k, "a key outside the cube")
    return keys


def places_of_keys(keys, k):
    """Digit i of a key is bit i of x, y and z, each XOR 0x5555_5555_5555."""
    octets = np.frombuffer(b"".join(key.to_bytes(18, "little") for key in keys), np.uint8).reshape(len(keys), 18)
    digits = np.unpackbits(octets, axis=1, bitorder="little").reshape(len(keys), 48, 3).astype(np.int64)
    reflected = np.einsum("nia,i->na", digits, 1 << np.arange(48, dtype=np.int64))
    return (reflected ^ 0x5555_5555_5555) & ((1 << k) - 1)


def block_of_passes(data, count):
    """Section "Passes"."""
    if not data:
        return None
    piece = Piece(data)
    passes = piece.integer(1)
    check(1 <= passes <= 32, "number of passes")
    of_point = indices(piece, count, passes, []) if passes > 1 else [0] * count
    piece.end()
    return passes, of_point


def indices(piece, count, n, leaders):
    """Section "Indices"."""
    way = piece.integer(1)
    MET["indices", way] += 1
    if way == 0:
        width = 1 if n <= 2 else 2 if n <= 4 else 4 if n <= 16 else 8
        bits = Bits(stream(piece, -(-count * width // 8)))
        found = [bits.take(width) for _ in range(count)]
        bits.end()
    else:
        check(n <= 16 and way <= 2 and (way == 1 or leaders), "no such way")
        base, contexts = None, n
        if way == 2:
            base, contexts = n * leaders[0].astype(np.int64), n * (int(leaders[0].max()) + 1)
            check(contexts <= 16 * n, "a leader above 15")
        found = coded_symbols(piece.rest(), count, contexts, base)
    check(max(found) < n, "an index too large")
    return found


def numbers(piece, count):
    """The numbers of the section "Blocks of values"."""
    way = piece.integer(1)
    check(way <= 3, "no such way")
    MET["numbers", way] += 1
    found = list(stream(piece, count)) if way < 2 else residuals(piece, count)
    if way % 2:
        mask = 255 if way == 1 else MASK
        found = list(accumulate((unzigzag(number) for number in found), lambda a, b: (a + b) & mask, initial=0))[1:]
    return found


def column(data, dtype, blocks, places, passes, leaders):
    """An attribute's values (section "Heads"). ``leaders``: the columns it follows, those that the part has, in order."""
    piece = Piece(data)
    check(piece.integer(1) == 2, "codec")
    check(piece.varint() == points_of(blocks), "count")
    code, width = piece.integer(1), np.dtype(dtype).itemsize
    check(TYPES[code & 127 : (code & 127) + 1] == [dtype], "type")
    if code & 128:
        MET["one value"] += 1
        value = np.frombuffer(piece.take(width), "<" + dtype)
        piece.end()
        return np.repeat(value, points_of(blocks))
    lengths = [piece.varint() for _ in blocks]
    values = []
    for i, (at, length) in enumerate(zip(blocks, lengths)):
        block = Piece(piece.take(length))
        values += block_of_values(block, width, places[at], passes[i], [leader[at] for leader in leaders])
        block.end()
    piece.end()
    return values_of_integers(values, dtype)


def values_of_integers(integers, dtype):
    """From unsigned integers that order as the values do (section "Blocks of values")."""
    width = np.dtype(dtype).itemsize
    bits = np.array(integers, np.uint64)
    sign = np.uint64(1 << 8 * width - 1)
    if dtype[0] == "i":
        bits ^= sign
    elif dtype[0] == "f":
        bits = np.where(bits & sign, bits ^ sign, ~bits)
    return bits.astype(f"<u{width}").view("<" + dtype)


def block_of_values(piece, width, places, passes, leaders):
    """Integers of a block (section "Blocks of values")."""
    count = len(places)
    kind = piece.integer(1)
    MET["kind", kind] += 1
    if kind == 0:
        return [piece.integer(width)] * count
    if kind == 1:
        return [piece.integer(width) for _ in range(count)]
    least, step = piece.integer(width), piece.varint()
    if kind == 2:
        n = piece.integer(1) + 1
        check(n <= 16, "a table of more than 16 values")
        table = list(accumulate(piece.varint() for _ in range(n)))
        found = [table[index] for index in indices(piece, count, n, leaders)]
    elif kind == 3:
        found = numbers(piece, count)
    elif kind == 4:
        d = piece.varint()
        check(1 <= d <= count, "number of ranks")
        sorted_piece = piece.piece()
        table = list(accumulate(residuals(sorted_piece, d)))
        sorted_piece.end()
        ranks = numbers(piece, count)
        check(max(ranks) < d, "a rank too large")
        found = [table[rank] for rank in ranks]
    elif kind == 5:
        found = lines(piece, places.tolist(), passes)
    elif kind == 6:
        found = steady(piece, places.tolist(), passes)
    elif kind == 7:
        found = joint(piece, count, leaders)
    else:
        raise Damaged("no such kind")
    check(step or not any(found), "a step of 0")
    check(least + step * max(found) < 1 << 8 * width, "a value too large")
    return [least + step * number for number in found]


def way(a, b, rates):
    """Section "Lines"."""
    return sum((q - p) * rate for p, q, rate in zip(a, b, rates))


def steady(piece, places, passes):
    """Kind 6."""
    check(passes, "passes are not known")
    models = [[piece.zigzag() for _ in range(4)] for _ in range(passes[0])]
    found = []
    for number, place, of in zip(numbers(piece, len(places)), places, passes[1]):
        base, *rates = models[of]
        found.append(base + (signed(way((0, 0, 0), place, rates) + (1 << 19)) >> 20) + unzigzag(number) & MASK)
    return found


def joint(piece, count, leaders):
    """Section "Joint"."""
    n = piece.integer(1)
    check(1 <= n <= 2 and n <= len(leaders), "number of leaders")
    rates = [piece.zigzag() for _ in range(n)]
    way_of_joint = piece.integer(1)
    check(way_of_joint <= 1, "no such way")
    MET["joint", n, way_of_joint] += 1
    left = list(stream(piece, count)) if way_of_joint == 0 else residuals(piece, count)
    mask = 255 if way_of_joint == 0 else MASK
    found, number, before = [], 0, [0] * n
    for i, residual in enumerate(left):
        has = [int(leader[i]) for leader in leaders[:n]]
        change = signed(way(before, has, rates) + (1 << 23)) >> 24
        number = number + unzigzag(residual) + change & mask
        before = has
        found.append(number)
    return found


def lines(piece, places, passes):
    """Section "Lines"."""
    check(passes, "passes are not known")
    pulse, tick = piece.varint(), piece.varint()
    check(pulse >= 1 << 16, "pulse")
    MET["lines", "many ticks a pulse" if pulse > 1 << 16 else "one tick a pulse"] += 1
    MET["lines", "many numbers a tick" if tick else "one number a tick"] += 1
    models = []
    for _ in range(passes[0]):
        head = piece.varint(), piece.zigzag(), piece.zigzag()
        models.append((*head, [piece.zigzag() for _ in range(3)], [piece.zigzag() for _ in range(3)]))
        check(models[-1][0] >= 1, "lines of a pass")
    check(sum(model[0] for model in models) <= 4 * len(places), "lines of all passes")
    firsts, points = piece.varint(), len(places)
    check(1 <= firsts <= points, "number of first points")

    def deltas(count, there=True):
        found = [0] * count
        if there:
            inner = piece.piece()
            found = [unzigzag(number) for number in residuals(inner, count)]
            inner.end()
        return iter(found)

    def following(numbers):
        number = next(numbers, None)
        check(number is not None, "number of first points")
        return number

    of_line = deltas(points)
    of_first = deltas(firsts)
    of_pulses = deltas(points - firsts)
    of_ticks = deltas(points - firsts, pulse != 1 << 16)
    of_numbers = deltas(points - firsts, tick != 0)

    def ticks(pulses):
        return signed(signed(pulses * pulse) + (1 << 15)) >> 16

    def length(t):
        return signed(t * tick + (1 << 31) >> 32) if tick else t

    last_of_pass, last_of_line, found = {}, {}, []
    for place, of in zip(places, passes[1]):
        count, start, period, along, across = models[of]
        line = following(of_line)
        if of in last_of_pass:
            before, _, line_before = last_of_pass[of]
            line += line_before + (signed(way(before, place, across) + (1 << 23)) >> 24)
        line = signed(line)
        check(0 <= line < count, "a line that the pass does not have")
        first = (of, line) not in last_of_line
        before, offset, _ = last_of_line.get((of, line)) or last_of_pass.get(of) or (None, 0, 0)
        pulses = signed(way(before, place, along) + (1 << 19)) >> 20 if before else 0
        if first:
            offset += length(ticks(pulses)) + following(of_first)
        else:
            pulses = signed(pulses + following(of_pulses))
            offset += length(signed(ticks(pulses) + following(of_ticks))) + following(of_numbers)
        offset = signed(offset)
        last_of_line[of, line] = last_of_pass[of] = place, offset, line
        found.append(start + line * period + offset & MASK)
    check(len(last_of_line) == firsts, "number of first points")
    return found
