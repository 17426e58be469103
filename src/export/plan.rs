//! What an output file will be, from the scans that contribute to it.

use super::returns::{RETURNS, WithoutReturns};
use super::{ExportError, Meeting};
use crate::formats::las::crs_of;
use crate::formats::{LasTarget, LasValues, OutputFormat, OutputPlan, las_field};
use crate::geometry::Pose;
use crate::lattice::{BIAS, Decimal, Lattice, LatticeBox, LatticePoint};
use crate::points::{LasFacts, RawVlr};
use crate::query::OutputForm;
use crate::store::model::{Scan, Site, Slot, StoredAttribute};
use crate::store::{Snapshot, scaled_ends};
use std::collections::{BTreeMap, HashSet};

/// The plan, and what to do with attributes of two kinds.
pub struct Planned {
    /// What the writer is told.
    pub plan: OutputPlan,
    /// What is done to each batch before it is written.
    pub meeting: Meeting,
    /// In LAS, where only some of the scans tell returns.
    pub without_returns: WithoutReturns,
    /// Are all GPS times adjusted standard ones?
    pub standard_gps_time: bool,
    /// What is known of values in the store that are called as a field of LAS and may not be what it holds.
    pub las_values: BTreeMap<String, LasValues>,
    /// What a user should know.
    pub notes: Vec<String>,
}

/// Plans an output of this format. `all_attributes`: nothing was left out by the user. `scale`: what the user asked for.
///
/// # Errors
///
/// [`ExportError::TooWide`], [`ExportError::Scale`], [`ExportError::ScaleOfNoGrid`].
pub fn plan<'s>(
    snapshot: &'s Snapshot,
    form: &OutputForm,
    format: OutputFormat,
    all_attributes: bool,
    scale: Option<[f64; 3]>,
) -> Result<Planned, ExportError> {
    let is_step = |step: &f64| *step > 0.0 && step.is_finite();
    if let Some(scale) = scale.into_iter().flatten().find(|step| !is_step(step)) {
        return Err(ExportError::Scale { scale });
    }
    if scale.is_some() && !is_las(format) {
        return Err(ExportError::ScaleOfNoGrid);
    }
    let scans: Vec<&Scan> = form.scans.iter().filter_map(|&id| snapshot.scan(id)).collect();
    let site = snapshot.site();
    let mut notes = Vec::new();
    let agreed = scale.is_none().then(|| agreed_facts(&scans)).flatten().filter(|_| all_attributes);
    let target = match agreed {
        Some(facts) => LasTarget::AsSource(facts),
        // Other forms have no grid that coordinates must fit.
        None if !is_las(format) => LasTarget::Merged { scale: site.lattice.quantum_f64(), offset: [0.0; 3] },
        None => {
            if scans.len() > 1 && scans.iter().all(|s| s.las.is_some()) && scale.is_none() && all_attributes {
                notes.push(
                    "the scans differ in LAS version, point format, scale, offset, kind of GPS times or extra bytes: written \
                            as LAS 1.4 on the store's own grid"
                        .to_owned(),
                );
            }
            merged(snapshot, &scans, form.bounds, scale)?
        }
    };
    let records_speak = matches!(target, LasTarget::AsSource(_)) && scans.first().is_some_and(|s| says_crs(s, site));
    if let (Some(scale), true) = (scale, is_las(format))
        && let Some(note) = rounding(&site.lattice, scale)
    {
        notes.push(note);
    }
    let meeting = Meeting::of(snapshot, form);
    notes.extend(meeting.notes.iter().cloned());
    let names_of = |s: &&Scan| -> HashSet<&str> {
        s.attributes.iter().filter_map(|&slot| snapshot.attribute(slot)).map(|a| &*a.attribute.name).collect()
    };
    let names: Vec<HashSet<&str>> = scans.iter().map(names_of).collect();
    let has_no_returns = |names: &HashSet<&str>| !RETURNS.iter().any(|name| names.contains(name));
    let without = scans.iter().zip(&names).filter(|(_, names)| has_no_returns(names)).map(|(scan, _)| scan.id);
    let without_returns = WithoutReturns::of(&meeting.attributes, without.filter(|_| is_las(format)).collect());
    notes.extend(without_returns.note());
    for (what, has_no_data) in [("0", false), ("no data", true)] {
        let attributes = meeting.attributes.iter().filter(|a| a.no_data.is_some() == has_no_data);
        let mut lacking: Vec<&str> = attributes.map(|a| &*a.name).collect();
        let having = |name: &&str| names.iter().filter(|names| names.contains(name)).count();
        lacking.retain(|name| (1..scans.len()).contains(&having(name)));
        lacking.retain(|name| without_returns.is_empty() || !RETURNS.contains(name));
        lacking.dedup();
        if !lacking.is_empty() {
            notes.push(format!("some of the scans have no {}: their points have {what} there", lacking.join(", ")));
        }
    }
    // Scans without times say nothing of them.
    let has_times = |(scan, names): (&&'s Scan, &HashSet<&str>)| names.contains("GpsTime").then_some(*scan);
    let timed: Vec<&Scan> = scans.iter().zip(&names).filter_map(has_times).collect();
    let standard = timed.iter().filter(|s| is_standard(s)).count();
    if is_las(format) && standard > 0 && standard < timed.len() {
        notes.push(
            "GPS times of two kinds meet, standard ones and seconds of a week: written as they are and announced as the \
             latter; --split-by scan keeps them apart"
                .to_owned(),
        );
    }
    Ok(Planned {
        plan: OutputPlan {
            lattice: site.lattice.clone(),
            attributes: meeting.attributes.clone(),
            crs: site.crs.clone().filter(|_| !records_speak),
            las: target,
        },
        meeting,
        without_returns,
        standard_gps_time: standard > 0 && standard == timed.len(),
        las_values: if is_las(format) { las_values(snapshot) } else { BTreeMap::new() },
        notes,
    })
}

/// Of all of the store, not of the answer, so that all files of a site are alike.
fn las_values(snapshot: &Snapshot) -> BTreeMap<String, LasValues> {
    let mut all: BTreeMap<String, LasValues> = BTreeMap::new();
    for StoredAttribute { id, attribute } in snapshot.attributes() {
        let name = &attribute.name;
        if let Some(field) = las_field(name)
            && (field.ty != attribute.ty || field.most.is_some())
            && let Some([low, high]) = scaled_ends(snapshot, *id)
        {
            let of_name = |slot: &&Slot| snapshot.attribute(**slot).is_some_and(|a| a.attribute.name == *name);
            let has = snapshot.scans().iter().map(|s| s.attributes.iter().filter(of_name).count());
            let (least, most) = has.fold((usize::MAX, 0), |(least, most), n| (least.min(n), most.max(n)));
            let is_alone = snapshot.attributes().iter().filter(|a| a.attribute.name == *name).count() == 1;
            let known = all.entry(name.clone()).or_insert(LasValues {
                ends: None,
                own_most: 0.0,
                is_one: least == 1 && is_alone,
                is_at_most_one: most < 2,
            });
            if field.ty == attribute.ty {
                known.own_most = known.own_most.max(high);
            } else {
                known.ends = Some(known.ends.map_or([low, high], |[a, b]| [a.min(low), b.max(high)]));
            }
        }
    }
    all
}

/// Do the records of the scan's own file name the site's CRS? They don't where another was given at ingest.
fn says_crs(scan: &Scan, site: &Site) -> bool {
    let Some(own) = scan.las.as_ref().and_then(crs_of) else { return site.crs.is_none() };
    let Some(crs) = &site.crs else { return true };
    if own == *crs {
        return true;
    }
    let is_same = own.same_as(crs);
    let of_heights = crs.vertical_epsg.is_none() || crs.vertical_epsg == own.vertical_epsg;
    of_heights
        && match scan.crs.as_ref() == Some(&own) {
            true => is_same != Some(false),
            false => is_same == Some(true),
        }
}

/// What steps of `scale` do to the coordinates of a lattice, if anything.
fn rounding(lattice: &Lattice, scale: [f64; 3]) -> Option<String> {
    let is_exact = |axis: usize| {
        let rest = Decimal::from_f64(scale[axis]).and_then(|step| lattice.quantum()[axis].checked_rem_euclid(step));
        rest == Some(Decimal::ZERO)
    };
    let step = (0..3).filter(|&axis| !is_exact(axis)).map(|axis| scale[axis]).reduce(f64::max)?;
    Some(format!("coordinates are rounded to steps of {step}: off by up to {} on an axis", step / 2.0))
}

/// Are coordinates 32-bit steps of a grid there?
pub(super) fn is_las(format: OutputFormat) -> bool {
    matches!(format, OutputFormat::Las | OutputFormat::Laz)
}

/// Are its GPS times adjusted standard ones?
fn is_standard(scan: &Scan) -> bool {
    scan.las.as_ref().is_some_and(|l| l.global_encoding & 1 == 1)
}

/// The facts of all scans, if they agree on everything that shapes a record.
fn agreed_facts(scans: &[&Scan]) -> Option<LasFacts> {
    let first = scans.first()?.las.as_ref()?;
    let described = |facts: &LasFacts| {
        let extra = facts.vlrs.iter().filter(|v| describes_extra_bytes(v));
        extra.map(|v| without_ends(&v.data)).collect::<Vec<_>>()
    };
    let same = |other: &LasFacts| {
        first.version == other.version
            && first.point_format == other.point_format
            && first.scale == other.scale
            && first.offset == other.offset
            && first.undescribed_bytes == other.undescribed_bytes
            && first.global_encoding & 1 == other.global_encoding & 1
            && described(first) == described(other)
    };
    // A scan that was moved has its file's grid no more.
    let unmoved = |s: &Scan| Pose::from_matrix(&s.pose).is_ok_and(|p| p.is_identity());
    let all =
        scans.iter().all(|s| s.las.as_ref().is_some_and(same) && s.attributes == scans[0].attributes && unmoved(s));
    let mut facts = all.then(|| first.clone())?;
    if scans.len() > 1 {
        for vlr in facts.vlrs.iter_mut().filter(|v| describes_extra_bytes(v)) {
            vlr.data = without_ends(&vlr.data);
        }
    }
    Some(facts)
}

fn describes_extra_bytes(vlr: &RawVlr) -> bool {
    vlr.user_id.starts_with(b"LASF_Spec") && vlr.record_id == 4
}

/// Descriptions of extra bytes without their least and greatest values, which each file has of its own points.
fn without_ends(described: &[u8]) -> Vec<u8> {
    const BYTES: usize = 192;
    const OPTIONS: usize = 3;
    const ARE_THERE: u8 = 0b110;
    let ends = 64..112;
    let mut described = described.to_vec();
    for one in described.chunks_exact_mut(BYTES) {
        one[OPTIONS] &= !ARE_THERE;
        one[ends.clone()].fill(0);
    }
    described
}

/// The store's own grid, or a scale of the user's, around the middle of the contributing scans, so that the files of
/// neighbouring regions have one grid; around the middle of the answer where scans are too wide for that.
fn merged(
    snapshot: &Snapshot,
    scans: &[&Scan],
    answer: Option<LatticeBox>,
    scale: Option<[f64; 3]>,
) -> Result<LasTarget, ExportError> {
    let lattice = &snapshot.site().lattice;
    let bounds = scans.iter().filter_map(|s| s.bounds).reduce(|a, b| a.union(&b));
    let nowhere = LatticeBox::of(LatticePoint([BIAS as u64; 3]));
    let (bounds, answer) = (bounds.unwrap_or(nowhere), answer.unwrap_or(nowhere));
    let quantum = lattice.quantum_f64();
    let scale = scale.unwrap_or(quantum);
    let mut offset = [0.0; 3];
    for axis in 0..3 {
        let around = |b: &LatticeBox| offset_for(snapshot, axis, b.min.0[axis], b.max.0[axis], scale[axis]);
        let steps = i128::from(answer.max.0[axis] - answer.min.0[axis]);
        let step = lattice.quantum()[axis];
        let width = steps
            .checked_mul(step.mantissa())
            .map_or(steps as f64 * quantum[axis], |mantissa| Decimal::new(mantissa, step.exponent()).to_f64());
        let found = around(&bounds).or_else(|| around(&answer));
        offset[axis] = found.ok_or(ExportError::TooWide { width, axis, scale: scale[axis] })?;
    }
    Ok(LasTarget::Merged { scale, offset })
}

/// A round world coordinate near the middle of an axis from which every index fits 32 bits.
fn offset_for(snapshot: &Snapshot, axis: usize, min: u64, max: u64, scale: f64) -> Option<f64> {
    let lattice = &snapshot.site().lattice;
    let steps = lattice.quantum_f64()[axis] / scale;
    let middle = (min / 2 + max / 2) as i64 + (min % 2 + max % 2) as i64 / 2 - BIAS;
    for digits in (0..=9).rev() {
        let round = 10_i64.pow(digits);
        let steps_from_bias = (middle + round / 2).div_euclid(round) * round;
        let index = (BIAS + steps_from_bias) as u64;
        let reach = index.abs_diff(min).max(index.abs_diff(max)) as f64 * steps;
        if reach < f64::from(i32::MAX) {
            return Some(lattice.world_on_axis(axis, index));
        }
    }
    None
}
