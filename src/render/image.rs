//! A finished picture, and its way to a file.

use super::RenderError;
use std::fs::{self, File};
use std::io::Write;
use std::path::Path;

/// Pixels, row by row from the top left corner.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// `width * height * 4` bytes: red, green, blue, sRGB-coded, and alpha, not premultiplied.
    pub rgba: Vec<u8>,
}

impl Image {
    /// The pixel in column `x` of row `y`.
    ///
    /// # Panics
    ///
    /// If there is no such pixel.
    pub fn pixel(&self, x: u32, y: u32) -> [u8; 4] {
        let start = (y as usize * self.width as usize + x as usize) * 4;
        std::array::from_fn(|i| self.rgba[start + i])
    }

    /// The picture as a PNG file, without alpha where everything is opaque.
    ///
    /// # Errors
    ///
    /// [`RenderError::Encode`] if there are not as many pixels as the picture's size says.
    pub fn to_png(&self) -> Result<Vec<u8>, RenderError> {
        let mut bytes = Vec::new();
        let opaque = self.rgba.chunks_exact(4).all(|pixel| pixel[3] == 255);
        let mut encoder = png::Encoder::new(&mut bytes, self.width, self.height);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        encoder.set_color(if opaque { png::ColorType::Rgb } else { png::ColorType::Rgba });
        let mut writer = encoder.write_header()?;
        if opaque {
            let rgb: Vec<u8> = self.rgba.chunks_exact(4).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect();
            writer.write_image_data(&rgb)?;
        } else {
            writer.write_image_data(&self.rgba)?;
        }
        writer.finish()?;
        Ok(bytes)
    }

    /// Writes [`Image::to_png`]. The file appears when it is complete: until then it has a temporary name beside `path`, and
    /// it is removed if anything fails.
    ///
    /// # Errors
    ///
    /// [`RenderError::Exists`] if the file is there and `force` isn't given; [`RenderError::Write`] and
    /// [`RenderError::Encode`] if it can't be made.
    pub fn write_png(&self, path: impl AsRef<Path>, force: bool) -> Result<(), RenderError> {
        let path = path.as_ref();
        if !force && path.symlink_metadata().is_ok() {
            return Err(RenderError::Exists(path.to_owned()));
        }
        let failed = |source| RenderError::Write { path: path.to_owned(), source };
        let name = path.file_name().ok_or_else(|| failed(std::io::ErrorKind::InvalidInput.into()))?;
        let bytes = self.to_png()?;
        let temporary = path.with_file_name(format!(".{}.{}.part", name.to_string_lossy(), std::process::id()));
        let written = write_whole(&temporary, &bytes).and_then(|()| fs::rename(&temporary, path));
        if written.is_err() {
            // It may not exist, and the error that matters is the first.
            let _ = fs::remove_file(&temporary);
        }
        written.map_err(failed)
    }
}

fn write_whole(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(path: &Path) -> (png::ColorType, Vec<u8>) {
        let mut reader = png::Decoder::new(std::io::BufReader::new(File::open(path).unwrap())).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        bytes.truncate(info.buffer_size());
        (info.color_type, bytes)
    }

    #[test]
    fn a_png_holds_the_pixels_and_replaces_only_by_force() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let opaque = Image { width: 2, height: 1, rgba: vec![1, 2, 3, 255, 4, 5, 6, 255] };
        opaque.write_png(&path, false).unwrap();
        assert_eq!(read(&path), (png::ColorType::Rgb, vec![1, 2, 3, 4, 5, 6]));

        let clear = Image { width: 1, height: 1, rgba: vec![1, 2, 3, 0] };
        assert!(matches!(clear.write_png(&path, false), Err(RenderError::Exists(_))));
        assert_eq!(read(&path).1.len(), 6);
        clear.write_png(&path, true).unwrap();
        assert_eq!(read(&path), (png::ColorType::Rgba, vec![1, 2, 3, 0]));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file stays");
    }

    #[test]
    fn a_picture_that_cannot_be_written_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let image = Image { width: 1, height: 1, rgba: vec![0; 4] };
        assert!(matches!(image.write_png(folder.path().join("no/a.png"), false), Err(RenderError::Write { .. })));
        let short = Image { width: 3, height: 3, rgba: vec![0; 4] };
        assert!(matches!(short.write_png(folder.path().join("a.png"), false), Err(RenderError::Encode(_))));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
