//! From the adapter back to memory.

use super::Image;

/// Bytes of the image copied back at once.
const STRIP_BYTES: u64 = 64 << 20;

/// The image's bytes, in strips of whole rows.
///
/// # Errors
///
/// In the adapter's words.
pub(super) fn image(
    device: &wgpu::Device,
    queue: &wgpu::Queue,
    texture: &wgpu::Texture,
    [width, height]: [u32; 2],
) -> Result<Image, String> {
    let row_bytes = width * 4;
    let padded_bytes = row_bytes.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let strip_rows = (STRIP_BYTES / u64::from(padded_bytes)).clamp(1, u64::from(height)) as u32;
    let buffer = device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("strip"),
        size: u64::from(padded_bytes) * u64::from(strip_rows),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut rgba = Vec::with_capacity(row_bytes as usize * height as usize);
    let mut top = 0;
    while top < height {
        let rows = strip_rows.min(height - top);
        let mut encoder = device.create_command_encoder(&Default::default());
        let mut source = texture.as_image_copy();
        source.origin.y = top;
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(padded_bytes), rows_per_image: None };
        let target = wgpu::TexelCopyBufferInfo { buffer: &buffer, layout };
        encoder.copy_texture_to_buffer(
            source,
            target,
            wgpu::Extent3d { width, height: rows, depth_or_array_layers: 1 },
        );
        queue.submit([encoder.finish()]);
        let (sender, receiver) = std::sync::mpsc::channel();
        buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            // The receiver lives until the result is there.
            let _ = sender.send(result);
        });
        device.poll(wgpu::PollType::wait_indefinitely()).map_err(|e| e.to_string())?;
        receiver.recv().map_err(|e| e.to_string())?.map_err(|e| e.to_string())?;
        let bytes = buffer.get_mapped_range(..).map_err(|e| e.to_string())?;
        for row in bytes.chunks_exact(padded_bytes as usize).take(rows as usize) {
            rgba.extend_from_slice(&row[..row_bytes as usize]);
        }
        drop(bytes);
        buffer.unmap();
        top += rows;
    }
    Ok(Image { width, height, rgba })
}
