//! `esker render`: pictures of stores, drawn by whatever adapter there is. Without one this fails: pictures are part of
//! the product.

use crate::support::esker_ok;
use std::fs;

fn pixels(path: &str) -> (u32, u32, Vec<u8>) {
    let decoder = png::Decoder::new(std::io::BufReader::new(fs::File::open(path).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    (info.width, info.height, bytes)
}

/// An unlit point of colour (200, 100, 50) gives exactly that pixel, whether its file had 8 or 16 bits.
#[test]
fn colours_reach_the_picture_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let view =
        r#"{"eye":[0,-3,0],"target":[0,0,0],"up":[0,0,1],"projection":"perspective","fov_y_deg":60,"size":[64,48]}"#;
    fs::write(path("view.json"), view).unwrap();
    for (name, ty, factor) in [("eight", "uchar", 1_u16), ("sixteen", "ushort", 256), ("full", "ushort", 257)] {
        let rows: String = (0..25)
            .map(|i| {
                let (x, z) = (f64::from(i % 5 - 2) * 0.1, f64::from(i / 5 - 2) * 0.1);
                format!("{x} 0 {z} {} {} {}\n", 200 * factor, 100 * factor, 50 * factor)
            })
            .collect();
        let header = format!(
            "ply\nformat ascii 1.0\nelement vertex 25\nproperty double x\nproperty double y\nproperty double z\n\
             property {ty} red\nproperty {ty} green\nproperty {ty} blue\nend_header\n"
        );
        fs::write(path("p.ply"), header + &rows).unwrap();
        let (store, picture) = (path(&format!("{name}.esker")), path(&format!("{name}.png")));
        esker_ok(&["ingest", &store, &path("p.ply")]);
        esker_ok(&["render", &store, "--view", &path("view.json"), "--unlit", "-o", &picture]);
        let (width, height, bytes) = pixels(&picture);
        assert_eq!((width, height), (64, 48));
        let channels = bytes.len() / (64 * 48);
        let drawn = bytes.chunks_exact(channels).filter(|p| p[..3] == [200, 100, 50]).count();
        assert!(drawn >= 25, "{name}: {drawn} pixels have the colour");
        let reddish = bytes.chunks_exact(channels).filter(|p| p[0] > p[2]).count();
        assert_eq!(reddish, drawn, "{name}: a point has another colour");
    }
}

#[test]
fn a_whole_site_fits_its_default_picture() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    esker_ok(&["generate", "torus", "--points", "200000", "-o", &path("t.las")]);
    esker_ok(&["ingest", &path("t.esker"), &path("t.las")]);
    for mode in ["rgb", "height", "intensity", "class", "return", "scan"] {
        let picture = path(&format!("{mode}.png"));
        esker_ok(&["render", &path("t.esker"), "--color", mode, "--size", "320x240", "-o", &picture]);
        let (width, height, bytes) = pixels(&picture);
        let channels = bytes.len() / (320 * 240);
        assert_eq!((width, height), (320, 240));
        // The background's gradient is the same along a row.
        let row = |y: usize| &bytes[y * 320 * channels..(y + 1) * 320 * channels];
        let varied = |y: usize| row(y).chunks_exact(channels).any(|p| p != &row(y)[..channels]);
        assert!((0..240).filter(|&y| varied(y)).count() > 60, "{mode}: hardly anything was drawn");
        assert!(!varied(0) && !varied(239), "{mode}: the site is cut off");
    }
}
