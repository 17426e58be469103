//! What a LAS file will look like: its header, and where every attribute goes.

use super::LasValues;
use super::crs;
use super::extra::{self, ExtraField};
use super::header::{
    CreationDate, EXTERNAL_WAVEFORMS, Header, INTERNAL_WAVEFORMS, STANDARD_TIME, TIME_OFFSET, WKT, append_vlr, is_for,
    padded,
};
use crate::formats::las::layout::record_layout;
use crate::formats::las::says_crs;
use crate::formats::las::tables::{Dimension, PointFormat, XYZ_BYTES};
use crate::formats::write::OutputPlan;
use crate::formats::write::rows::{Put, Slot, Target};
use crate::points::{Attribute, Crs, FieldKind, LasFacts, RawVlr, ScalarType};
use std::collections::BTreeMap;

/// A plan, or why there is none.
pub(super) type Planned = Result<Plan, String>;

/// Everything that is fixed before the first point.
#[derive(Debug)]
pub(super) struct Plan {
    pub header: Header,
    pub slots: Vec<Slot>,
    /// What a user should know.
    pub notes: Vec<String>,
}

/// The plan for a file like its source.
pub(super) fn as_source(plan: &OutputPlan, facts: &LasFacts, compressed: bool, date: CreationDate) -> Planned {
    let mut notes = Vec::new();
    let layout = record_layout(facts).ok_or_else(|| format!("LAS point format {} is unknown", facts.point_format))?;
    let mut version = facts.version;
    if facts.point_format >= 6 && version.1 < 4 {
        notes.push(format!(
            "LAS {}.{} has no point format {}: written as 1.4",
            version.0, version.1, facts.point_format
        ));
        version = (1, 4);
    }
    let mut slots = Vec::new();
    let mut placed = vec![false; plan.attributes.len()];
    for (attribute, field) in layout.attributes.iter().zip(&layout.fields) {
        let Some(column) = plan.attributes.iter().position(|a| a.identity() == attribute.identity()) else { continue };
        placed[column] = true;
        slots.push(Slot { column, offset: XYZ_BYTES + field.offset, put: put_of(field.kind) });
    }
    let lost: Vec<_> =
        plan.attributes.iter().zip(&placed).filter(|(_, p)| !**p).map(|(a, _)| a.name.as_str()).collect();
    if !lost.is_empty() {
        notes.push(format!("not written, since the source's records have no place for it: {}", lost.join(", ")));
    }
    let mut kept = Vec::new();
    let mut waveforms_lost = facts.global_encoding & INTERNAL_WAVEFORMS != 0;
    let mut global_encoding = facts.global_encoding & !INTERNAL_WAVEFORMS;
    let mut records: Vec<RawVlr> = facts.vlrs.clone();
    if let Some(crs) = &plan.crs {
        records.retain(|vlr| !says_crs(vlr));
        // WKT has its place from LAS 1.4 on.
        let keys = (version.1 < 4).then(|| Crs { wkt: None, ..crs.clone() });
        let written = keys.and_then(|keys| crs::vlrs(&keys, &mut Vec::new())).or_else(|| crs::vlrs(crs, &mut notes));
        global_encoding &= !WKT;
        if written.as_ref().is_none_or(|w| w.wkt) && version.1 >= 4 {
            global_encoding |= WKT;
        }
        records.extend(written.into_iter().flat_map(|w| w.vlrs));
    }
    for vlr in &records {
        if is_for(vlr, "laszip encoded") || is_for(vlr, "copc") {
            continue;
        }
        if is_for(vlr, "LASF_Spec") && vlr.record_id == WAVEFORM_PACKETS {
            waveforms_lost = true;
            continue;
        }
        if vlr.extended && version.1 < 4 {
            // Only waveform packets come after the points there; a record that fits moves before them.
            if vlr.data.len() > usize::from(u16::MAX) {
                notes.push(format!("record {} is too long for LAS 1.{} and not kept", vlr.record_id, version.1));
                continue;
            }
            kept.push(RawVlr { extended: false, ..vlr.clone() });
            continue;
        }
        kept.push(vlr.clone());
    }
    if waveforms_lost {
        notes.push("waveform packets are not kept".into());
    }
    if facts.global_encoding & EXTERNAL_WAVEFORMS != 0
        && PointFormat::new(facts.point_format).is_some_and(|f| f.has_wave_packet())
    {
        notes.push("waveform packets stay in the .wdp file beside the source".into());
    }
    if version.1 >= 5 && global_encoding & TIME_OFFSET != 0 {
        notes.push("the offset of GPS times (LAS 1.5) is not kept: 1,000,000,000 s is announced".into());
        global_encoding = global_encoding & !TIME_OFFSET | STANDARD_TIME;
    }
    let header = Header {
        version,
        point_format: facts.point_format,
        compressed,
        record_bytes: record_bytes(layout.stride())?,
        scale: facts.scale,
        offset: facts.offset,
        global_encoding,
        file_source_id: facts.file_source_id,
        guid: facts.guid,
        system_identifier: facts.system_identifier,
        date,
        ..Header::default()
    };
    Ok(Plan { header: with_vlrs(header, &kept)?, slots, notes })
}

/// Record id of the waveform packets' EVLR.
const WAVEFORM_PACKETS: u16 = 65_535;

/// The plan for LAS 1.4 in the smallest of point formats 6, 7 and 8 that holds the attributes.
pub(super) fn merged(
    plan: &OutputPlan,
    scale: [f64; 3],
    offset: [f64; 3],
    compressed: bool,
    date: CreationDate,
    standard_time: bool,
    values: &BTreeMap<String, LasValues>,
) -> Planned {
    let mut notes = Vec::new();
    let has =
        |name: &str| plan.attributes.iter().any(|a| a.name == name && matches!(a.ty, ScalarType::U8 | ScalarType::U16));
    let number = match () {
        () if has("Infrared") => 8,
        () if has("Red") || has("Green") || has("Blue") => 7,
        () => 6,
    };
    let format = PointFormat::new(number).ok_or("no such point format")?;
    let dimensions = format.dimensions();

    let mut slots = Vec::new();
    let mut extras: Vec<(usize, ExtraField)> = Vec::new();
    let mut names = extra::Names::default();
    for (column, attribute) in plan.attributes.iter().enumerate() {
        let known = values.get(&attribute.name);
        if let Some((dimension, put)) = place(&dimensions, attribute).filter(|(_, put)| fits(*put, known)) {
            match put {
                Put::Degrees => notes.push(
                    "ScanAngleRank in whole degrees became ScanAngleRank in steps of 0.006 degrees, rounded".into(),
                ),
                Put::Color => notes.push(format!("{} of 8 bits became 16 bits: times 257", attribute.name)),
                _ => {}
            }
            slots.push(Slot { column, offset: XYZ_BYTES + dimension.offset, put });
        } else {
            let field = names.field(attribute);
            if field.renamed {
                notes.push(format!("{} ({}) is extra byte {:?}", attribute.name, attribute.ty.word(), field.name));
            }
            if let Some(dimension) = dimensions.iter().find(|d| d.name == attribute.name) {
                let (name, ty) = (&attribute.name, attribute.ty.word());
                match known.and_then(|known| converted(dimension, attribute, known)) {
                    Some((put, how)) => {
                        notes.push(format!("{name} is {ty} here: LAS's own field has it {how}, and an extra byte as it is"));
                        slots.push(Slot { column, offset: XYZ_BYTES + dimension.offset, put });
                    }
                    None => notes.push(format!(
                        "{name} is {ty} here, which LAS's own field can't hold: that is 0, and the values are in an extra byte"
                    )),
                }
            }
            extras.push((column, field));
        }
    }
    // What is whole before what is added to it.
    slots.sort_by_key(|s| !matches!(s.put, Put::Whole | Put::Bits { .. }));

    let mut end = format.record_bytes();
    let mut descriptors = Vec::new();
    for (column, field) in &extras {
        let attribute = &plan.attributes[*column];
        slots.push(Slot { column: *column, offset: end, put: Put::Whole });
        end += attribute.ty.size();
        descriptors.extend_from_slice(&field.descriptor(attribute));
    }
    let mut vlrs = Vec::new();
    let mut global_encoding = if standard_time { STANDARD_TIME } else { 0 };
    match plan.crs.as_ref().and_then(|c| crs::vlrs(c, &mut notes)) {
        Some(written) => {
            if written.wkt {
                global_encoding |= WKT;
            }
            vlrs.extend(written.vlrs);
        }
        // Formats 6 and up have it in WKT, if they have one; PDAL refuses a file that says otherwise.
        None => global_encoding |= WKT,
    }
    if !descriptors.is_empty() {
        if descriptors.len() > usize::from(u16::MAX) {
            return Err(format!("{} extra bytes do not fit a LAS file; choose attributes", extras.len()));
        }
        vlrs.push(extra::vlr(descriptors));
    }
    let header = Header {
        version: (1, 4),
        point_format: number,
        compressed,
        record_bytes: record_bytes(end)?,
        scale,
        offset,
        global_encoding,
        system_identifier: padded("EXTRACTION"),
        date,
        ..Header::default()
    };
    Ok(Plan { header: with_vlrs(header, &vlrs)?, slots, notes })
}

/// How numbers of another type come into LAS's own field, by which programs colour and choose points, and that in words; none
/// if not all of them fit, or a point has two.
fn converted(dimension: &Dimension, attribute: &Attribute, known: &LasValues) -> Option<(Put, String)> {
    const MOST: f64 = 65_535.0;
    let [low, high] = known.ends.filter(|_| known.is_at_most_one && attribute.ty != dimension.ty)?;
    let one = known.is_one;
    let is_float = matches!(attribute.ty, ScalarType::F32 | ScalarType::F64);
    let whole = || if is_float { "as the nearest whole number" } else { "as it is" }.to_owned();
    let (to, most) = match (dimension.kind, dimension.ty) {
        (FieldKind::Bits { shift, mask }, _) => (Target::Bits { shift, mask }, f64::from(mask)),
        (FieldKind::Whole, ScalarType::U8) => (Target::U8, 255.0),
        (FieldKind::Whole, ScalarType::U16) => (Target::U16, MOST),
        (FieldKind::Whole, ScalarType::I16) => (Target::I16, 180.0),
        (FieldKind::Whole, ScalarType::F64) => (Target::F64, f64::MAX),
        _ => return None,
    };
    if !(low.is_finite() && high.is_finite()) {
        return None;
    }
    let (low, factor, how) = match dimension.name {
        "Red" | "Green" | "Blue" | "Infrared" => return None,
        // Whole numbers may be degrees or steps of LAS.
        "ScanAngleRank" if is_float && low >= -most && high <= most => {
            (0.0, 1.0 / 0.006, "in steps of 0.006 degrees".to_owned())
        }
        "ScanAngleRank" => return None,
        "GpsTime" => (0.0, 1.0, "as a double".to_owned()),
        "Intensity" if low >= 0.0 && high <= 1.0 && is_float => (0.0, MOST, "times 65,535".to_owned()),
        _ if low >= 0.0 && high <= most => (0.0, 1.0, whole()),
        "Intensity" if one => (low, MOST / (high - low), format!("from {low} to {high} as 0 to 65,535")),
        _ => return None,
    };
    // Where another scan has the column, this one's value for none is added to it.
    if !one && attribute.no_data.is_some() {
        return None;
    }
    // Of stored values.
    let (scale, offset) = attribute.scaling.map_or((1.0, 0.0), |s| (s.scale, s.offset));
    let put = Put::Scaled { low: (low - offset) / scale, factor: factor * scale, to };
    (factor.is_finite() && scale != 0.0 && (one || offset == 0.0)).then_some((put, how))
}

/// Do all values of a column of the field's type go into the bits that it has?
fn fits(put: Put, known: Option<&LasValues>) -> bool {
    match (put, known) {
        (Put::Bits { mask, .. }, Some(known)) => known.own_most <= f64::from(mask),
        _ => true,
    }
}

/// The field of the point format for an attribute of exactly this name and type, or of one that becomes it.
fn place(dimensions: &[Dimension], attribute: &Attribute) -> Option<(Dimension, Put)> {
    let dimension = dimensions.iter().find(|d| d.name == attribute.name)?;
    let put = match (attribute.ty, dimension.name) {
        (ty, _) if ty == dimension.ty => put_of(dimension.kind),
        (ScalarType::I8, "ScanAngleRank") => Put::Degrees,
        (ScalarType::U8, "Red" | "Green" | "Blue" | "Infrared") => Put::Color,
        _ => return None,
    };
    Some((*dimension, put))
}

fn put_of(kind: FieldKind) -> Put {
    match kind {
        FieldKind::Whole => Put::Whole,
        FieldKind::Bits { shift, mask } => Put::Bits { shift, mask },
    }
}

fn record_bytes(bytes: usize) -> Result<u16, String> {
    u16::try_from(bytes).map_err(|_| format!("a record of {bytes} bytes does not fit a LAS file; choose attributes"))
}

fn with_vlrs(mut header: Header, records: &[RawVlr]) -> Result<Header, String> {
    for vlr in records {
        let (count, bytes) = if vlr.extended { &mut header.evlrs } else { &mut header.vlrs };
        *count += 1;
        append_vlr(bytes, vlr, header.version);
    }
    match u32::try_from(header.offset_to_points()) {
        Ok(_) => Ok(header),
        Err(_) => Err("the variable length records are longer than 4 GiB".into()),
    }
}
