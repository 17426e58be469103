//! Blocks of numbers that follow those of other columns: what one colour does from point to point, the others nearly do.
//!
//! `leaders u8`, 1 or 2; per leader its rate as a zigzag varint, in 2^-24 numbers for each of the leader's; a byte, how the
//! residuals are stored. A residual is what a number is more than the one before it, less
//! `(rates . what the leaders' values are more than at the point before) + 2^23 >> 24`; before the first point all are 0.

use super::CodecError;
use super::numbers::{Numbers, add_up_bytes, unzigzag, unzigzag_byte, zigzag, zigzag_byte};
use super::reader::{Reader, put_varint};
use super::residual::{SAMPLE, plan, plan_all, put_residuals, read_residuals, sample};
use super::stream::{StreamReader, StreamWriter};

/// The most columns that one may follow.
pub(super) const MAX_LEADERS: usize = 2;

/// The values of the columns that are followed, for the points of a block.
pub(super) type Leaders<'a> = [Option<&'a [u16]>; MAX_LEADERS];

/// Fraction bits of a rate.
const RATE_BITS: u32 = 24;

/// Half of one.
const HALF: i64 = 1 << (RATE_BITS - 1);

/// Every so many of a sample are looked at for a fit.
const FIT_STRIDE: usize = 3;

/// How often a fit leaves out what is farther off than usual.
const REFITS: usize = 3;

/// How residuals are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    /// A stream of a byte a residual: its zigzag modulo 256, since numbers are below that.
    Bytes,
    /// Residuals' zigzags modulo 2^64, as residuals.
    Wide,
}

/// Rates, for numbers of so many values a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Choice {
    rates: [i64; MAX_LEADERS],
    leaders: usize,
    step: u64,
}

impl Choice {
    /// Is it for such numbers, and better than differences alone?
    pub(super) fn fits(self, step: u64) -> bool {
        self.step == step && self.rates != [0; MAX_LEADERS]
    }
}

/// What is expected at a point, for differences of one or two leaders.
#[inline]
fn expected(rates: [i64; MAX_LEADERS], [a, b]: [i64; MAX_LEADERS]) -> i64 {
    rates[0].wrapping_mul(a).wrapping_add(rates[1].wrapping_mul(b)).wrapping_add(HALF) >> RATE_BITS
}

/// Differences from the point before: of the leaders, and of the number.
type Pair = ([i64; MAX_LEADERS], i64);

/// Finds how `count` numbers, the greatest of them `most`, follow the leaders; `step` is what a number is in values. What
/// holds for one block holds for its neighbours.
pub(super) fn choose(
    count: usize,
    most: u64,
    step: u64,
    leaders: Leaders,
    number: impl Fn(usize) -> u64,
) -> Option<Choice> {
    let [Some(first), second] = leaders else { return None };
    let second = second.filter(|second| second.len() == count);
    if first.len() != count || most > u64::from(u16::MAX) {
        return None;
    }
    let mut pairs: Vec<Pair> = Vec::with_capacity(SAMPLE);
    for run in sample(count) {
        pairs.extend((run.start.max(1)..run.end).map(|i| {
            let difference = |leader: &[u16]| i64::from(leader[i]) - i64::from(leader[i - 1]);
            ([difference(first), second.map_or(0, difference)], (number(i) as i64) - (number(i - 1) as i64))
        }));
    }
    let one = (1_i64 << RATE_BITS) as f64;
    let whole = |rates: [f64; MAX_LEADERS]| rates.map(|rate| (rate * one).round() as i64);
    let of_values = |rates: [f64; MAX_LEADERS]| whole(rates.map(|rate| rate / step as f64));
    let fitted = whole(fit(&pairs, second.is_some()));
    let alike = if second.is_some() { of_values([0.5, 0.5]) } else { of_values([1.0, 0.0]) };
    let as_last = if second.is_some() { of_values([0.0, 1.0]) } else { alike };
    let mut off = [0; SAMPLE];
    let mut cost = |rates: [i64; MAX_LEADERS]| {
        let mut all = 0;
        for (place, &(leaders, number)) in off.iter_mut().zip(&pairs) {
            *place = zigzag(number.wrapping_sub(expected(rates, leaders)) as u64);
            all |= *place;
        }
        plan(&off[..pairs.len()], u64::BITS - all.leading_zeros(), count).cost_bits
    };
    let mut best = ([0; MAX_LEADERS], cost([0; MAX_LEADERS]));
    for rates in [alike, as_last, fitted] {
        let cost = cost(rates);
        if cost < best.1 {
            best = (rates, cost);
        }
    }
    Some(Choice { rates: best.0, leaders: 1 + usize::from(second.is_some()), step })
}

/// Least squares without what is far off: colours jump where something else begins.
fn fit(pairs: &[Pair], two: bool) -> [f64; MAX_LEADERS] {
    let mut rates = [0.0; MAX_LEADERS];
    let mut limit = f64::INFINITY;
    for _ in 0..=REFITS {
        let [mut aa, mut ab, mut bb, mut ay, mut by] = [0.0; 5];
        for &([a, b], y) in pairs.iter().step_by(FIT_STRIDE) {
            let (a, b, y) = (a as f64, b as f64, y as f64);
            if (y - rates[0] * a - rates[1] * b).abs() <= limit {
                (aa, ab, bb, ay, by) = (aa + a * a, ab + a * b, bb + b * b, ay + a * y, by + b * y);
            }
        }
        let determinant = aa * bb - ab * ab;
        rates = if two && determinant > 1e-9 * aa * bb {
            [(ay * bb - by * ab) / determinant, (by * aa - ay * ab) / determinant]
        } else if aa > 0.0 {
            [ay / aa, 0.0]
        } else {
            [0.0; MAX_LEADERS]
        };
        let (mut sum, mut n) = (0.0, 0.0);
        for &([a, b], y) in pairs.iter().step_by(FIT_STRIDE) {
            sum += (y as f64 - rates[0] * a as f64 - rates[1] * b as f64).abs();
            n += 1.0;
        }
        limit = sum / f64::max(n, 1.0) + 0.01;
    }
    rates
}

/// The differences of the leaders from the point before, point by point.
fn steps<'a>(leaders: [&'a [u16]; MAX_LEADERS]) -> impl Iterator<Item = [i64; MAX_LEADERS]> + 'a {
    let mut before = [0; MAX_LEADERS];
    leaders[0].iter().zip(leaders[1]).map(move |(a, b)| {
        let now = [i64::from(*a), i64::from(*b)];
        let [x, y] = std::mem::replace(&mut before, now);
        [now[0] - x, now[1] - y]
    })
}

/// Appends the numbers as [`choose`] found best; `narrow` says that none is above 255.
pub(super) fn put<N: Copy + Into<u64>>(
    streams: &mut StreamWriter,
    numbers: &[N],
    leaders: Leaders,
    choice: Choice,
    narrow: bool,
    (bytes, wide): (&mut Vec<u8>, &mut Vec<u64>),
    out: &mut Vec<u8>,
) {
    let Choice { rates, leaders: count, .. } = choice;
    let first = leaders[0].unwrap_or_default();
    let leaders = [first, leaders[1].filter(|_| count > 1).unwrap_or(first)];
    out.push(count as u8);
    rates[..count].iter().for_each(|rate| put_varint(zigzag(*rate as u64), out));
    let mut before = 0_u64;
    let residuals = numbers.iter().zip(steps(leaders)).map(|(number, step)| {
        let number = (*number).into();
        let difference = number.wrapping_sub(std::mem::replace(&mut before, number));
        difference.wrapping_sub(expected(rates, step) as u64)
    });
    if narrow {
        out.push(Way::Bytes as u8);
        bytes.clear();
        bytes.extend(residuals.map(|residual| zigzag_byte(residual as u8)));
        streams.put(bytes, out);
    } else {
        out.push(Way::Wide as u8);
        wide.clear();
        wide.extend(residuals.map(zigzag));
        let (plan, bits) = plan_all(wide);
        put_residuals(streams, wide.iter().copied(), bits, plan.mantissa, out);
    }
}

/// Reads `count` numbers, up to the end of the block, into one of the buffers.
pub(super) fn read<'a>(
    streams: &mut StreamReader,
    mut reader: Reader,
    count: usize,
    leaders: Leaders,
    bytes: &'a mut Vec<u8>,
    wide: &'a mut Vec<u64>,
) -> Result<Numbers<'a>, CodecError> {
    const LEADERS: &str = "columns that are followed";
    const WAY: &str = "way of residuals";
    let found = reader.u8(LEADERS)?;
    let leader_count = usize::from(found);
    if !(1..=MAX_LEADERS).contains(&leader_count) {
        return Err(CodecError::Range { place: LEADERS, found: found.into(), limit: MAX_LEADERS as u64 });
    }
    let mut rates = [0; MAX_LEADERS];
    for rate in &mut rates[..leader_count] {
        *rate = unzigzag(reader.varint("rate of a column")?) as i64;
    }
    let mut given = leaders.into_iter().map(|leader| leader.filter(|values| values.len() == count));
    let first = given.next().flatten().ok_or(CodecError::NoLeader)?;
    let leaders = [first, if leader_count > 1 { given.next().flatten().ok_or(CodecError::NoLeader)? } else { first }];
    let way = reader.u8(WAY)?;
    if way == Way::Bytes as u8 {
        streams.read(&mut reader, count, bytes)?;
        reader.end("bytes after the residuals")?;
        add_expected_bytes(bytes, leaders, rates);
        add_up_bytes(bytes);
        Ok(Numbers::Bytes(bytes))
    } else if way == Way::Wide as u8 {
        read_residuals(streams, reader, count, u64::BITS, wide)?;
        let mut number = 0_u64;
        for (value, step) in wide.iter_mut().zip(steps(leaders)) {
            number = number.wrapping_add(unzigzag(*value)).wrapping_add(expected(rates, step) as u64);
            *value = number;
        }
        Ok(Numbers::Wide(wide))
    } else {
        Err(CodecError::Range { place: WAY, found: way.into(), limit: Way::Wide as u64 })
    }
}

/// Residuals as bytes to what each number is more than the one before it, modulo 256. Apart from their sum, so that the
/// compiler takes several at a time; of [`expected`] only 32 bits matter.
fn add_expected_bytes(bytes: &mut [u8], [a, b]: [&[u16]; MAX_LEADERS], rates: [i64; MAX_LEADERS]) {
    let [rate_a, rate_b] = rates.map(|rate| rate as u32);
    let more = |residual: &mut u8, a: u32, b: u32| {
        let expected =
            rate_a.wrapping_mul(a).wrapping_add(rate_b.wrapping_mul(b)).wrapping_add(HALF as u32) >> RATE_BITS;
        *residual = unzigzag_byte(*residual).wrapping_add(expected as u8);
    };
    let Some((first, later)) = bytes.split_first_mut() else { return };
    let (Some((&a0, a_later)), Some((&b0, b_later))) = (a.split_first(), b.split_first()) else { return };
    more(first, a0.into(), b0.into());
    let steps_a = a.iter().zip(a_later).map(|(before, now)| u32::from(*now).wrapping_sub((*before).into()));
    let steps_b = b.iter().zip(b_later).map(|(before, now)| u32::from(*now).wrapping_sub((*before).into()));
    later.iter_mut().zip(steps_a.zip(steps_b)).for_each(|(residual, (a, b))| more(residual, a, b));
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_that_follow_others_come_back(
            red in prop::collection::vec(any::<u16>(), 1..600),
            (slope, noise, shift) in (0_u32..3, 1_u64..40, 0_u32..9),
            two: bool,
        ) {
            let count = red.len();
            let numbers: Vec<u64> = red.iter().zip(0..).map(|(r, i)| (u64::from(*r) >> shift) * u64::from(slope) / 2 + i * i % noise).collect();
            let green: Vec<u16> = red.iter().map(|r| r.rotate_left(3)).collect();
            let most = numbers.iter().copied().max().unwrap();
            let leaders: Leaders = [Some(&red), two.then_some(&green[..])];
            let choice = choose(count, most, 1 << shift, leaders, |i| numbers[i]);
            prop_assert_eq!(choice.is_some(), most <= 0xffff);
            let Some(choice) = choice else { return Ok(()) };
            let (mut bytes, mut wide, mut out) = (Vec::new(), Vec::new(), Vec::new());
            put(&mut StreamWriter::default(), &numbers, leaders, choice, most < 256, (&mut bytes, &mut wide), &mut out);
            let mut read = |leaders| {
                let (mut streams, mut back) = (StreamReader::default(), vec![1]);
                let numbers = read(&mut streams, Reader::new(&out), count, leaders, &mut bytes, &mut back)?;
                Ok(match numbers {
                    Numbers::Bytes(bytes) => bytes.iter().map(|n| u64::from(*n)).collect(),
                    Numbers::Wide(wide) => wide.to_vec(),
                })
            };
            prop_assert_eq!(read(leaders).unwrap(), numbers);
            prop_assert_eq!(read([None; 2]), Err(CodecError::NoLeader));
            prop_assert_eq!(read([Some(&red[1..]), None]), Err(CodecError::NoLeader));
        }
    }

    #[test]
    fn one_of_a_kind_is_found() {
        let pairs: Vec<Pair> = (0..600_i64).map(|i| ([i * 37 % 101 - 50, i * 11 % 71 - 35], 0)).collect();
        let told = |[a, b]: [i64; 2], i: i64| 3 * a - 2 * b + if i % 7 == 0 { 900 } else { 0 };
        let pairs: Vec<Pair> = pairs.iter().zip(0..).map(|(p, i)| (p.0, told(p.0, i))).collect();
        let [a, b] = fit(&pairs, true);
        assert!((a - 3.0).abs() < 0.2 && (b + 2.0).abs() < 0.2, "{a} {b}");
    }

    #[test]
    fn one_or_two_are_followed_in_steps_of_their_own() {
        let leaders: Leaders = [Some(&[1; 4]), Some(&[2; 4])];
        for found in [0, 3] {
            let (mut bytes, mut wide) = (Vec::new(), Vec::new());
            let head = [found, 0, 0, 0, 0];
            let reader = Reader::new(&head);
            let error = read(&mut StreamReader::default(), reader, 4, leaders, &mut bytes, &mut wide);
            let limit = MAX_LEADERS as u64;
            let place = "columns that are followed";
            assert_eq!(error.unwrap_err(), CodecError::Range { place, found: found.into(), limit });
        }
        let choice = Choice { rates: [1, 0], leaders: 1, step: 2 };
        assert_eq!([1, 2].map(|step| choice.fits(step)), [false, true]);
    }
}
