//! What the viewer remembers from one time to the next.

use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Settings that belong to the user, not to a store. What is missing or makes no sense is as at the first time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Remembered {
    /// Width and height of the window.
    pub window: [u32; 2],
    /// The most points that are drawn.
    pub budget_points: u64,
    /// Nothing finer than so many pixels is loaded.
    pub error_px: f64,
    /// The size of a splat relative to the spacing.
    pub splat: f64,
    /// The least radius of a splat.
    pub least_px: f64,
    /// Strength of the eye-dome lighting; 0: off.
    pub edl: f32,
    /// The width of the points' shadows.
    pub shadow_px: f64,
    /// How much haze there is, from 0 to 1.
    pub haze: f64,
    /// `round`, `square` or `paraboloid`.
    pub shape: String,
    /// The full vertical field of view.
    pub fov_y_deg: f64,
    /// Are the panels shown?
    pub panels: bool,
    /// Which of them are open.
    pub open: Vec<String>,
    /// Has the help been seen? Until then a line says what comes first.
    pub knows_help: bool,
}

impl Default for Remembered {
    fn default() -> Self {
        Self {
            window: [1280, 800],
            budget_points: 2_000_000,
            error_px: 1.0,
            splat: 0.75,
            least_px: 0.5,
            edl: 1.0,
            shadow_px: 0.0,
            haze: 0.0,
            shape: "round".into(),
            fov_y_deg: 50.0,
            panels: true,
            open: vec!["scans".into(), "color".into()],
            knows_help: false,
        }
    }
}

impl Remembered {
    /// The file: under `$XDG_CONFIG_HOME`, `$HOME/.config` or `%APPDATA%`; `None` if there is no such place.
    pub fn place() -> Option<PathBuf> {
        let folder = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
        let home = || folder("HOME").map(|home| home.join(".config"));
        let config = folder("XDG_CONFIG_HOME").or_else(|| folder("APPDATA")).or_else(home)?;
        Some(config.join("esker").join("viewer.json"))
    }

    /// What is in the file; the defaults if there is none, or nothing that can be read.
    pub(super) fn load(path: &Path) -> Self {
        let text = std::fs::read_to_string(path).unwrap_or_default();
        serde_json::from_str::<Self>(&text).unwrap_or_default().checked()
    }

    /// Numbers within their ranges.
    fn checked(mut self) -> Self {
        let usual = Self::default();
        let within =
            |value: f64, low: f64, high: f64, usual: f64| if (low..=high).contains(&value) { value } else { usual };
        self.window = self.window.map(|side| side.clamp(320, 16_384));
        self.budget_points = self.budget_points.clamp(10_000, 200_000_000);
        self.error_px = within(self.error_px, 0.1, 100.0, usual.error_px);
        self.splat = within(self.splat, 0.05, 4.0, usual.splat);
        self.least_px = within(self.least_px, 0.5, 10.0, usual.least_px);
        self.edl = within(f64::from(self.edl), 0.0, 10.0, f64::from(usual.edl)) as f32;
        self.shadow_px = within(self.shadow_px, 0.0, 10.0, usual.shadow_px);
        self.haze = within(self.haze, 0.0, 1.0, usual.haze);
        self.fov_y_deg = within(self.fov_y_deg, 5.0, 140.0, usual.fov_y_deg);
        self
    }

    /// Writes the file, whole or not at all.
    ///
    /// # Errors
    ///
    /// [`std::io::Error`] if it can't be written.
    pub(super) fn save(&self, path: &Path) -> std::io::Result<()> {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        let temporary = path.with_extension(format!("{}.part", std::process::id()));
        let text = serde_json::to_string_pretty(self).map_err(std::io::Error::other)?;
        std::fs::write(&temporary, text)?;
        let done = std::fs::rename(&temporary, path);
        if done.is_err() {
            let _ = std::fs::remove_file(&temporary);
        }
        done
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_remembered_comes_back_and_nonsense_does_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/er/viewer.json");
        assert_eq!(Remembered::load(&path), Remembered::default());
        let mine =
            Remembered { budget_points: 5_000_000, splat: 1.5, open: vec!["clip".into()], ..Remembered::default() };
        mine.save(&path).unwrap();
        assert_eq!(Remembered::load(&path), mine);
        std::fs::write(&path, r#"{"splat": 1e9, "edl": null}"#).unwrap();
        assert_eq!(Remembered::load(&path), Remembered::default());
        std::fs::write(&path, r#"{"splat": 1e9, "window": [1, 1], "later": 1}"#).unwrap();
        let odd = Remembered::load(&path);
        assert_eq!((odd.splat, odd.window), (0.75, [320, 320]));
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1, "no temporary file stays");
    }
}
