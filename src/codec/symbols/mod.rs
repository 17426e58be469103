//! Symbols of a byte, each in as many bits as it is rare in its context: an entropy coder (rANS: Duda 2014, Giesen 2014)
//! whose tables are stored with the symbols.
//!
//! A table stands for a context, which is what the decoder knows of a point: the symbol before it, what another column has
//! there, both, or nothing. Symbols are cut into four runs that are coded side by side, since a step waits for the one
//! before it: each has its own state and its own symbol before, all share one sequence of words.
//!
//! `symbols - 1 u8`; if there are several contexts a bit for each, whether it occurs, and a table for each that does
//! ([`table`]), to a whole byte; four states, `u32`; words, `u16`, to the end.

mod table;

use super::bits::{BitWriter, PADDING};
use super::reader::Reader;
use super::residual::COUNT_LOG;
use super::{BLOCK_POINTS, CodecError};
use std::hint::select_unpredictable;
use table::{Bits, MAX_STORED_BITS, MAX_SYMBOLS};

const PLACE: &str = "coded symbols";

/// Numbers of a table add up to this where there is one table.
pub(super) const ONE_CONTEXT: usize = 1 << 11;

/// And to this where there are many: they are made for each block.
pub(super) const MANY_CONTEXTS: usize = 1 << 9;

/// The most symbols of a table where there are many.
pub(super) const FEW_SYMBOLS: usize = 16;

/// The most contexts.
pub(super) const MAX_CONTEXTS: usize = 256;

/// Runs that are coded side by side.
const RUNS: usize = 4;

/// The symbols of a run, of so many in all; those before the first of a run count as 0. The last may have fewer.
pub(super) fn run_of(count: usize) -> usize {
    count.div_ceil(RUNS).max(1)
}

/// A state is from here to `LEAST << 16`, so that a step reads or writes one word at most.
const LEAST: u32 = 1 << 15;

/// The bytes of the states.
const STATE_BYTES: usize = 4 * RUNS;

/// The most symbols that are coded together.
const MAX_COUNT: usize = BLOCK_POINTS;

/// Steps of all contexts where there are many.
const MANY_STEPS: usize = MAX_CONTEXTS * FEW_SYMBOLS;

/// Room for the words of a block and one that is written and not kept; a power of two, so that places are masked.
const WORDS: usize = 2 * MAX_COUNT;

/// Where in its table a symbol is, made for coding without divisions.
#[derive(Clone, Copy, Debug, Default)]
struct Step {
    /// `2^64 / number`, rounded up: states are below 2^31 and numbers at most 2^11, so the quotient is exact.
    reciprocal: u64,
    /// States from here on give a word away first.
    limit: u32,
    /// Where its numbers begin, and one less than the sum for the number 1.
    bias: u16,
    /// What the numbers of all others add up to.
    others: u16,
}

impl Step {
    fn new(begin: u32, number: u32, sum: u32) -> Self {
        let limit = (LEAST / sum * number) << 16;
        let others = (sum - number) as u16;
        if number == 1 {
            // The quotient by the reciprocal is one too small.
            return Self { limit, reciprocal: u64::MAX, bias: (begin + sum - 1) as u16, others };
        }
        Self { limit, reciprocal: u64::MAX / u64::from(number) + 1, bias: begin as u16, others }
    }

    /// The state after this symbol, for a state below the limit.
    #[inline]
    fn after(&self, state: u32) -> u32 {
        let quotient = ((u128::from(state) * u128::from(self.reciprocal)) >> 64) as u32;
        state + u32::from(self.bias) + quotient * u32::from(self.others)
    }
}

/// Encodes symbols.
#[derive(Debug, Default)]
pub(super) struct SymbolWriter {
    /// How often each symbol is in each context, then its numbers.
    counts: Vec<u32>,
    /// Of one context as many as there are symbols, of many [`FEW_SYMBOLS`] each; only those of what was counted are right.
    steps: Vec<Step>,
    bits: Vec<u8>,
    words: Vec<u16>,
    symbols: usize,
    contexts: usize,
}

impl SymbolWriter {
    /// Counts symbols without contexts and estimates the bytes that they take. There are at most 4,096.
    pub(super) fn count(&mut self, symbols: &[u8]) -> usize {
        let mut tables = [[0_u32; MAX_SYMBOLS]; 4];
        let mut fours = symbols.chunks_exact(4);
        for four in &mut fours {
            tables.iter_mut().zip(four).for_each(|(table, symbol)| table[usize::from(*symbol)] += 1);
        }
        fours.remainder().iter().for_each(|symbol| tables[0][usize::from(*symbol)] += 1);
        self.counts.clear();
        self.counts.extend((0..MAX_SYMBOLS).map(|s| tables[0][s] + tables[1][s] + tables[2][s] + tables[3][s]));
        self.symbols = MAX_SYMBOLS - self.counts.iter().rev().take_while(|n| **n == 0).count();
        self.counts.truncate(self.symbols);
        self.contexts = 1;
        self.estimate()
    }

    /// The same for symbols below `of`, each in the context that stands at its place.
    pub(super) fn count_in(&mut self, symbols: &[u8], contexts: &[u8], of: usize, contexts_of: usize) -> usize {
        // Two tables, since an addition that waits for the one before it is slow.
        let len = (of * contexts_of).min(MANY_STEPS);
        let mut tables = [[0_u16; MANY_STEPS]; 2];
        let place = |symbol: u8, context: u8| (usize::from(context) * of + usize::from(symbol)) % MANY_STEPS;
        let (symbol_pairs, symbol) = symbols.as_chunks::<2>();
        let (context_pairs, context) = contexts.as_chunks::<2>();
        for (symbols, contexts) in symbol_pairs.iter().zip(context_pairs) {
            tables[0][place(symbols[0], contexts[0])] += 1;
            tables[1][place(symbols[1], contexts[1])] += 1;
        }
        for (symbol, context) in symbol.iter().zip(context) {
            tables[0][place(*symbol, *context)] += 1;
        }
        self.counts.clear();
        let [one, other] = &tables;
        self.counts.extend(one[..len].iter().zip(&other[..len]).map(|(n, more)| u32::from(n + more)));
        (self.symbols, self.contexts) = (of, contexts_of);
        self.estimate()
    }

    /// By the information of the symbols; a symbol of a table costs about four bits.
    fn estimate(&self) -> usize {
        let log = &**COUNT_LOG;
        let mut bits = 0.0;
        for table in self.counts.chunks(self.symbols.max(1)) {
            let (mut total, mut used, mut parts) = (0, 0, 0.0);
            for &n in table {
                total += n;
                used += u32::from(n > 0);
                parts += log[n as usize];
            }
            bits += log[total as usize] - parts + (4 * used) as f32;
        }
        bits as usize / 8 + self.contexts.div_ceil(8) + STATE_BYTES - RUNS * 2
    }

    /// Appends the symbols that [`SymbolWriter::count`] counted last.
    pub(super) fn put(&mut self, symbols: &[u8], out: &mut Vec<u8>) {
        self.put_tables::<ONE_CONTEXT>(MAX_SYMBOLS, out);
        // Only symbols are looked at.
        self.put_words::<MAX_SYMBOLS>(symbols, symbols, |symbol, _| usize::from(symbol), out);
    }

    /// Appends the symbols that [`SymbolWriter::count_in`] counted last, in the same contexts.
    pub(super) fn put_in(&mut self, symbols: &[u8], contexts: &[u8], out: &mut Vec<u8>) {
        self.put_tables::<MANY_CONTEXTS>(FEW_SYMBOLS, out);
        let place = |symbol: u8, context: u8| usize::from(context) * FEW_SYMBOLS + usize::from(symbol) % FEW_SYMBOLS;
        self.put_words::<MANY_STEPS>(symbols, contexts, place, out);
    }

    /// Appends tables whose numbers add up to `SUM`, and makes the steps, `stride` for each context.
    fn put_tables<const SUM: usize>(&mut self, stride: usize, out: &mut Vec<u8>) {
        let Self { counts, steps, bits, .. } = self;
        out.push((self.symbols - 1) as u8);
        if steps.is_empty() {
            steps.resize(MANY_STEPS, Step::default());
        }
        let mut writer = BitWriter::new(bits, self.contexts * (1 + MAX_STORED_BITS * self.symbols));
        for (table, steps) in counts.chunks_mut(self.symbols).zip(steps.chunks_mut(stride)) {
            let occurs = table.iter().any(|n| *n > 0);
            if self.contexts > 1 {
                writer.put(occurs.into(), 1);
            }
            if !occurs {
                continue;
            }
            table::put(table, SUM as u32, &mut writer);
            let mut begin = 0;
            for (number, step) in table.iter().zip(steps) {
                if *number > 0 {
                    *step = Step::new(begin, *number, SUM as u32);
                    begin += number;
                }
            }
        }
        let written = writer.finish();
        out.extend_from_slice(&bits[..written]);
    }

    /// Appends states and words; `place` tells where a symbol's step is among the first `STEPS`.
    #[inline(always)]
    fn put_words<const STEPS: usize>(
        &mut self,
        symbols: &[u8],
        contexts: &[u8],
        place: impl Fn(u8, u8) -> usize,
        out: &mut Vec<u8>,
    ) {
        assert!(symbols.len() <= MAX_COUNT && contexts.len() == symbols.len(), "a block has at most so many points");
        let Self { steps, words, .. } = self;
        words.resize(WORDS, 0);
        let (Some(steps), Some(words)) = (steps.first_chunk::<STEPS>(), words.first_chunk_mut::<WORDS>()) else {
            return;
        };
        // Backwards: a decoder takes last what was coded last.
        let mut at = WORDS - 1;
        let mut states = [LEAST; RUNS];
        let mut code = |state: &mut u32, symbol: u8, context: u8| {
            let step = &steps[place(symbol, context)];
            // Written in any case and kept if need be: whether it is can't be foretold, so a branch would cost more.
            words[at % WORDS] = *state as u16;
            let full = *state >= step.limit;
            at = at.wrapping_sub(usize::from(full));
            *state = step.after(select_unpredictable(full, *state >> 16, *state));
        };
        // The last run may be shorter, and even more of them where there are few symbols.
        let run = run_of(symbols.len());
        let mut runs: [&[u8]; RUNS] = cut(symbols, run);
        let mut of_runs: [&[u8]; RUNS] = cut(contexts, run);
        let all = runs[RUNS - 1].len();
        for place in (all..run).rev() {
            for index in (0..RUNS - 1).rev().filter(|index| place < runs[*index].len()) {
                code(&mut states[index], runs[index][place], of_runs[index][place]);
            }
        }
        [&mut runs, &mut of_runs].into_iter().flatten().for_each(|run| *run = &run[..all]);
        let [a, b, c, d] = runs.map(|run| run.iter().rev());
        let [e, f, g, h] = of_runs.map(|run| run.iter().rev());
        let [ref mut first, ref mut second, ref mut third, ref mut fourth] = states;
        for (((a, e), (b, f)), ((c, g), (d, h))) in a.zip(e).zip(b.zip(f)).zip(c.zip(g).zip(d.zip(h))) {
            code(fourth, *d, *h);
            code(third, *c, *g);
            code(second, *b, *f);
            code(first, *a, *e);
        }
        states.iter().for_each(|state| out.extend_from_slice(&state.to_le_bytes()));
        out.extend(words[at % WORDS + 1..].iter().flat_map(|word| word.to_le_bytes()));
    }
}

/// The four runs of a block.
fn cut(all: &[u8], run: usize) -> [&[u8]; RUNS] {
    let mut rest = all;
    [(); RUNS].map(|()| rest.split_off(..run.min(rest.len())).unwrap_or_default())
}

/// Decodes symbols.
#[derive(Debug, Default)]
pub(super) struct SymbolReader {
    bits: Vec<u8>,
    words: Vec<u16>,
    /// For each value that a state's low bits can have: the symbol, its number, and how far into it they are.
    tables: Vec<u32>,
    /// The table of each context.
    of_context: Vec<u16>,
}

impl SymbolReader {
    /// Reads `count` symbols that have no contexts, from all of `bytes`, into `out`, whose content is replaced.
    pub(super) fn read(&mut self, bytes: &[u8], count: usize, out: &mut Vec<u8>) -> Result<(), CodecError> {
        let states = self.prepare::<ONE_CONTEXT>(bytes, 1)?;
        let (tables, _) = self.tables.as_chunks::<ONE_CONTEXT>();
        let Some(table) = tables.first() else { return Ok(()) };
        decode(states, &self.words, count, |_, _| table, out)
    }

    /// The same for symbols in contexts, of which `context` gives that of a place, below `contexts`, by the symbol before
    /// it in its run.
    pub(super) fn read_in(
        &mut self,
        bytes: &[u8],
        count: usize,
        contexts: usize,
        context: impl Fn(u8, usize) -> usize,
        out: &mut Vec<u8>,
    ) -> Result<(), CodecError> {
        let states = self.prepare::<MANY_CONTEXTS>(bytes, contexts)?;
        let (tables, _) = self.tables.as_chunks::<MANY_CONTEXTS>();
        let Some(first) = tables.first() else { return Ok(()) };
        let of_context = &self.of_context;
        let table = |before, i| {
            let table = of_context.get(context(before, i)).map_or(0, |t| usize::from(*t));
            tables.get(table).unwrap_or(first)
        };
        decode(states, &self.words, count, table, out)
    }

    /// Reads the tables, the states, which are given, and the words.
    fn prepare<const SUM: usize>(&mut self, bytes: &[u8], contexts: usize) -> Result<[u32; RUNS], CodecError> {
        let Self { bits, words, tables, of_context } = self;
        let mut reader = Reader::new(bytes);
        let symbols = usize::from(reader.u8(PLACE)?) + 1;
        let limit = if contexts > 1 { FEW_SYMBOLS } else { MAX_SYMBOLS };
        if symbols > limit {
            return Err(CodecError::Range { place: "symbols", found: symbols as u64, limit: limit as u64 });
        }
        bits.clear();
        bits.extend_from_slice(reader.rest());
        bits.resize(bits.len() + PADDING, 0);
        let mut stored = Bits { bytes: bits, len: 8 * reader.rest().len(), at: 0 };
        of_context.clear();
        let mut made = 0;
        let mut numbers = [0; MAX_SYMBOLS];
        for _ in 0..contexts {
            // One that does not occur may have any table.
            of_context.push(made.min(MAX_CONTEXTS - 1) as u16);
            if contexts > 1 && stored.take(1)? == 0 {
                continue;
            }
            let numbers = &mut numbers[..symbols];
            table::read(&mut stored, numbers, SUM as u32)?;
            if tables.len() < (made + 1) * SUM {
                tables.resize((made + 1) * SUM, 0);
            }
            let mut rest = &mut tables[made * SUM..(made + 1) * SUM];
            for (symbol, &number) in (0_u32..).zip(numbers.iter()) {
                let (own, after) = rest.split_at_mut(number as usize);
                own.iter_mut().zip(0_u32..).for_each(|(e, into)| *e = symbol | number << 8 | into << 20);
                rest = after;
            }
            made += 1;
        }
        if made == 0 {
            return Err(CodecError::Range { place: "contexts that occur", found: 0, limit: contexts as u64 });
        }
        reader.take(stored.at.div_ceil(8), PLACE)?;
        let mut states = [0; RUNS];
        for state in &mut states {
            *state = reader.uint(4, PLACE)? as u32;
            if !(LEAST..LEAST << 16).contains(state) {
                let (found, limit) = (u64::from(*state), u64::from(LEAST << 16) - 1);
                return Err(CodecError::Range { place: "state of coded symbols", found, limit });
            }
        }
        let (pairs, odd) = reader.rest().as_chunks::<2>();
        if !odd.is_empty() {
            return Err(CodecError::Length { place: PLACE, expected: 2 * pairs.len(), found: reader.rest().len() });
        }
        words.clear();
        words.extend(pairs.iter().map(|pair| u16::from_le_bytes(*pair)));
        Ok(states)
    }
}

/// Decodes by the table for the symbol before, and the place.
#[inline]
fn decode<'t, const SUM: usize>(
    mut states: [u32; RUNS],
    words: &[u16],
    count: usize,
    table: impl Fn(u8, usize) -> &'t [u32; SUM],
    out: &mut Vec<u8>,
) -> Result<(), CodecError> {
    out.clear();
    out.resize(count, 0);
    let run = run_of(count);
    let mut at = 0;
    let mut before = [0_u8; RUNS];
    let mut step = |index: usize, i: usize, out: &mut u8| {
        let state = &mut states[index];
        let entry = table(before[index], i)[*state as usize % SUM];
        let next = (entry >> 8 & 0xfff) * (*state / SUM as u32) + (entry >> 20);
        let word = words.get(at).copied().unwrap_or(0);
        let short = next < LEAST;
        *state = if short { next << 16 | u32::from(word) } else { next };
        at += usize::from(short);
        *out = entry as u8;
        before[index] = *out;
    };
    let (a, rest) = out.split_at_mut(run.min(count));
    let (b, rest) = rest.split_at_mut(run.min(rest.len()));
    let (c, d) = rest.split_at_mut(run.min(rest.len()));
    let all = d.len();
    let runs = a[..all].iter_mut().zip(&mut b[..all]).zip(c[..all].iter_mut().zip(&mut d[..all]));
    for (place, ((a, b), (c, d))) in runs.enumerate() {
        step(0, place, a);
        step(1, run + place, b);
        step(2, 2 * run + place, c);
        step(3, 3 * run + place, d);
    }
    for place in all..run {
        for (index, run_of) in [&mut *a, &mut *b, &mut *c].into_iter().enumerate() {
            if let Some(out) = run_of.get_mut(place) {
                step(index, index * run + place, out);
            }
        }
    }
    if at == words.len() && states == [LEAST; RUNS] {
        Ok(())
    } else {
        Err(CodecError::Length { place: PLACE, expected: 2 * at, found: 2 * words.len() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Symbols below `of`, the more often the smaller.
    fn skewed(of: usize, len: std::ops::Range<usize>) -> impl Strategy<Value = Vec<u8>> {
        prop::collection::vec((0..of, 0..of, 0..of), len)
            .prop_map(|all| all.iter().map(|(a, b, c)| *a.min(b).min(c) as u8).collect())
    }

    proptest! {
        #[test]
        fn symbols_come_back_and_damage_is_an_error_or_symbols(
            symbols in prop_oneof![skewed(256, 1..600), skewed(3, 1..4096)],
            damage: prop::sample::Index,
            flip in 1_u8..,
            cut: prop::sample::Index,
        ) {
            let (mut writer, mut reader) = (SymbolWriter::default(), SymbolReader::default());
            let mut bytes = vec![9];
            let estimate = writer.count(&symbols);
            writer.put(&symbols, &mut bytes);
            prop_assert!(bytes.len() <= estimate + estimate / 16 + 60 + symbols.len() / 32, "{} {estimate}", bytes.len());
            let bytes = &mut bytes[1..];
            let mut back = vec![7; 3];
            reader.read(bytes, symbols.len(), &mut back).unwrap();
            prop_assert_eq!(&back, &symbols);
            prop_assert!(reader.read(&bytes[..cut.index(bytes.len())], symbols.len(), &mut back).is_err());
            let at = damage.index(bytes.len());
            bytes[at] ^= flip;
            if reader.read(bytes, symbols.len(), &mut back).is_ok() {
                prop_assert_eq!(back.len(), symbols.len());
            }
        }

        #[test]
        fn symbols_in_contexts_come_back_and_damage_is_an_error_or_symbols(
            (of, symbols) in (1_usize..=FEW_SYMBOLS).prop_flat_map(|of| (Just(of), skewed(of, 1..1200))),
            sides in 1_usize..=16,
            damage: prop::sample::Index,
            flip in 1_u8..,
        ) {
            let (mut writer, mut reader) = (SymbolWriter::default(), SymbolReader::default());
            let run = run_of(symbols.len());
            let side = |i: usize| i * i % sides;
            let before = |i: usize| if i.is_multiple_of(run) { 0 } else { usize::from(symbols[i - 1]) };
            let contexts: Vec<_> = (0..symbols.len()).map(|i| (side(i) * of + before(i)) as u8).collect();
            let mut bytes = Vec::new();
            writer.count_in(&symbols, &contexts, of, of * sides);
            writer.put_in(&symbols, &contexts, &mut bytes);
            let mut back = vec![7; 3];
            let context = |before: u8, i: usize| side(i) * of + usize::from(before);
            reader.read_in(&bytes, symbols.len(), of * sides, context, &mut back).unwrap();
            prop_assert_eq!(&back, &symbols);
            let at = damage.index(bytes.len());
            bytes[at] ^= flip;
            if reader.read_in(&bytes, symbols.len(), of * sides, context, &mut back).is_ok() {
                prop_assert_eq!(back.len(), symbols.len());
            }
        }
    }

    /// Ends that only a look at each of them finds.
    #[test]
    fn symbols_end_where_they_began() {
        let symbols = [3; 8];
        let (mut writer, mut reader, mut back) = (SymbolWriter::default(), SymbolReader::default(), Vec::new());
        let mut bytes = Vec::new();
        writer.count(&symbols);
        writer.put(&symbols, &mut bytes);
        // One symbol alone leaves its states as they are, and needs no words.
        let states = bytes.len() - STATE_BYTES;
        let mut with = |state: u32, more: &[u8]| {
            let mut bytes = [&bytes, more].concat();
            bytes[states..states + 4].copy_from_slice(&state.to_le_bytes());
            reader.read(&bytes, symbols.len(), &mut back).map(|()| back.clone())
        };
        assert_eq!(with(LEAST, &[]).unwrap(), symbols);
        let length = |result| matches!(result, Err(CodecError::Length { .. }));
        assert!(length(with(LEAST + 1, &[])), "a state that is not the first one");
        assert!(length(with(LEAST, &[0, 0])), "a word that nobody needs");
        assert!(length(with(LEAST, &[0])), "half a word");
        for state in [LEAST - 1, LEAST << 16] {
            let error = with(state, &[]).unwrap_err();
            assert!(matches!(error, CodecError::Range { place: "state of coded symbols", .. }), "{error}");
        }
    }

    #[test]
    fn contexts_have_few_symbols_and_one_of_them_occurs() {
        let states = [LEAST; RUNS].map(u32::to_le_bytes).concat();
        let read = |head: &[u8]| {
            let bytes = [head, &states].concat();
            SymbolReader::default().read_in(&bytes, 4, 2, |_, _| 0, &mut Vec::new()).map_err(|error| match error {
                CodecError::Range { place, .. } => place,
                _ => "another error",
            })
        };
        // The second context occurs, with the exponents 1 and 0 for two symbols: bits 0, 1, 100 00, 101.
        assert_eq!(read(&[1, 0b1000_0110, 0b10]), Ok(()));
        assert_eq!(read(&[1, 0]), Err("contexts that occur"));
        assert_eq!(read(&[16, 0]), Err("symbols"));
    }
}
