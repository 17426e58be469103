//! The graphics side of the window: surface, device, the picture that is shown.
//!
//! Points and panels are drawn into a texture of our own and copied to the window from there. So a screenshot can have
//! either, the window's own format does not matter, and a window that is lost or has no size stops nothing.

use super::ViewerError;
use crate::geometry::Camera;
use crate::render::{Canvas, Image, Palette, PickRequest, PoolPoints, RenderOptions, Renderer, View};
use crate::stream::Limits;
use crate::stream::gpu::{BLOCK_POINTS, DrawList, PointPool};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use wgpu::CurrentSurfaceTexture as Current;
use winit::window::Window;

const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

/// What went wrong on the adapter, as its own threads tell it.
#[derive(Debug, Default)]
struct Trouble {
    lost: AtomicBool,
    words: Mutex<Option<String>>,
}

/// Device, surface and targets of one window.
pub struct Gpu {
    instance: wgpu::Instance,
    window: Arc<Window>,
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    device: wgpu::Device,
    queue: wgpu::Queue,
    renderer: Renderer,
    canvas: Canvas,
    points: PoolPoints,
    egui: egui_wgpu::Renderer,
    /// Textures that the panels drew last a frame ago.
    unused: Vec<egui::TextureId>,
    blitter: wgpu::util::TextureBlitter,
    target: Option<(wgpu::Texture, wgpu::TextureView)>,
    trouble: Arc<Trouble>,
    /// The next texture of the surface is taken for lost.
    surface_lost: bool,
    presented: u64,
}

/// The panels of a frame, ready to be drawn.
pub struct Panels {
    /// Triangles.
    pub jobs: Vec<egui::ClippedPrimitive>,
    /// Pixels of a point.
    pub pixels_per_point: f32,
}

/// What a frame is to draw.
pub struct Picture<'a> {
    /// The points.
    pub list: &'a DrawList,
    /// From where.
    pub camera: &'a Camera,
    /// How.
    pub options: &'a RenderOptions,
    /// In which colours.
    pub palette: &'a Palette,
    /// The pixel whose point is asked for.
    pub pick: Option<[u32; 2]>,
}

impl Gpu {
    /// For this window; with it the pool that the stream fills.
    ///
    /// # Errors
    ///
    /// [`ViewerError`] if no adapter can draw into the window.
    pub fn new(window: Arc<Window>, limits: &Limits) -> Result<(Self, Box<dyn PointPool>), ViewerError> {
        let instance = crate::render::instance();
        let failed = |what: &str, e: &dyn std::fmt::Display| ViewerError::Graphics(format!("{what}: {e}"));
        let surface = instance.create_surface(window.clone()).map_err(|e| {
            // Without any adapter there is no interface to make one with: that has a remedy.
            match crate::render::adapter(&instance, None) {
                Err(none) => ViewerError::Render(none),
                Ok(_) => failed("the window can't be drawn into", &e),
            }
        })?;
        let adapter = crate::render::adapter(&instance, Some(&surface))?;
        let (device, queue) = pollster::block_on(adapter.request_device(&wgpu::DeviceDescriptor {
            label: Some("esker viewer"),
            required_limits: adapter.limits(),
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            ..Default::default()
        }))
        .map_err(|e| failed("the graphics adapter can't be used", &e))?;
        let trouble = Arc::new(Trouble::default());
        let lost = trouble.clone();
        device.set_device_lost_callback(move |_, words| {
            *lost.words.lock().unwrap_or_else(PoisonError::into_inner) = Some(words);
            lost.lost.store(true, Ordering::Release);
        });
        let uncaptured = trouble.clone();
        // Out of memory or a driver's fault: told, not fatal.
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            *uncaptured.words.lock().unwrap_or_else(PoisonError::into_inner) = Some(error.to_string());
        }));
        let renderer = Renderer::on_device(device.clone(), queue.clone(), &adapter.get_info(), FORMAT)?;
        let pool = renderer.pool(limits.blocks(BLOCK_POINTS), BLOCK_POINTS)?;
        let size = window.inner_size();
        let capabilities = surface.get_capabilities(&adapter);
        // Colours are coded by us: a format that codes them again would brighten them.
        let plain = capabilities.formats.iter().copied().find(|f| !f.is_srgb());
        let format = plain.or(capabilities.formats.first().copied());
        let format = format.ok_or_else(|| ViewerError::Graphics("the window has no format to draw in".into()))?;
        let mut config = surface
            .get_default_config(&adapter, size.width.max(1), size.height.max(1))
            .ok_or_else(|| ViewerError::Graphics("the graphics adapter can't draw into this window".into()))?;
        config.format = format;
        config.present_mode = wgpu::PresentMode::AutoVsync;
        let canvas = renderer.canvas(true);
        let egui = egui_wgpu::Renderer::new(&device, FORMAT, egui_wgpu::RendererOptions::default());
        let blitter = wgpu::util::TextureBlitter::new(&device, format);
        let points = pool.points();
        let mut gpu = Self {
            instance,
            window,
            surface,
            config,
            device,
            queue,
            renderer,
            canvas,
            points,
            egui,
            unused: Vec::new(),
            blitter,
            target: None,
            trouble,
            surface_lost: false,
            presented: 0,
        };
        gpu.configure();
        Ok((gpu, Box::new(pool)))
    }

    /// The adapter's name.
    pub fn adapter_name(&self) -> &str {
        self.renderer.adapter_name()
    }

    /// The most pixels on a side.
    pub fn max_side_px(&self) -> u32 {
        self.renderer.max_size_px()
    }

    /// Is the device lost? Then this is of no use any more.
    pub fn is_lost(&self) -> bool {
        self.trouble.lost.load(Ordering::Acquire)
    }

    /// What the adapter complained about since it was asked last.
    pub fn trouble(&self) -> Option<String> {
        self.trouble.words.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// Loses the device, as a driver's reset would: for tests.
    pub fn lose(&self) {
        self.device.destroy();
    }

    /// Takes the surface for lost, as a display that goes away would make it: for tests.
    pub fn lose_surface(&mut self) {
        self.surface_lost = true;
    }

    /// How often a picture was shown in the window.
    pub fn presented(&self) -> u64 {
        self.presented
    }

    /// The window has this size now; a side of 0 draws nothing.
    pub fn resize(&mut self, [width, height]: [u32; 2]) {
        if width == 0 || height == 0 {
            return;
        }
        let most = self.max_side_px();
        (self.config.width, self.config.height) = (width.min(most), height.min(most));
        self.target = None;
        self.configure();
    }

    /// The size of the picture.
    pub fn size_px(&self) -> [u32; 2] {
        [self.config.width, self.config.height]
    }

    fn configure(&mut self) {
        if !self.is_lost() {
            self.surface.configure(&self.device, &self.config);
        }
    }

    fn target(&mut self) -> (wgpu::Texture, wgpu::TextureView) {
        let [width, height] = self.size_px();
        let (texture, view) = self.target.get_or_insert_with(|| {
            let texture = self.device.create_texture(&wgpu::TextureDescriptor {
                label: Some("picture"),
                size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: FORMAT,
                usage: wgpu::TextureUsages::RENDER_ATTACHMENT
                    | wgpu::TextureUsages::TEXTURE_BINDING
                    | wgpu::TextureUsages::COPY_SRC,
                view_formats: &[],
            });
            let view = texture.create_view(&Default::default());
            (texture, view)
        });
        (texture.clone(), view.clone())
    }

    /// Draws the points, and asks for the point under a pixel.
    ///
    /// # Errors
    ///
    /// As [`Renderer::encode`].
    pub fn draw_points(&mut self, picture: &Picture<'_>) -> Result<Option<PickRequest>, ViewerError> {
        let (_, view) = self.target();
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let look = View { camera: picture.camera, options: picture.options, palette: picture.palette };
        self.renderer.encode(&mut self.canvas, &mut encoder, &self.points, picture.list, look, &view)?;
        let pick = picture.pick.and_then(|px| self.renderer.request_pick(&self.canvas, &mut encoder, px, 8));
        self.queue.submit([encoder.finish()]);
        Ok(pick.map(|mut request| {
            request.submitted();
            request
        }))
    }

    /// Brings textures of the panels up to date: at once, since egui tells every change only once.
    pub fn update_textures(&mut self, mut delta: egui::TexturesDelta) {
        // What was let go of a frame ago is not drawn any more.
        for id in self.unused.drain(..) {
            self.egui.free_texture(&id);
        }
        for (id, deltas) in delta.set.drain() {
            for delta in deltas {
                self.egui.update_texture(&self.device, &self.queue, id, &delta);
            }
        }
        self.unused.extend(delta.free.drain());
    }

    /// Draws the panels over the points.
    pub fn draw_panels(&mut self, panels: &Panels) {
        let (_, view) = self.target();
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let screen =
            egui_wgpu::ScreenDescriptor { size_in_pixels: self.size_px(), pixels_per_point: panels.pixels_per_point };
        // On a device that was lost a moment ago this panics instead of giving an error.
        let updated = catch_unwind(AssertUnwindSafe(|| {
            self.egui.update_buffers(&self.device, &self.queue, &mut encoder, &panels.jobs, &screen)
        }));
        let Ok(before) = updated else {
            self.trouble.lost.store(true, Ordering::Release);
            return;
        };
        {
            let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("panels"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store },
                })],
                ..Default::default()
            });
            self.egui.render(&mut pass.forget_lifetime(), &panels.jobs, &screen);
        }
        self.queue.submit(before.into_iter().chain([encoder.finish()]));
    }

    /// Shows the picture in the window, if the window can be drawn into now.
    pub fn present(&mut self) {
        let (_, view) = self.target();
        let lost = std::mem::take(&mut self.surface_lost);
        let texture = match if lost { Current::Lost } else { self.surface.get_current_texture() } {
            Current::Success(texture) => texture,
            Current::Suboptimal(texture) => {
                drop(texture);
                return self.configure();
            }
            Current::Outdated => return self.configure(),
            Current::Lost => {
                if !self.is_lost()
                    && let Ok(surface) = self.instance.create_surface(self.window.clone())
                {
                    self.surface = surface;
                    self.configure();
                }
                return;
            }
            // Nothing to see now: the next frame may be.
            _ => return,
        };
        let mut encoder = self.device.create_command_encoder(&Default::default());
        self.blitter.copy(&self.device, &mut encoder, &view, &texture.texture.create_view(&Default::default()));
        self.queue.submit([encoder.finish()]);
        self.window.pre_present_notify();
        self.queue.present(texture);
        self.presented += 1;
    }

    /// Lets the adapter tell what it has done.
    pub fn poll(&self) {
        // A device that is lost is noticed by its callback.
        let _ = self.device.poll(wgpu::PollType::Poll);
    }

    /// The picture as it is now: waits for the adapter.
    ///
    /// # Errors
    ///
    /// [`ViewerError::Graphics`] if the adapter fails.
    pub fn read(&mut self) -> Result<Image, ViewerError> {
        let failed = |e: &dyn std::fmt::Display| ViewerError::Graphics(format!("the picture can't be read: {e}"));
        let (texture, _) = self.target();
        let [width, height] = self.size_px();
        let row_bytes = (width * 4).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("picture"),
            size: u64::from(row_bytes) * u64::from(height),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row_bytes), rows_per_image: None };
        encoder.copy_texture_to_buffer(
            texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo { buffer: &buffer, layout },
            wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        );
        self.queue.submit([encoder.finish()]);
        let (sender, receiver) = std::sync::mpsc::channel();
        buffer.map_async(wgpu::MapMode::Read, .., move |result| {
            // The receiver lives until the result is there.
            let _ = sender.send(result);
        });
        self.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|e| failed(&e))?;
        receiver.recv().map_err(|e| failed(&e))?.map_err(|e| failed(&e))?;
        let bytes = buffer.get_mapped_range(..).map_err(|e| failed(&e))?;
        let mut rgba = Vec::with_capacity(width as usize * height as usize * 4);
        for row in bytes.chunks_exact(row_bytes as usize) {
            // What lies behind the window does not shine through.
            rgba.extend(row[..width as usize * 4].chunks_exact(4).flat_map(|p| [p[0], p[1], p[2], 255]));
        }
        Ok(Image { width, height, rgba })
    }
}
