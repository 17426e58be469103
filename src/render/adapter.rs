//! Which graphics adapter draws.

use super::RenderError;

/// Part of the name of the adapter that is wanted, as other programs on wgpu read it.
const ADAPTER_NAME: &str = "WGPU_ADAPTER_NAME";

/// The machine's graphics interfaces, or those of `WGPU_BACKEND` (`vulkan`, `metal`, `dx12`; several with commas).
pub fn instance() -> wgpu::Instance {
    wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env())
}

/// The fastest adapter, a graphics card if there is one, else software; or the one whose name `WGPU_ADAPTER_NAME` is a part
/// of, upper and lower case alike. `surface` is what it must draw into.
///
/// # Errors
///
/// [`RenderError::NoAdapter`] if there is none at all, [`RenderError::UnknownAdapter`] if none has the name.
pub fn adapter(instance: &wgpu::Instance, surface: Option<&wgpu::Surface<'_>>) -> Result<wgpu::Adapter, RenderError> {
    match std::env::var(ADAPTER_NAME) {
        Ok(name) if !name.is_empty() => named(instance, surface, name),
        _ => pollster::block_on(instance.request_adapter(&wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            compatible_surface: surface,
            ..Default::default()
        }))
        .map_err(RenderError::NoAdapter),
    }
}

fn named(
    instance: &wgpu::Instance,
    surface: Option<&wgpu::Surface<'_>>,
    name: String,
) -> Result<wgpu::Adapter, RenderError> {
    let all = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let mut there: Vec<_> = all.into_iter().filter(|a| surface.is_none_or(|s| a.is_surface_supported(s))).collect();
    let wanted = name.to_lowercase();
    match there.iter().position(|a| a.get_info().name.to_lowercase().contains(&wanted)) {
        Some(place) => Ok(there.swap_remove(place)),
        None => {
            let mut known: Vec<String> = there.iter().map(|a| a.get_info().name).collect();
            known.dedup();
            Err(RenderError::UnknownAdapter { name, known: known.join(", ") })
        }
    }
}

/// Name, interface and kind: `llvmpipe (LLVM 15.0.6, 256 bits) (Vulkan, Cpu)`.
pub(super) fn described(info: &wgpu::AdapterInfo) -> String {
    format!("{} ({:?}, {:?})", info.name, info.backend, info.device_type)
}
