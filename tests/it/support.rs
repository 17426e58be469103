//! What the integration tests share: where the real files are, and a reader of LAS and LAZ that is not Esker's.

use std::fs;
use std::io::{Cursor, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The folder of real point clouds, if there is one.
pub fn data_folder() -> Option<PathBuf> {
    let folder = match std::env::var_os("ESKER_DATA") {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
    };
    if folder.is_dir() {
        return Some(folder);
    }
    println!("no real point clouds at {}: this test has nothing to read", folder.display());
    None
}

/// All files below the data folder with one of these endings, sorted.
pub fn data_files(endings: &[&str]) -> Vec<PathBuf> {
    fn walk(folder: &Path, endings: &[&str], found: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                walk(&path, endings, found);
            } else if path.extension().and_then(|e| e.to_str()).is_some_and(|e| endings.contains(&e)) {
                found.push(path);
            }
        }
    }
    let mut found = Vec::new();
    if let Some(folder) = data_folder() {
        walk(&folder, endings, &mut found);
    }
    found.sort();
    found
}

/// A LAS or LAZ file as raw records, decoded by the `las` and `laz` crates alone.
pub struct RawLas {
    pub header: las::raw::Header,
    pub records: Vec<Vec<u8>>,
}

impl RawLas {
    /// Reads `path`; `None` if these crates can't.
    pub fn read(path: &Path) -> Option<Self> {
        let bytes = fs::read(path).ok()?;
        let mut cursor = Cursor::new(bytes.as_slice());
        let header = las::raw::Header::read_from(&mut cursor).ok()?;
        let size = usize::from(header.point_data_record_length);
        let legacy = u64::from(header.number_of_point_records);
        // The `las` crate knows the 64-bit count of version 1.4 only.
        let large = if header.version.minor >= 4 { bytes.get(247..255) } else { None };
        let count = match large.map(|b| u64::from_le_bytes(b.try_into().unwrap())) {
            Some(large) if large > 0 => large,
            _ => legacy,
        };
        let compressed = header.point_data_record_format & 0x80 != 0;
        let start = u64::from(header.offset_to_point_data);
        let mut data = vec![0; size.checked_mul(usize::try_from(count).ok()?)?];
        if compressed {
            let vlr = laszip_vlr(&bytes, &header)?;
            cursor.seek(SeekFrom::Start(start)).ok()?;
            let decoded = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                let mut decompressor = laz::LasZipDecompressor::new(cursor, vlr).ok()?;
                decompressor.decompress_many(&mut data).ok()
            }));
            decoded.ok()??;
        } else {
            cursor.seek(SeekFrom::Start(start)).ok()?;
            cursor.read_exact(&mut data).ok()?;
        }
        let records = if size == 0 { Vec::new() } else { data.chunks_exact(size).map(<[u8]>::to_vec).collect() };
        Some(Self { header, records })
    }

    /// The records in an order that depends on nothing but themselves.
    pub fn sorted(mut self) -> Vec<Vec<u8>> {
        self.records.sort_unstable();
        self.records
    }
}

fn laszip_vlr(bytes: &[u8], header: &las::raw::Header) -> Option<laz::LazVlr> {
    let mut at = usize::from(header.header_size);
    for _ in 0..header.number_of_variable_length_records {
        let head = bytes.get(at..at + 54)?;
        let length = usize::from(u16::from_le_bytes([head[20], head[21]]));
        let id = u16::from_le_bytes([head[18], head[19]]);
        let body = bytes.get(at + 54..at + 54 + length)?;
        if head[2..18].starts_with(b"laszip encoded") && id == 22204 {
            return laz::LazVlr::from_buffer(body).ok();
        }
        at += 54 + length;
    }
    None
}

/// Runs the program.
pub fn esker(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_esker")).args(arguments).output().unwrap()
}

/// Runs the program, which must succeed; its stdout.
pub fn esker_ok(arguments: &[&str]) -> String {
    let output = esker(arguments);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "esker {arguments:?}: {}\n{stderr}", output.status);
    String::from_utf8(output.stdout).unwrap()
}

/// Runs the program, which must fail with `code` and one line on stderr that contains every one of `words`.
pub fn esker_fails(arguments: &[&str], code: i32, words: &[&str]) {
    let output = esker(arguments);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "esker {arguments:?}\n{stderr}");
    for word in words {
        assert!(stderr.contains(word), "esker {arguments:?}: no '{word}' in\n{stderr}");
    }
    assert!(!stderr.contains("panicked") && !stderr.contains("RUST_BACKTRACE"), "{stderr}");
    if code == 1 {
        let errors = stderr.lines().filter(|l| l.starts_with("esker: ")).count();
        assert!(errors >= 1 && stderr.lines().count() == errors, "not in one line: {stderr}");
    }
}

/// An uncompressed LAS file like `original` with other records.
pub fn las_like(original: &[u8], records: &[Vec<u8>]) -> Vec<u8> {
    let start = u32::from_le_bytes(original[96..100].try_into().unwrap()) as usize;
    let mut file = original[..start].to_vec();
    let count = records.len() as u64;
    let legacy = u32::from_le_bytes(original[107..111].try_into().unwrap());
    if legacy > 0 {
        file[107..111].copy_from_slice(&(count as u32).to_le_bytes());
    }
    if original[25] >= 4 {
        // No EVLRs: they came after the points.
        file[235..247].fill(0);
        file[247..255].copy_from_slice(&count.to_le_bytes());
    }
    file.extend(records.iter().flatten());
    file
}

/// A generator of numbers that is the same everywhere: seeds are printed by the tests that use it.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        // SplitMix64.
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    pub fn below(&mut self, n: u64) -> u64 {
        self.next() % n.max(1)
    }

    /// In `[0, 1)`.
    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for i in (1..items.len()).rev() {
            items.swap(i, self.below(i as u64 + 1) as usize);
        }
    }
}

/// A LAS 1.2 file with one more variable length record.
pub fn with_vlr(file: &[u8], user_id: &str, record_id: u16, data: &[u8]) -> Vec<u8> {
    let number = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap());
    let (points, vlrs) = (number(96), number(100));
    let mut head = [0; 54];
    head[2..2 + user_id.len()].copy_from_slice(user_id.as_bytes());
    head[18..20].copy_from_slice(&record_id.to_le_bytes());
    head[20..22].copy_from_slice(&(data.len() as u16).to_le_bytes());
    let (before, after) = file.split_at(points as usize);
    let mut longer = [before, &head, data, after].concat();
    longer[96..100].copy_from_slice(&(points + 54 + data.len() as u32).to_le_bytes());
    longer[100..104].copy_from_slice(&(vlrs + 1).to_le_bytes());
    longer
}

/// A small LAS 1.2 file on a grid of 0.01, of point format 0 to 3.
pub struct TinyLas {
    format: u8,
    records: Vec<u8>,
}

impl TinyLas {
    pub fn new(format: u8) -> Self {
        Self { format, records: Vec::new() }
    }

    fn record_bytes(&self) -> usize {
        [20, 28, 26, 34][usize::from(self.format)]
    }

    /// A record; `bits` fill its attributes.
    pub fn push(&mut self, at: [i32; 3], bits: u64) {
        let start = self.records.len();
        at.iter().for_each(|v| self.records.extend(v.to_le_bytes()));
        // Intensity, one return of one, class, angle, user data, source.
        self.records.extend(((bits % 1000) as u16).to_le_bytes());
        self.records.extend([0b0000_1001, (bits >> 20 & 15) as u8, 0, (bits >> 30 & 3) as u8]);
        self.records.extend(((bits >> 40 & 3) as u16).to_le_bytes());
        let mut rest = Random(bits);
        while self.records.len() < start + self.record_bytes() {
            self.records.push(if self.format % 2 == 1 && self.records.len() < start + 28 {
                (bits >> 3) as u8 & 0x3f
            } else {
                rest.next() as u8
            });
        }
    }

    pub fn positions(&self) -> Vec<[i32; 3]> {
        let axis = |r: &[u8], i: usize| i32::from_le_bytes(r[4 * i..4 * i + 4].try_into().unwrap());
        self.records.chunks(self.record_bytes()).map(|r| [0, 1, 2].map(|i| axis(r, i))).collect()
    }

    /// The file.
    pub fn bytes(&self) -> Vec<u8> {
        let positions = self.positions();
        let mut file = vec![0_u8; 227];
        file[..4].copy_from_slice(b"LASF");
        file[24..26].copy_from_slice(&[1, 2]);
        file[94..96].copy_from_slice(&227_u16.to_le_bytes());
        file[96..100].copy_from_slice(&227_u32.to_le_bytes());
        file[104] = self.format;
        file[105..107].copy_from_slice(&(self.record_bytes() as u16).to_le_bytes());
        file[107..111].copy_from_slice(&(positions.len() as u32).to_le_bytes());
        for i in 0..3 {
            file[131 + 8 * i..139 + 8 * i].copy_from_slice(&0.01_f64.to_le_bytes());
            let of = |f: fn(i32, i32) -> i32| positions.iter().map(|p| p[i]).reduce(f).unwrap_or(0);
            let bounds = [f64::from(of(i32::max)) * 0.01, f64::from(of(i32::min)) * 0.01];
            file[179 + 16 * i..187 + 16 * i].copy_from_slice(&bounds[0].to_le_bytes());
            file[187 + 16 * i..195 + 16 * i].copy_from_slice(&bounds[1].to_le_bytes());
        }
        file.extend(&self.records);
        file
    }
}
