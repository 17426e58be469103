//! Variable length records before the points (VLRs) and after them (EVLRs), as far as the file really holds them.

use super::extra::{SPEC_USER_ID, has_user_id};
use super::header::Header;
use crate::formats::FormatError;
use crate::formats::file::SourceFile;
use crate::points::RawVlr;

/// Bytes of a VLR's own header.
const VLR_BYTES: u64 = 54;
/// Bytes of an EVLR's own header.
const EVLR_BYTES: u64 = 60;
/// EVLRs longer than this are not kept: they are no metadata.
const LONGEST_EVLR: u64 = 64 << 20;
/// Record id of the waveform data packets.
const WAVEFORM_PACKETS: u16 = 65535;

/// What the records before and after the points came to.
#[derive(Debug, Default)]
pub struct Records {
    /// VLRs, then EVLRs, in the file's order; waveform packets and giants left out.
    pub vlrs: Vec<RawVlr>,
    /// Are all EVLRs there that the header announces (and are there any)?
    pub extended_whole: bool,
    /// Are there waveform packets in the file?
    pub waveforms: bool,
    /// What a user should know.
    pub warnings: Vec<String>,
}

impl Records {
    /// Reads all records that `header` announces and the file holds.
    ///
    /// # Errors
    ///
    /// [`FormatError::Io`] only: a count that lies is a warning.
    pub(in crate::formats) fn read(file: &SourceFile, header: &Header) -> Result<Self, FormatError> {
        let mut records = Self::default();
        let start = u64::from(header.header_bytes);
        let block = file.read_vec(start, header.points_offset - start)?;
        let mut rest = &block[..];
        for read in 0..header.vlrs {
            let Some((vlr, after)) = vlr(rest) else {
                records.warnings.push(format!(
                    "the header announces {} variable length records, {read} of them fit before the points",
                    header.vlrs
                ));
                break;
            };
            records.vlrs.push(vlr);
            rest = after;
        }
        records.read_extended(file, header)?;
        Ok(records)
    }

    fn read_extended(&mut self, file: &SourceFile, header: &Header) -> Result<(), FormatError> {
        let mut offset = header.evlr_offset;
        self.extended_whole = header.evlrs > 0;
        for read in 0..header.evlrs {
            let head = file.read_vec(offset, EVLR_BYTES)?;
            let length = head.get(20..28).and_then(|b| b.try_into().ok()).map(u64::from_le_bytes);
            let end = length.and_then(|l| offset.checked_add(EVLR_BYTES)?.checked_add(l));
            let (Some(length), Some(end)) = (length, end.filter(|&e| e <= file.bytes() && head.len() == 60)) else {
                self.extended_whole = false;
                self.warnings.push(format!(
                    "the header announces {} extended variable length records, {read} of them are in the file",
                    header.evlrs
                ));
                break;
            };
            let mut vlr = RawVlr {
                extended: true,
                user_id: array(&head[2..]),
                record_id: u16::from_le_bytes(array(&head[18..])),
                description: array(&head[28..]),
                data: Vec::new(),
            };
            if vlr.record_id == WAVEFORM_PACKETS && has_user_id(&vlr, SPEC_USER_ID) {
                self.waveforms = true;
            } else if length > LONGEST_EVLR {
                self.warnings.push(format!("an extended variable length record of {length} bytes is not kept"));
            } else {
                vlr.data = file.read_vec(offset + EVLR_BYTES, length)?;
                self.vlrs.push(vlr);
            }
            offset = end;
        }
        Ok(())
    }

    /// The first record with this user id and record id.
    pub fn find(&self, user_id: &[u8], record_id: u16) -> Option<&RawVlr> {
        self.vlrs.iter().find(|v| v.record_id == record_id && has_user_id(v, user_id))
    }
}

/// The VLR at the start of `raw`, and what follows it.
fn vlr(raw: &[u8]) -> Option<(RawVlr, &[u8])> {
    let (head, rest) = raw.split_at_checked(VLR_BYTES as usize)?;
    let length = u16::from_le_bytes(array(&head[20..]));
    let (data, rest) = rest.split_at_checked(length.into())?;
    let vlr = RawVlr {
        extended: false,
        user_id: array(&head[2..]),
        record_id: u16::from_le_bytes(array(&head[18..])),
        description: array(&head[22..]),
        data: data.to_vec(),
    };
    Some((vlr, rest))
}

fn array<const N: usize>(raw: &[u8]) -> [u8; N] {
    std::array::from_fn(|i| raw[i])
}
