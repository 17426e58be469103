use super::super::ranked::is_sortable;
use super::*;
use proptest::prelude::*;

/// A scanner that flies along y and sweeps along x: places in no order, and their numbers.
fn flight(passes: u32, period: u64, pulse: f64, jitter: i32, seed: u64) -> Vec<(Place, u64)> {
    let mut state = seed | 1;
    let mut noise = move |n: i32| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        if n == 0 { 0 } else { (state % (2 * n as u64 + 1)) as i32 - n }
    };
    let mut points = Vec::new();
    for pass in 0..passes {
        for line in 0..30 {
            for shot in 0..20 {
                let time = f64::from(pass) * 1e9 + f64::from(line) * period as f64 + f64::from(shot) * pulse;
                let place = [shot * 20 + noise(jitter), line * 25 + noise(jitter), 500 + noise(jitter)];
                points.push((place.map(|c| c.max(0)), time.round() as u64));
            }
        }
    }
    // As key order jumbles them, and as all points of a block have one order on both sides.
    points.sort_by_key(|(place, _)| (place[1] / 64, place[0] / 64, place[1], place[0]));
    points
}

/// The same numbers as ticks of a clock, rounded.
fn by_clock(points: Vec<(Place, u64)>, tick: f64) -> Vec<(Place, u64)> {
    points.into_iter().map(|(place, ticks)| (place, (ticks as f64 * tick).round() as u64)).collect()
}

fn encode(points: &[(Place, u64)]) -> Option<(BlockPasses, Vec<u8>)> {
    let values: Vec<u64> = points.iter().map(|p| p.1).collect();
    let most = values.iter().copied().max().unwrap_or(0);
    if !is_sortable(most) {
        return None;
    }
    let mut buffers = Buffers { values, ..Buffers::default() };
    let mut passes = BlockPasses { places: points.iter().map(|p| p.0).collect(), ..BlockPasses::default() };
    buffers.rank.sort(&buffers.values, most);
    let mut bytes = Vec::new();
    let found = try_put(&mut StreamWriter::default(), &mut buffers, &mut passes, |_| (), &mut bytes);
    found.then_some((passes, bytes))
}

fn decode(points: &[(Place, u64)], passes: &BlockPasses, bytes: &[u8]) -> Result<Vec<u64>, CodecError> {
    let mut decoder = Decoder::new();
    decoder.places = points.iter().map(|p| p.0).collect();
    decoder.passes = passes.of_point.clone();
    read(&mut decoder, Reader::new(bytes), passes.count).map(|()| decoder.values)
}

proptest! {
    #[test]
    fn flights_come_back(
        passes in 1_u32..4,
        period in 3_000_u64..1_000_000,
        pulse in 1.0_f64..60.0,
        jitter in 0_i32..30,
        seed: u64,
        tick in prop_oneof![Just(1.0), 100.0_f64..5000.0],
    ) {
        let points = by_clock(flight(passes, period, pulse, jitter, seed), tick);
        if let Some((passes, bytes)) = encode(&points) {
            prop_assert_eq!(decode(&points, &passes, &bytes).unwrap(), points.iter().map(|p| p.1).collect::<Vec<_>>());
        }
    }

    #[test]
    fn any_numbers_come_back(
        numbers in prop::collection::vec(0_u64..1 << 52, 256..400),
        places in prop::collection::vec(prop::array::uniform3(0_i32..1 << 21), 400),
        shift in 0_u32..40,
    ) {
        let points: Vec<_> = places.into_iter().zip(numbers.iter().map(|n| n >> shift)).collect();
        if let Some((passes, bytes)) = encode(&points) {
            prop_assert_eq!(decode(&points, &passes, &bytes).unwrap(), points.iter().map(|p| p.1).collect::<Vec<_>>());
        }
    }

    #[test]
    fn damaged_lines_are_errors_or_other_numbers(at: prop::sample::Index, to: u8, seed: u64, clock: bool) {
        let points = by_clock(flight(2, 50_000, 13.4, 2, seed), if clock { 1467.4587 } else { 1.0 });
        let (passes, mut bytes) = encode(&points).unwrap();
        let at = at.index(bytes.len());
        bytes[at] = to;
        if let Ok(numbers) = decode(&points, &passes, &bytes) {
            prop_assert_eq!(numbers.len(), points.len());
        }
        prop_assert!(decode(&points, &passes, &bytes[..at]).is_err());
    }
}

#[test]
fn a_steady_flight_takes_little() {
    let points = flight(2, 50_000, 13.4, 0, 1);
    let (_, bytes) = encode(&points).expect("the flight has lines");
    // As ranks, 11 bits a point and a table.
    assert!(2 * bytes.len() < points.len(), "{} bytes for {} points", bytes.len(), points.len());
}

#[test]
fn what_is_below_a_tick_takes_little() {
    let points = flight(2, 50_000, 13.4, 0, 1);
    let (_, plain) = encode(&points).expect("the flight has lines");
    let (_, bytes) = encode(&by_clock(points.clone(), 1467.4587)).expect("the flight has lines");
    // For each first point of a line the bits of a tick, for each other one if it was rounded up or down.
    assert!(4 * (bytes.len() - plain.len()) < points.len(), "{} bytes, {} in ticks", bytes.len(), plain.len());
}

#[test]
fn units_and_lines_have_limits() {
    let mut bytes = Vec::new();
    let read = |pulse: u64, lines: [u64; 2], bytes: &mut Vec<u8>| {
        bytes.clear();
        [pulse, 0].iter().for_each(|v| put_varint(*v, bytes));
        for lines in lines {
            put_varint(lines, bytes);
            bytes.extend([0; 8]);
        }
        Model::default().read(&mut Reader::new(bytes), 2, 10).map_err(|error| match error {
            CodecError::Range { place, .. } => place,
            _ => "another error",
        })
    };
    assert_eq!(read(ONE_PULSE, [6, 4], &mut bytes), Ok(()));
    assert_eq!(read(ONE_PULSE - 1, [6, 4], &mut bytes), Err("ticks a pulse"));
    assert_eq!(read(ONE_PULSE, [6, 5], &mut bytes), Err("lines of a pass"));
    assert_eq!(read(ONE_PULSE, [10, 0], &mut bytes), Err("lines of a pass"));
}
