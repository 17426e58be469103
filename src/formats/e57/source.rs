//! The scans of an E57 file as [`PointSource`]s.

use super::columns::{Columns, Frame, OutOfLimits, point_bits};
use crate::formats::file::{Buffered, SourceFile};
use crate::formats::guard::catching;
use crate::formats::{FormatError, Piece, PointSource, SourceInfo, Tally};
use crate::geometry::Pose;
use crate::points::{Crs, counted};
use e57::{E57Reader, PointCloud, Record, RecordDataType, RecordName};
use std::io::{self, Read, Seek, SeekFrom};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Bytes read at a time.
const BUFFER_BYTES: usize = 1 << 18;
/// Points decoded at a time.
const RUN_POINTS: u64 = 4096;

/// A file, and readers of it that nobody uses just now: each has looked through all of its XML.
struct Opened {
    file: Arc<SourceFile>,
    idle: Mutex<Vec<Reader>>,
}

impl Opened {
    fn reader(&self) -> Result<Reader, FormatError> {
        let idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner).pop();
        idle.map_or_else(|| Reader::open(&self.file), Ok)
    }

    fn give_back(&self, reader: Reader) {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).push(reader);
    }
}

/// One scan of an open E57 file.
struct E57Source {
    opened: Arc<Opened>,
    info: SourceInfo,
    cloud: PointCloud,
    columns: Columns,
}

/// The scans of an E57 file, in its order.
///
/// # Errors
///
/// [`FormatError::Malformed`] for a bad header, a page with a wrong checksum, XML that names no scan, or a scan without
/// coordinates; [`FormatError::Decoder`] if the crate breaks down.
pub fn open(file: SourceFile) -> Result<Vec<Box<dyn PointSource>>, FormatError> {
    let file = Arc::new(file);
    let reader = Reader::open(&file)?;
    let clouds = reader.e57.pointclouds();
    let xml = reader.e57.header().phys_xml_offset;
    let pictures = reader.e57.images().len();
    if clouds.is_empty() {
        return Err(file.malformed(xml, "a scan in the file", format!("none ({pictures} pictures)")));
    }
    let named = reader.e57.coordinate_metadata().map(str::trim).filter(|text| !text.is_empty()).map(str::to_owned);
    let crs = named.as_deref().and_then(crs_of);
    let opened = Arc::new(Opened { file, idle: Mutex::new(vec![reader]) });
    let mut sources: Vec<Box<dyn PointSource>> = Vec::with_capacity(clouds.len());
    for (index, cloud) in (0..).zip(clouds) {
        let mut source = E57Source::new(&opened, index, cloud, xml)?;
        source.info.crs.clone_from(&crs);
        if let (0, Some(text), None) = (index, &named, &crs) {
            let short: String = text.chars().take(60).collect();
            source.info.warnings.push(format!("its CRS is not understood ('{short}'); --crs can say it"));
        }
        if index == 0 && pictures > 0 {
            source.info.warnings.push(format!("{pictures} pictures in the file are not kept"));
        }
        sources.push(Box::new(source));
    }
    Ok(sources)
}

/// The CRS in a file's `coordinateMetadata`, which should be WKT; some programs write a code instead.
fn crs_of(text: &str) -> Option<Crs> {
    let is_number = text.bytes().all(|b| b.is_ascii_digit());
    if is_number { Crs::parse(&format!("EPSG:{text}")) } else { Crs::parse(text) }
}

impl E57Source {
    fn new(opened: &Arc<Opened>, index: u32, cloud: PointCloud, xml: u64) -> Result<Self, FormatError> {
        let file = &opened.file;
        let malformed = |expected: &str, found: String| {
            file.malformed(xml, format!("{expected} of scan {}", index.saturating_add(1)), found)
        };
        let columns = Columns::new(&cloud.prototype).ok_or_else(|| {
            let names: Vec<_> = cloud.prototype.iter().map(|r| format!("{:?}", r.name)).collect();
            malformed("cartesian or spherical coordinates", names.join(", "))
        })?;
        // The crate would never come to an end of points without bits, and a count may lie.
        let bits = point_bits(&cloud.prototype);
        if bits == 0 && cloud.records > 0 {
            return Err(malformed("a column that is not constant", "none".into()));
        }
        let room = file.bytes().saturating_mul(8).checked_div(bits).unwrap_or(0);
        let found = cloud.records.min(room);
        let mut info = SourceInfo::new(file.path(), "e57", found, cloud.records - found, columns.layout.clone());
        if info.missing > 0 {
            let announced = counted(cloud.records, "point");
            info.warnings.push(format!("the scan announces {announced}, the file holds at most {found}"));
        }
        let is_axis =
            |r: &Record| matches!(r.name, RecordName::CartesianX | RecordName::CartesianY | RecordName::CartesianZ);
        let is_single = |r: &Record| is_axis(r) && matches!(r.data_type, RecordDataType::Single { .. });
        info.is_single = cloud.prototype.iter().any(is_single);
        info.index = index;
        info.scan_name = cloud.name.as_deref().map(str::trim).filter(|n| !n.is_empty()).map(str::to_owned);
        if let Some(t) = &cloud.transform {
            let (q, t) = (&t.rotation, &t.translation);
            info.pose = Pose::from_quaternion([t.x, t.y, t.z], [q.w, q.x, q.y, q.z])
                .map_err(|e| malformed("a pose", e.to_string()))?;
        }
        if columns.frame == Frame::Cartesian && found > 0 {
            info.bounds_hint = bounds(&cloud);
        }
        Ok(Self { opened: opened.clone(), info, cloud, columns })
    }
}

/// The header's bounds, in the scan's frame.
fn bounds(cloud: &PointCloud) -> Option<([f64; 3], [f64; 3])> {
    let b = cloud.cartesian_bounds.as_ref()?;
    let (min, max) = ([b.x_min?, b.y_min?, b.z_min?], [b.x_max?, b.y_max?, b.z_max?]);
    let ordered = (0..3).all(|i| min[i].is_finite() && max[i].is_finite() && min[i] <= max[i]);
    ordered.then_some((min, max))
}

impl PointSource for E57Source {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn warn(&mut self, warning: String) {
        self.info.warnings.push(warning);
    }

    /// One: packets can only be read one after the other.
    fn pieces(&self, _target_records: u64) -> Vec<Piece> {
        if self.info.records == 0 { Vec::new() } else { vec![Piece { first: 0, records: self.info.records }] }
    }

    fn read(&self, piece: Piece, sink: &mut dyn FnMut(&[u8]) -> bool) -> Result<Tally, FormatError> {
        let first = piece.first.min(self.info.records);
        let records = piece.records.min(self.info.records - first);
        let mut tally = Tally::default();
        if records == 0 {
            return Ok(tally);
        }
        let file = &*self.opened.file;
        let Reader { mut e57, place } = self.opened.reader()?;
        let of = format!("the points of scan {}", self.info.index.saturating_add(1));
        let failed = |error: &e57::Error| damage(file, &place, &of, error);
        let broken = |message| FormatError::Decoder {
            path: file.path().to_owned(),
            offset: place.load(Ordering::Relaxed),
            message,
        };
        let mut points = catching(|| e57.pointcloud_raw(&self.cloud)).map_err(broken)?.map_err(|e| failed(&e))?;
        let mut run = Vec::new();
        let mut done = 0;
        while done < first + records {
            let wanted = RUN_POINTS.min(first + records - done);
            run.clear();
            let decoded = catching(|| {
                for _ in 0..wanted {
                    let Some(values) = points.next() else { return Ok(false) };
                    let values = values.map_err(|e| failed(&e))?;
                    self.columns.push(&values, &mut run).map_err(|OutOfLimits| {
                        let offset = place.load(Ordering::Relaxed);
                        file.malformed(
                            offset,
                            format!("values of scan {} within their limits", self.info.index),
                            "others",
                        )
                    })?;
                }
                Ok(true)
            });
            let more = decoded.map_err(broken)??;
            let stride = self.columns.layout.stride();
            let skip = usize::try_from(first.saturating_sub(done)).unwrap_or(usize::MAX).saturating_mul(stride);
            done += wanted;
            if let Some(run) = run.get(skip..).filter(|r| !r.is_empty()) {
                tally.read += (run.len() / stride) as u64;
                if !sink(run) {
                    break;
                }
            }
            if !more {
                tally.truncated = records - tally.read;
                break;
            }
        }
        drop(points);
        self.opened.give_back(Reader { e57, place });
        Ok(tally)
    }
}

/// The crate's reader, and where it last read.
struct Reader {
    e57: E57Reader<Tracked>,
    place: Arc<AtomicU64>,
}

impl Reader {
    fn open(file: &Arc<SourceFile>) -> Result<Self, FormatError> {
        let place = Arc::new(AtomicU64::new(0));
        let tracked = Tracked { inner: Buffered::new(file.clone(), BUFFER_BYTES), place: place.clone() };
        let path = file.path().to_owned();
        let broken = |message| FormatError::Decoder { path, offset: place.load(Ordering::Relaxed), message };
        let e57 = catching(|| E57Reader::new(tracked)).map_err(broken)?;
        let e57 = e57.map_err(|e| damage(file, &place, "an E57 file", &e))?;
        Ok(Self { e57, place })
    }
}

/// Remembers where the last read began: the crate's errors name no place.
struct Tracked {
    inner: Buffered,
    place: Arc<AtomicU64>,
}

impl Read for Tracked {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let at = self.inner.stream_position()?;
        self.place.store(at, Ordering::Relaxed);
        self.inner.read(out)
    }
}

impl Seek for Tracked {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.inner.seek(to)
    }
}

/// The crate's error with the place: that of the page which was read last.
fn damage(file: &SourceFile, place: &AtomicU64, of: &str, error: &e57::Error) -> FormatError {
    let offset = place.load(Ordering::Relaxed);
    let found = error.to_string();
    if let Some(source) = refused_by_system(error) {
        return FormatError::Io { path: file.path().to_owned(), action: "reading", source };
    }
    if found.contains("invalid checksum") {
        return file.malformed(offset, format!("a page of {of} with the right checksum (CRC)"), "another checksum");
    }
    file.malformed(offset, of, format!("what its reader refuses: {found}"))
}

/// The system's own error, if that is what stopped the crate.
fn refused_by_system(error: &e57::Error) -> Option<io::Error> {
    let mut cause: Option<&dyn std::error::Error> = Some(error);
    while let Some(error) = cause {
        let code = error.downcast_ref::<io::Error>().and_then(io::Error::raw_os_error);
        if let Some(code) = code {
            return Some(io::Error::from_raw_os_error(code));
        }
        cause = error.source();
    }
    None
}
