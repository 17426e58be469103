//! Passes and reference renderer side by side. Without an adapter these tests fail: install a software Vulkan driver.

mod lists;
mod modes;
mod same_image;
mod shaders;
mod single_points;
mod support;
