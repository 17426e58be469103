//! GeoTIFF keys, as far as they name a CRS.

use super::Crs;

const DIRECTORY: u16 = 34735;
const ASCII: u16 = 34737;
/// Codes of the EPSG register (GeoTIFF 1.0, 2.7.2): 32767 is "defined by other keys", above are private ones.
pub(super) const EPSG_CODES: std::ops::RangeInclusive<u16> = 1024..=32766;

/// The key directory of a [`Crs`].
pub(super) struct GeoKeys<'a> {
    /// Key, location, count, value.
    keys: Vec<[u16; 4]>,
    ascii: &'a [u8],
}

impl<'a> GeoKeys<'a> {
    /// Reads the raw VLRs; keys that are cut off are left out.
    pub fn of(crs: &'a Crs) -> Self {
        let record = |id| crs.geotiff.iter().find(|(record, _)| *record == id).map_or(&[][..], |(_, data)| &data[..]);
        let words: Vec<u16> = record(DIRECTORY).as_chunks::<2>().0.iter().map(|b| u16::from_le_bytes(*b)).collect();
        let (rows, _) = words.as_chunks::<4>();
        let announced = rows.first().map_or(0, |head| head[3]);
        let keys = rows.iter().skip(1).take(announced.into()).copied().collect();
        Self { keys, ascii: record(ASCII) }
    }

    /// No keys at all?
    pub fn is_empty(&self) -> bool {
        self.keys.is_empty()
    }

    /// A key whose value stands in the directory.
    fn short(&self, key: u16) -> Option<u16> {
        self.keys.iter().find(|k| k[0] == key && k[1] == 0).map(|k| k[3])
    }

    fn code(&self, key: u16) -> Option<u32> {
        self.short(key).filter(|code| EPSG_CODES.contains(code)).map(u32::from)
    }

    /// GTModelTypeGeoKey: 1 projected, 2 geographic, 3 geocentric.
    pub fn model(&self) -> Option<u16> {
        self.short(1024)
    }

    /// EPSG code of the horizontal system.
    pub fn horizontal_epsg(&self) -> Option<u32> {
        let (projected, geographic) = (self.short(3072), self.code(2048));
        match self.model() {
            Some(2 | 3) => geographic,
            // A projection of its own on a known geographic system is not that system.
            _ if projected.is_some() => self.code(3072),
            Some(1) => None,
            _ => geographic,
        }
    }

    /// EPSG code of the vertical system.
    pub fn vertical_epsg(&self) -> Option<u32> {
        self.code(4096)
    }

    /// EPSG code of the linear unit.
    pub fn linear_unit(&self) -> Option<u32> {
        self.code(3076)
    }

    /// What a citation key calls the system.
    pub fn citation(&self) -> Option<String> {
        [3073, 1026, 2049].into_iter().find_map(|key| {
            let [_, location, count, value] = *self.keys.iter().find(|k| k[0] == key)?;
            let start = usize::from(value);
            let text = self.ascii.get(start..start + usize::from(count)).filter(|_| location == ASCII)?;
            let text = match std::str::from_utf8(text) {
                Ok(text) => text.to_owned(),
                Err(_) => text.iter().map(|&b| char::from(b)).collect(),
            };
            let text = text.trim_matches(['|', '\0', ' ']).to_owned();
            (!text.is_empty()).then_some(text)
        })
    }
}
