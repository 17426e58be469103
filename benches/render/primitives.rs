//! The same discs as three kinds of primitives.

use super::{Error, RUNS, SIZE_PX, spread, timed};

const POINTS: u32 = 1 << 20;

const WGSL: &str = "
    struct Disc { @builtin(position) at: vec4<f32>, @location(0) @interpolate(flat) center: vec2<f32> }
    @group(0) @binding(0) var<storage, read> points: array<vec4<f32>>;
    override radius: f32 = 1.0;
    const SIZE = vec2<f32>(1280.0, 720.0);
    fn disc(index: u32, corner: vec2<f32>) -> Disc {
        let point = points[index];
        let px = point.xy + radius * corner;
        return Disc(vec4<f32>(px / SIZE * 2.0 - 1.0, point.z, 1.0), vec2<f32>(point.x, SIZE.y - point.y));
    }
    @vertex fn triangle(@builtin(vertex_index) i: u32) -> Disc {
        var corner = vec2<f32>(0.0, 2.0);
        if (i % 3u == 1u) { corner = vec2<f32>(-1.7320508, -1.0); }
        else if (i % 3u == 2u) { corner = vec2<f32>(1.7320508, -1.0); }
        return disc(i / 3u, corner);
    }
    @vertex fn quad(@builtin(vertex_index) i: u32) -> Disc {
        let k = i % 6u;
        let x = select(-1.0, 1.0, k == 1u || k == 2u || k == 4u);
        let y = select(-1.0, 1.0, k == 2u || k == 4u || k == 5u);
        return disc(i / 6u, vec2<f32>(x, y));
    }
    @vertex fn strip(@builtin(vertex_index) k: u32, @builtin(instance_index) i: u32) -> Disc {
        return disc(i, vec2<f32>(select(-1.0, 1.0, (k & 1u) == 1u), select(-1.0, 1.0, (k & 2u) == 2u)));
    }
    @vertex fn point(@builtin(vertex_index) i: u32) -> Disc { return disc(i, vec2<f32>(0.0)); }
    @fragment fn round(d: Disc) -> @location(0) vec4<f32> {
        let away = d.at.xy - d.center;
        if (dot(away, away) > radius * radius) { discard; }
        return vec4<f32>(1.0);
    }
    @fragment fn whole(d: Disc) -> @location(0) vec4<f32> { return vec4<f32>(1.0); }
";

pub fn compare() -> Result<(), Error> {
    let adapter = esker::render::adapter(&esker::render::instance(), None)?;
    let (device, queue) = pollster::block_on(adapter.request_device(&Default::default()))?;
    let buffer = device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: u64::from(POINTS) * 16,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    // Anywhere on the image, at any depth: a Weyl sequence in three dimensions.
    let along = |i: u32, factor: f64| (f64::from(i) * factor).fract() as f32;
    let points: Vec<[f32; 4]> = (0..POINTS)
        .map(|i| {
            let at = [along(i, 0.819_172_513_396_164_4), along(i, 0.671_043_606_703_789_2)];
            [at[0] * SIZE_PX[0] as f32, at[1] * SIZE_PX[1] as f32, along(i, 0.549_700_477_901_911_8), 0.0]
        })
        .collect();
    queue.write_buffer(&buffer, 0, bytemuck::cast_slice(&points));
    let texture = |format| {
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width: SIZE_PX[0], height: SIZE_PX[1], depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            view_formats: &[],
        });
        texture.create_view(&Default::default())
    };
    let (colors, depths) = (texture(wgpu::TextureFormat::Rgba8Unorm), texture(wgpu::TextureFormat::Depth32Float));
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: None,
        source: wgpu::ShaderSource::Wgsl(WGSL.into()),
    });
    println!("\n| discs of radius | triangle | quad, 6 vertices | quad, strip of 4 | point primitive (1 pixel) |");
    println!("|---|---|---|---|---|");
    for radius in [0.75, 1.5, 3.0, 6.0] {
        print!("| {radius} px |");
        let (list, strip) = (wgpu::PrimitiveTopology::TriangleList, wgpu::PrimitiveTopology::TriangleStrip);
        let kinds = [
            ("triangle", "round", list, 3 * POINTS, 1),
            ("quad", "round", list, 6 * POINTS, 1),
            ("strip", "round", strip, 4, POINTS),
            ("point", "whole", wgpu::PrimitiveTopology::PointList, POINTS, 1),
        ];
        for (vertex, fragment, topology, vertices, instances) in kinds {
            let constants = [("radius", radius)];
            let compilation_options = wgpu::PipelineCompilationOptions { constants: &constants, ..Default::default() };
            let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: None,
                layout: None,
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some(vertex),
                    compilation_options: compilation_options.clone(),
                    buffers: &[],
                },
                primitive: wgpu::PrimitiveState { topology, ..Default::default() },
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: wgpu::TextureFormat::Depth32Float,
                    depth_write_enabled: Some(true),
                    depth_compare: Some(wgpu::CompareFunction::Greater),
                    stencil: Default::default(),
                    bias: Default::default(),
                }),
                multisample: Default::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some(fragment),
                    compilation_options,
                    targets: &[Some(wgpu::TextureFormat::Rgba8Unorm.into())],
                }),
                multiview_mask: None,
                cache: None,
            });
            let entries = [wgpu::BindGroupEntry { binding: 0, resource: buffer.as_entire_binding() }];
            let layout = &pipeline.get_bind_group_layout(0);
            let group = device.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout, entries: &entries });
            let mut times = Vec::new();
            for _ in 0..RUNS {
                let mut encoder = device.create_command_encoder(&Default::default());
                {
                    let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                            view: &colors,
                            depth_slice: None,
                            resolve_target: None,
                            ops: Default::default(),
                        })],
                        depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                            view: &depths,
                            depth_ops: Some(wgpu::Operations {
                                load: wgpu::LoadOp::Clear(0.0),
                                store: wgpu::StoreOp::Store,
                            }),
                            stencil_ops: None,
                        }),
                        ..Default::default()
                    });
                    pass.set_pipeline(&pipeline);
                    pass.set_bind_group(0, &group, &[]);
                    pass.draw(0..vertices, 0..instances);
                }
                timed(&mut times, || -> Result<(), Error> {
                    queue.submit([encoder.finish()]);
                    device.poll(wgpu::PollType::wait_indefinitely())?;
                    Ok(())
                })?;
            }
            print!(" {} |", spread(times, POINTS.into()));
        }
        println!();
    }
    Ok(())
}
