//! Laws of whole chunks: all comes back, nothing malformed passes for more than it is.

use super::*;
use crate::lattice::{Cube, Key, LatticeBox, LatticePoint};
use crate::points::{Column, Positions, ScalarType};
use crate::with_column;
use proptest::prelude::*;

/// Any size of blocks, half of the time the largest.
fn sizes() -> impl Strategy<Value = BlockSize> {
    prop_oneof![Just(BlockSize::LARGEST), (4_u8..=12).prop_map(|exponent| BlockSize::of_exponent(exponent).unwrap())]
}

/// So many points in blocks of the largest size.
fn large(points: usize) -> Blocks {
    Blocks::new(points, BlockSize::LARGEST)
}

/// Cuts into blocks of this size.
fn encoder(size: BlockSize) -> Encoder {
    let mut encoder = Encoder::new();
    encoder.cut_into(size);
    encoder
}

/// A cube and points in it, in key order, some of them repeated; more than a block now and then.
fn cloud(max_k: u8) -> impl Strategy<Value = (Cube, Vec<Key>)> {
    let offsets = prop::collection::vec((prop::array::uniform3(any::<u64>()), 0_u32..48), 0..120);
    (prop::array::uniform3(0_u64..1 << 48), 0..=max_k, offsets, prop_oneof![4 => Just(1_usize), 1 => 2..200_usize])
        .prop_map(|(p, k, offsets, repeat)| {
            let cube = Cube::containing(LatticePoint(p), k);
            let inside = |o: u64, shift: u32| (o & (cube.side() - 1)) >> shift.min(u32::from(k));
            let point = |(o, shift): ([u64; 3], u32)| {
                Key::of(LatticePoint(std::array::from_fn(|i| cube.low().0[i] + inside(o[i], shift))))
            };
            let mut keys: Vec<_> =
                offsets.into_iter().map(point).flat_map(|k| std::iter::repeat_n(k, repeat)).collect();
            keys.sort_unstable();
            (cube, keys)
        })
}

/// Columns of all types: constant, of few values, in small steps, stepped, or any bits at all.
fn column() -> impl Strategy<Value = Column> {
    let ty = (0..ScalarType::ALL.len()).prop_map(|i| ScalarType::ALL[i]);
    let len = prop_oneof![4 => 0_usize..300, 1 => 4090_usize..9000];
    (ty, len, 0_u32..64, any::<u64>(), any::<u64>(), 0_u8..5, 1_u64..300).prop_map(
        |(ty, len, shift, seed, start, shape, step)| {
            let mut state = seed | 1;
            let mut next = || {
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                state
            };
            let mut bits = start;
            let mut value = || {
                bits = match shape {
                    0 => start,
                    1 => bits.wrapping_add(next() >> shift).wrapping_sub(next() >> shift),
                    2 => start.wrapping_add((next() >> shift).wrapping_mul(step)),
                    3 => [start, next(), !start][(next() % 100).saturating_sub(97) as usize],
                    _ => next(),
                };
                bits
            };
            let mut column = Column::zeros(ty, len);
            with_column!(&mut column, values => values.iter_mut().for_each(|v| {
                *v = value::Value::of_bits(value());
            }));
            column
        },
    )
}

fn bits(column: &Column) -> Vec<[u8; 8]> {
    (0..column.len()).map(|i| column.raw(i)).collect()
}

/// Decodes everything that a chunk of positions offers, whatever its bytes are.
fn read_positions(bytes: &[u8], cube: Cube, blocks: Blocks) -> Result<Positions, CodecError> {
    let mut positions = Positions::default();
    let mut keys = Vec::<Key>::new();
    let chunk = PositionChunk::parse(bytes, cube, blocks)?;
    chunk.decode_keys(&mut Decoder::new(), &mut keys)?;
    chunk.decode(&mut Decoder::new(), &mut positions)?;
    assert_eq!(positions.len(), blocks.points());
    assert!(positions.iter().all(|p| cube.contains(p)));
    assert!(positions.iter().map(Key::of).eq(keys.iter().copied()));
    assert!((0..blocks.count()).all(|block| keys[blocks.range(block)].is_sorted()));
    Ok(positions)
}

fn read_column(bytes: &[u8], ty: ScalarType, blocks: Blocks) -> Result<Column, CodecError> {
    let mut column = Column::zeros(ty, 0);
    ColumnChunk::parse(bytes, ty, blocks)?.decode(&mut Decoder::new(), &mut column)?;
    assert_eq!(column.len(), blocks.points());
    Ok(column)
}

proptest! {
    #[test]
    fn positions_come_back_block_by_block_with_tight_bounds(
        (cube, keys) in prop_oneof![cloud(21), cloud(48)],
        size in sizes(),
    ) {
        let (mut encoder, mut decoder) = (encoder(size), Decoder::new());
        let blocks = Blocks::new(keys.len(), size);
        let mut bytes = vec![9; 3];
        encoder.positions(cube, &keys, &mut bytes).unwrap();
        let chunk = PositionChunk::parse(&bytes[3..], cube, blocks).unwrap();
        prop_assert_eq!(chunk.blocks().len(), blocks.count());
        for (block, bounds) in chunk.blocks().iter().enumerate() {
            let keys = &keys[blocks.range(block)];
            let (mut positions, mut back) = (Positions::default(), Vec::<Key>::new());
            chunk.decode_block(&mut decoder, block, &mut positions).unwrap();
            prop_assert!(positions.iter().eq(keys.iter().map(|k| k.point())));
            chunk.decode_block_keys(&mut decoder, block, &mut back).unwrap();
            prop_assert_eq!(&back[..], keys);
            let tight = positions.iter().fold(LatticeBox::of(keys[0].point()), |b, p| b.with(p));
            prop_assert_eq!(*bounds, tight);
        }
        if cube.k() <= 21 {
            let low: Vec<u64> = keys.iter().map(|k| k.low).collect();
            let mut same = Vec::new();
            encoder.positions(cube, &low, &mut same).unwrap();
            prop_assert_eq!(&same[..], &bytes[3..]);
            let mut back: Vec<u64> = Vec::new();
            chunk.decode_keys(&mut decoder, &mut back).unwrap();
            prop_assert_eq!(back, low);
        }
        prop_assert_eq!(read_positions(&bytes[3..], cube, blocks).unwrap().len(), keys.len());
    }

    #[test]
    fn keys_out_of_order_or_outside_are_errors((cube, keys) in prop_oneof![cloud(21), cloud(47)], at: prop::sample::Index) {
        prop_assume!(keys.first() != keys.last());
        let mut out = vec![1, 2];
        let mut swapped = keys.clone();
        let at = at.index(keys.len());
        swapped.rotate_left(at);
        if at > 0 && swapped != keys {
            let error = Encoder::new().positions(cube, &swapped, &mut out);
            let refused = matches!(error, Err(CodecError::Key { .. }));
            prop_assert!(refused);
        }
        let other = Cube::containing(cube.parent().child(cube.octant() ^ 1).unwrap().low(), cube.k());
        let refused = matches!(Encoder::new().positions(other, &keys, &mut out), Err(CodecError::Key { .. }));
        prop_assert!(refused);
        prop_assert_eq!(out, [1, 2]);
    }

    #[test]
    fn columns_come_back_bit_for_bit(column in column(), size in sizes()) {
        let mut bytes = vec![7];
        let (mut encoder, blocks) = (encoder(size), Blocks::new(column.len(), size));
        encoder.column(&column, &mut bytes).unwrap();
        let chunk = ColumnChunk::parse(&bytes[1..], column.ty(), blocks).unwrap();
        let (mut back, mut decoder) = (Column::zeros(column.ty(), 1), Decoder::new());
        for block in 0..chunk.blocks() {
            chunk.decode_block(&mut decoder, block, &mut back).unwrap();
        }
        prop_assert_eq!(&bits(&back)[1..], &bits(&column)[..]);
        prop_assert_eq!(bits(&read_column(&bytes[1..], column.ty(), blocks).unwrap()), bits(&column));
        // At most the values themselves and a little.
        prop_assert!(bytes.len() <= 16 + (column.ty().size() * column.len()) + 8 * chunk.blocks());
        let constant = (1..column.len()).all(|i| column.raw(i) == column.raw(0)) && !column.is_empty();
        prop_assert_eq!(chunk.constant(), constant.then(|| column.raw(0)));
        prop_assert!(!constant || bytes.len() <= 14);
    }

    #[test]
    fn damaged_positions_are_errors_or_points_of_the_cube(
        (cube, keys) in prop_oneof![cloud(21), cloud(48)],
        flips in prop::collection::vec((any::<prop::sample::Index>(), 1_u8..), 1..4),
        cut: prop::sample::Index,
        size in sizes(),
    ) {
        let mut bytes = Vec::new();
        let blocks = Blocks::new(keys.len(), size);
        encoder(size).positions(cube, &keys, &mut bytes).unwrap();
        prop_assert!(read_positions(&bytes[..cut.index(bytes.len())], cube, blocks).is_err());
        prop_assert!(read_positions(&bytes, cube, Blocks::new(keys.len() + 1, size)).is_err());
        prop_assert!(ColumnChunk::parse(&bytes, ScalarType::U8, blocks).is_err());
        for (at, flip) in flips {
            *at.get_mut(&mut bytes) ^= flip;
        }
        let _ = read_positions(&bytes, cube, blocks);
    }

    #[test]
    fn damaged_columns_are_errors_or_values(
        column in column(),
        flips in prop::collection::vec((any::<prop::sample::Index>(), 1_u8..), 1..4),
        cut: prop::sample::Index,
        size in sizes(),
    ) {
        let mut bytes = Vec::new();
        encoder(size).column(&column, &mut bytes).unwrap();
        let (ty, blocks) = (column.ty(), Blocks::new(column.len(), size));
        prop_assert!(read_column(&bytes[..cut.index(bytes.len())], ty, blocks).is_err());
        prop_assert!(read_column(&bytes, ty, Blocks::new(column.len() + 1, size)).is_err());
        for other in ScalarType::ALL {
            prop_assert!(other == ty || ColumnChunk::parse(&bytes, other, blocks).is_err());
        }
        for (at, flip) in flips {
            *at.get_mut(&mut bytes) ^= flip;
        }
        let _ = read_column(&bytes, ty, blocks);
    }

    #[test]
    fn any_bytes_at_all_are_errors_or_points(
        mut bytes in prop::collection::vec(any::<u8>(), 0..200),
        codec in 1_u8..=2,
        count in 0_usize..100,
        k in 0_u8..=48,
        ty in 0..ScalarType::ALL.len(),
        size in sizes(),
    ) {
        let blocks = Blocks::new(count, size);
        // With the right beginning, so that what follows is looked at.
        bytes.splice(0..bytes.len().min(2), [codec, count as u8]);
        let cube = Cube::containing(LatticePoint([1 << 47; 3]), k);
        let _ = read_positions(&bytes, cube, blocks);
        let _ = read_column(&bytes, ScalarType::ALL[ty], blocks);
    }
}

#[test]
fn more_points_than_a_part_may_have_are_an_error() {
    let count = MAX_POINTS + 1;
    let cube = Cube::containing(LatticePoint::default(), 0);
    let error = CodecError::TooManyPoints { count };
    assert_eq!(PositionChunk::parse(&[], cube, large(count)).unwrap_err(), error);
    assert_eq!(ColumnChunk::parse(&[], ScalarType::F64, large(count)).unwrap_err(), error);
    let mut out = Vec::new();
    assert_eq!(Encoder::new().column(&Column::zeros(ScalarType::U8, count), &mut out).unwrap_err(), error);
    assert_eq!(Encoder::new().positions(cube, &vec![0_u64; count], &mut out).unwrap_err(), error);
    assert!(out.is_empty());
}

#[test]
fn ten_million_coincident_points_cost_almost_nothing() {
    let cube = Cube::containing(LatticePoint([5; 3]), 0);
    let count = 10_000_000;
    let mut bytes = Vec::new();
    Encoder::new().positions(cube, &vec![cube.first_key().low; count], &mut bytes).unwrap();
    assert!(bytes.len() < count / 100, "{} bytes", bytes.len());
    let chunk = PositionChunk::parse(&bytes, cube, large(count)).unwrap();
    let mut positions = Positions::default();
    chunk.decode_block(&mut Decoder::new(), 1234, &mut positions).unwrap();
    assert!(positions.iter().all(|p| p == cube.low()));
}

/// A flight over a cube: points in key order, the times that a scanner would give them, and what is steady in its passes.
fn flown(passes: u64, jitter: u64) -> (Cube, Vec<u64>, Vec<Column>) {
    let cube = Cube::containing(LatticePoint([1 << 46; 3]), 13);
    let mut points = Vec::new();
    let mut state = 1_u64;
    let mut noise = |n: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 33) % (n + 1)
    };
    for pass in 0..passes {
        for line in 0..70 {
            for shot in 0..70 {
                let place = [shot * 30 + noise(jitter), line * 40 + noise(jitter), 300 + noise(jitter)];
                let point = LatticePoint(std::array::from_fn(|i| cube.low().0[i] + place[i]));
                let time = 3e8 + pass as f64 * 100.0 + line as f64 * 5e-3 + shot as f64 * 8e-7;
                points.push((Key::of(point).low, time, pass as u16, shot as i16 / 3));
            }
        }
    }
    points.sort_unstable_by_key(|p| p.0);
    let times = Column::F64(points.iter().map(|p| p.1).collect());
    let sources = Column::U16(points.iter().map(|p| p.2 + 40).collect());
    let angles = Column::I16(points.iter().map(|p| p.3 * 7 - 100).collect());
    (cube, points.iter().map(|p| p.0).collect(), vec![times, sources, angles])
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn what_follows_from_positions_comes_back_and_its_damage_is_an_error_or_values(
        passes in 1_u64..4,
        jitter in 0_u64..8,
        damage: prop::sample::Index,
        to: u8,
        size in sizes(),
    ) {
        let (cube, keys, columns) = flown(passes, jitter);
        let (mut encoder, blocks) = (encoder(size), Blocks::new(keys.len(), size));
        let mut chunks = vec![Vec::new(), Vec::new(), Vec::new()];
        let found = encoder.times(&columns[0], cube, &keys, &mut chunks[0]).unwrap();
        for (column, chunk) in columns.iter().zip(&mut chunks).skip(1) {
            encoder.column_after(column, &found, &[], chunk).unwrap();
        }
        let mut positions = Vec::new();
        encoder.positions_with(cube, &keys, &found, &mut positions).unwrap();
        prop_assert_eq!(read_positions(&positions, cube, blocks).unwrap().len(), keys.len());
        let read = |chunk: &[u8], positions: &[u8], ty: ScalarType| {
            let positions = PositionChunk::parse(positions, cube, blocks)?;
            let mut column = Column::zeros(ty, 0);
            ColumnChunk::parse(chunk, ty, blocks)?.at(&positions).decode(&mut Decoder::new(), &mut column)?;
            Ok::<_, CodecError>(column)
        };
        for (column, chunk) in columns.iter().zip(&mut chunks) {
            prop_assert_eq!(bits(&read(chunk, &positions, column.ty()).unwrap()), bits(column));
            let at = damage.index(chunk.len());
            let whole = std::mem::replace(&mut chunk[at], to);
            if let Ok(found) = read(chunk, &positions, column.ty()) {
                prop_assert_eq!(found.len(), keys.len());
            }
            chunk[at] = whole;
        }
        let at = damage.index(positions.len());
        positions[at] = to;
        for (column, chunk) in columns.iter().zip(&chunks) {
            if let Ok(found) = read(chunk, &positions, column.ty()) {
                prop_assert_eq!(found.len(), keys.len());
            }
        }
    }
}

#[test]
fn what_follows_from_positions_takes_little_and_asks_for_them() {
    let (cube, keys, columns) = flown(2, 0);
    let mut encoder = Encoder::new();
    let (mut times, mut sources, mut angles) = (Vec::new(), Vec::new(), Vec::new());
    let passes = encoder.times(&columns[0], cube, &keys, &mut times).unwrap();
    encoder.column_after(&columns[1], &passes, &[], &mut sources).unwrap();
    encoder.column_after(&columns[2], &passes, &[], &mut angles).unwrap();
    let mut alone = Vec::new();
    encoder.column(&columns[0], &mut alone).unwrap();
    assert!(3 * times.len() < alone.len(), "{} bytes, alone {}", times.len(), alone.len());
    // A hundredth of a byte a point, and what a block takes however little is in it.
    assert!(90 * sources.len() < keys.len(), "{} bytes", sources.len());
    let mut column = Column::zeros(ScalarType::F64, 0);
    let chunk = ColumnChunk::parse(&times, ScalarType::F64, large(keys.len())).unwrap();
    assert_eq!(chunk.decode(&mut Decoder::new(), &mut column), Err(CodecError::NoPositions));
    assert_eq!(column.len(), 0);
}

/// Colours that go together, and returns: a column, and the places of those that it follows.
fn followers(count: usize, noise: u64, deep: bool) -> Vec<(Column, Vec<usize>)> {
    let mut state = noise | 1;
    let mut next = |n: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 33) % (n + 1)
    };
    let (mut red, mut green, mut blue) = (Vec::new(), Vec::new(), Vec::new());
    let (mut which, mut all) = (Vec::new(), Vec::new());
    let (mut light, scale) = (100, if deep { 256 } else { 1 });
    for _ in 0..count {
        light = (light + next(20)).saturating_sub(next(20)).min(200);
        let (r, g) = (light + next(3), light * 7 / 8 + next(noise % 6));
        red.push((r * scale) as u16);
        green.push((g * scale) as u16);
        blue.push(((r + g) / 2 * scale + next(1)) as u16);
        all.push(1 + next(3) as u8 * next(1) as u8);
        which.push(1 + next(u64::from(all[all.len() - 1]) - 1) as u8);
    }
    vec![
        (Column::U16(red), vec![]),
        (Column::U16(green), vec![0]),
        (Column::U16(blue), vec![0, 1]),
        (Column::U8(which), vec![]),
        (Column::U8(all), vec![3]),
    ]
}

fn with_leaders<'a>(
    chunks: &'a [Vec<u8>],
    columns: &[(Column, Vec<usize>)],
    i: usize,
    size: BlockSize,
) -> Result<ColumnChunk<'a>, CodecError> {
    let (column, leaders) = &columns[i];
    let chunk = ColumnChunk::parse(&chunks[i], column.ty(), Blocks::new(column.len(), size))?;
    let chunk = if [0, 1, 3].contains(&i) { chunk.leading() } else { chunk };
    leaders.iter().try_fold(chunk, |chunk, leader| Ok(chunk.after(with_leaders(chunks, columns, *leader, size)?)))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn columns_that_follow_others_come_back_in_any_order_and_damage_is_an_error_or_values(
        count in prop_oneof![1_usize..300, 4090_usize..9000],
        (noise, deep) in any::<(u64, bool)>(),
        order in Just(vec![0_usize, 1, 2, 3, 4]).prop_shuffle(),
        (hit, damage, to) in (0_usize..5, any::<prop::sample::Index>(), any::<u8>()),
        size in sizes(),
    ) {
        let columns = followers(count, noise, deep);
        let mut encoder = encoder(size);
        let mut chunks: Vec<Vec<u8>> = Vec::new();
        for (column, leaders) in &columns {
            let leaders: Vec<_> = leaders.iter().map(|i| &columns[*i].0).collect();
            let mut out = Vec::new();
            encoder.column_after(column, &Passes::default(), &leaders, &mut out).unwrap();
            chunks.push(out);
        }
        let mut decoder = Decoder::new();
        let read = |decoder: &mut Decoder, chunks: &[Vec<u8>]| {
            let parsed = order.iter().map(|i| with_leaders(chunks, &columns, *i, size)).collect::<Result<Vec<_>, _>>()?;
            let mut back: Vec<_> = order.iter().map(|i| Column::zeros(columns[*i].0.ty(), 0)).collect();
            for block in 0..Blocks::new(count, size).count() {
                for (chunk, back) in parsed.iter().zip(&mut back) {
                    chunk.decode_block(decoder, block, back)?;
                }
            }
            Ok::<_, CodecError>(back)
        };
        for (back, i) in read(&mut decoder, &chunks).unwrap().iter().zip(&order) {
            prop_assert_eq!(back, &columns[*i].0);
        }
        for (i, (column, _)) in columns.iter().enumerate() {
            let mut back = Column::zeros(column.ty(), 0);
            with_leaders(&chunks, &columns, i, size).unwrap().decode(&mut decoder, &mut back).unwrap();
            prop_assert_eq!(&back, column);
        }
        // What is kept of damaged bytes is not taken for that of whole ones.
        let mut damaged = chunks.clone();
        let at = damage.index(damaged[hit].len());
        damaged[hit][at] = to;
        if let Ok(found) = read(&mut decoder, &damaged) {
            prop_assert!(found.iter().all(|column| column.len() == count));
        }
        for (back, i) in read(&mut decoder, &chunks).unwrap().iter().zip(&order) {
            prop_assert_eq!(back, &columns[*i].0);
        }
    }
}

#[test]
fn what_follows_another_column_takes_little_and_asks_for_it() {
    let columns = followers(8000, 1, true);
    let mut encoder = Encoder::new();
    for (followed, following) in [(0, 1), (3, 4)] {
        let (leader, column) = (&columns[followed].0, &columns[following].0);
        let (mut chunk, mut alone) = (Vec::new(), Vec::new());
        encoder.column_after(column, &Passes::default(), &[leader], &mut chunk).unwrap();
        encoder.column(column, &mut alone).unwrap();
        assert!(10 * chunk.len() < 9 * alone.len(), "{} bytes, alone {}", chunk.len(), alone.len());
        let mut back = Column::zeros(column.ty(), 0);
        let chunk = ColumnChunk::parse(&chunk, column.ty(), large(column.len())).unwrap();
        assert_eq!(chunk.decode(&mut Decoder::new(), &mut back), Err(CodecError::NoLeader));
        assert_eq!(back.len(), 0);
    }
}

/// What a column has in one block, read anew or by a decoder that kept other blocks.
fn one_block(chunk: &ColumnChunk, ty: ScalarType, block: usize, decoder: &mut Decoder) -> Column {
    let mut column = Column::zeros(ty, 0);
    chunk.decode_block(decoder, block, &mut column).unwrap();
    column
}

#[test]
fn a_kept_block_is_not_taken_for_one_that_follows_another_column() {
    let columns = followers(300, 1, false);
    let mut chunks: Vec<Vec<u8>> = Vec::new();
    for (column, leaders) in &columns[..2] {
        let leaders: Vec<_> = leaders.iter().map(|i| &columns[*i].0).collect();
        let mut out = Vec::new();
        Encoder::new().column_after(column, &Passes::default(), &leaders, &mut out).unwrap();
        chunks.push(out);
    }
    // The same bytes after a red that falls where the first one rises.
    let Column::U16(red) = &columns[0].0 else { panic!("red has 16 bits") };
    let mut other = Vec::new();
    Encoder::new().column(&Column::U16(red.iter().map(|r| 300 - r).collect()), &mut other).unwrap();
    let green = |red| {
        let chunk = |bytes| ColumnChunk::parse(bytes, ScalarType::U16, large(300)).unwrap();
        chunk(&chunks[1]).after(chunk(red)).leading()
    };
    let (first, second) = (green(&chunks[0]), green(&other));
    let mut decoder = Decoder::new();
    assert_eq!(one_block(&first, ScalarType::U16, 0, &mut decoder), columns[1].0);
    let anew = one_block(&second, ScalarType::U16, 0, &mut Decoder::new());
    assert_ne!(anew, columns[1].0);
    assert_eq!(one_block(&second, ScalarType::U16, 0, &mut decoder), anew);
}

#[test]
fn a_kept_block_is_not_taken_for_one_of_other_passes_or_of_another_length() {
    let mut encoder = Encoder::new();
    let (cube, keys, columns) = flown(2, 0);
    let found = encoder.times(&columns[0], cube, &keys, &mut Vec::new()).unwrap();
    // The same with the passes the other way around.
    let mut turned = found.clone();
    turned.blocks.iter_mut().for_each(|block| block.of_point.iter_mut().for_each(|pass| *pass = 1 - *pass));
    let [first, second] = [&found, &turned].map(|passes| {
        let mut bytes = Vec::new();
        Encoder::new().positions_with(cube, &keys, passes, &mut bytes).unwrap();
        bytes
    });
    let mut bytes = Vec::new();
    encoder.column_after(&columns[1], &found, &[], &mut bytes).unwrap();
    let mut decoder = Decoder::new();
    let mut read = |positions: &[u8]| {
        let positions = PositionChunk::parse(positions, cube, large(keys.len())).unwrap();
        let chunk = ColumnChunk::parse(&bytes, ScalarType::U16, large(keys.len())).unwrap().at(&positions).leading();
        let anew = one_block(&chunk, ScalarType::U16, 0, &mut Decoder::new());
        assert_eq!(one_block(&chunk, ScalarType::U16, 0, &mut decoder), anew);
        anew
    };
    assert_ne!(read(&first), read(&second));

    // The first block and the last have the same bytes.
    let values = Column::U16([vec![7; BLOCK_POINTS], vec![8; BLOCK_POINTS], vec![7; 9]].concat());
    let mut bytes = Vec::new();
    encoder.column(&values, &mut bytes).unwrap();
    let chunk = ColumnChunk::parse(&bytes, ScalarType::U16, large(values.len())).unwrap().leading();
    let mut back = Column::zeros(ScalarType::U16, 0);
    chunk.decode(&mut decoder, &mut back).unwrap();
    assert_eq!(back, values);
}

#[test]
fn what_can_not_be_followed_is_not() {
    let column = Column::U16((0..300).map(|i| i * 7 % 251).collect());
    let mut alone = Vec::new();
    Encoder::new().column(&column, &mut alone).unwrap();
    for leader in [Column::zeros(ScalarType::U16, 299), Column::zeros(ScalarType::F32, 300)] {
        let mut out = Vec::new();
        Encoder::new().column_after(&column, &Passes::default(), &[&leader], &mut out).unwrap();
        assert_eq!(out, alone);
    }
}

#[test]
fn fine_angles_follow_from_positions_which_a_large_cube_does_not_give() {
    let (cube, keys, columns) = flown(2, 2);
    let mut encoder = Encoder::new();
    let passes = encoder.times(&columns[0], cube, &keys, &mut Vec::new()).unwrap();
    let mut places = Vec::new();
    morton::places(cube, keys.iter().map(|key| key ^ cube.first_key().low), &mut places);
    let angles = Column::I16(places.iter().map(|place| (place[0] / 2) as i16 - 500).collect());
    let mut bytes = Vec::new();
    encoder.column_after(&angles, &passes, &[], &mut bytes).unwrap();
    assert!(4 * bytes.len() < keys.len(), "{} bytes for {} points", bytes.len(), keys.len());
    let chunk = ColumnChunk::parse(&bytes, ScalarType::I16, large(keys.len())).unwrap();
    let above = Cube::containing(cube.low(), 30);
    let in_large: Vec<_> = keys.iter().map(|key| Key { high: cube.first_key().high, low: *key }).collect();
    let (mut near, mut far) = (Vec::new(), Vec::new());
    encoder.positions_with(cube, &keys, &passes, &mut near).unwrap();
    encoder.positions_with(above, &in_large, &passes, &mut far).unwrap();
    let mut back = Column::zeros(ScalarType::I16, 0);
    let positions = PositionChunk::parse(&near, cube, large(keys.len())).unwrap();
    chunk.clone().at(&positions).decode(&mut Decoder::new(), &mut back).unwrap();
    assert_eq!(back, angles);
    let positions = PositionChunk::parse(&far, above, large(keys.len())).unwrap();
    let error = chunk.at(&positions).decode(&mut Decoder::new(), &mut back).unwrap_err();
    assert!(matches!(error, CodecError::Range { place: "side of a cube with lines", .. }), "{error}");
}
