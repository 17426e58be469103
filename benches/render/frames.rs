//! Frames as a window draws them: one after the other, nothing brought back.

use super::{Error, RUNS};
use esker::geometry::{Camera, DVec3};
use esker::render::{Palette, PoolPoints, RenderOptions, Renderer, View};
use esker::stream::gpu::DrawList;
use std::time::{Duration, Instant};

/// Frames of a run, on the way around what is looked at: on a graphics card, and where the CPU draws.
const FRAMES: [u32; 2] = [60, 3];

/// The machine's fastest adapter, whose queue the frames are handed to.
pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    frames: u32,
}

impl Gpu {
    /// With a renderer on it.
    pub fn new() -> Result<(Self, Renderer), Error> {
        let adapter = esker::render::adapter(&esker::render::instance(), None)?;
        let (device, queue) = pollster::block_on(
            adapter.request_device(&wgpu::DeviceDescriptor { required_limits: adapter.limits(), ..Default::default() }),
        )?;
        let format = wgpu::TextureFormat::Rgba8Unorm;
        let renderer = Renderer::on_device(device.clone(), queue.clone(), &adapter.get_info(), format)?;
        let frames = FRAMES[usize::from(adapter.get_info().device_type == wgpu::DeviceType::Cpu)];
        Ok((Self { device, queue, frames }, renderer))
    }

    /// Times of a frame that shows `list` and can be picked from, with what the renderer does on this thread for it: for
    /// each run all of its frames, divided by their number. As in a window a second frame is encoded while the adapter
    /// draws the one before.
    pub fn frames(
        &self,
        renderer: &Renderer,
        points: &PoolPoints,
        list: &DrawList,
        camera: &Camera,
        palette: &Palette,
    ) -> Result<[Vec<Duration>; 2], Error> {
        let [width, height] = camera.size_px();
        let output = self.device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba8Unorm,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            view_formats: &[],
        });
        let output = output.create_view(&Default::default());
        let mut canvas = renderer.canvas(true);
        let options = RenderOptions::default();
        let [mut whole, mut encoding] = [const { Vec::new() }; 2];
        for run in 0..=RUNS {
            let (started, mut encoded, mut before) = (Instant::now(), Duration::ZERO, None);
            for frame in 0..self.frames {
                let camera = &around(camera, f64::from(frame) / f64::from(self.frames))?;
                let encoding = Instant::now();
                let mut encoder = self.device.create_command_encoder(&Default::default());
                let view = View { camera, options: &options, palette };
                renderer.encode(&mut canvas, &mut encoder, points, list, view, &output)?;
                let submitted = self.queue.submit([encoder.finish()]);
                encoded += encoding.elapsed();
                if let Some(submission_index) = before.replace(submitted) {
                    let submission_index = Some(submission_index);
                    self.device.poll(wgpu::PollType::Wait { submission_index, timeout: None })?;
                }
            }
            self.device.poll(wgpu::PollType::wait_indefinitely())?;
            // The first makes the targets.
            if run > 0 {
                whole.push(started.elapsed() / self.frames);
                encoding.push(encoded / self.frames);
            }
        }
        Ok([whole, encoding])
    }
}

/// `camera` after this part of the way around its target.
fn around(camera: &Camera, part: f64) -> Result<Camera, Error> {
    let (sin, cos) = (part * std::f64::consts::TAU).sin_cos();
    let from = camera.eye() - camera.target();
    let turned = DVec3::new(cos * from.x - sin * from.y, sin * from.x + cos * from.y, from.z);
    let eye = camera.target() + turned;
    Ok(Camera::new(eye, camera.target(), DVec3::Z, camera.projection(), camera.size_px())?)
}
