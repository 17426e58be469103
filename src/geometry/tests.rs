//! Laws of cameras and frusta.

use super::*;
use proptest::prelude::*;

fn json(text: &str) -> Result<Camera, String> {
    serde_json::from_str(text).map_err(|e| e.to_string())
}

fn camera(eye: DVec3, fov_y_deg: f64) -> Camera {
    let fov_y_rad = fov_y_deg.to_radians();
    Camera::new(eye, eye + DVec3::new(3.0, 4.0, -1.0), DVec3::Z, Projection::Perspective { fov_y_rad }, [1280, 720])
        .unwrap()
}

#[test]
fn view_files_come_back_as_they_were() {
    let text = r#"{"eye":[1,2,3],"target":[4,5.5,6],"up":[0,0,1],"projection":"perspective","fov_y_deg":60,"size":[1280,720],"near":0.25}"#;
    let camera = json(text).unwrap();
    let back: Camera = serde_json::from_str(&serde_json::to_string(&camera).unwrap()).unwrap();
    assert_eq!(camera.eye(), back.eye());
    assert_eq!((back.near(), back.far(), back.size_px()), (0.25, None, [1280, 720]));
    let plan = json(r#"{"eye":[0,0,10],"target":[0,0,0],"projection":"orthographic","height":5,"far":50}"#).unwrap();
    assert_eq!(plan.up(), DVec3::Y);
    assert_eq!(plan.projection(), Projection::Orthographic { height: 5.0 });
}

#[test]
fn a_bad_view_file_is_refused_by_the_field() {
    let with = |extra: &str| format!(r#"{{"eye":[0,0,0],"target":[1,0,0]{extra}}}"#);
    let cases = [
        (r#"{"eye":[0,0,0]}"#.into(), "target"),
        (r#"{"eye":[0,0,0],"target":[0,0,0]}"#.into(), "target"),
        (r#"{"eye":[1e300,0,0],"target":[0,0,0]}"#.into(), "eye"),
        (with(r#","up":[2,0,0]"#), "up"),
        (with(r#","up":[0,0,0]"#), "up"),
        (with(r#","fov_y_deg":0"#), "fov_y_deg"),
        (with(r#","fov_y_deg":180"#), "fov_y_deg"),
        (with(r#","fov_y_deg":-5"#), "fov_y_deg"),
        (with(r#","height":5"#), "height"),
        (with(r#","projection":"orthographic""#), "height"),
        (with(r#","projection":"orthographic","height":0"#), "height"),
        (with(r#","projection":"fisheye""#), "fisheye"),
        (with(r#","size":[0,720]"#), "size"),
        (with(r#","size":[100000,720]"#), "size"),
        (with(r#","near":0"#), "near"),
        (with(r#","near":2,"far":1"#), "far"),
        (with(r#","fovy":3"#), "fovy"),
    ];
    for (text, field) in cases {
        let error = json(&text).expect_err(&text);
        assert!(error.contains(field), "{text}: {error}");
    }
    let nan = f64::NAN;
    let projection = Projection::Perspective { fov_y_rad: nan };
    assert!(Camera::new(DVec3::ZERO, DVec3::X, DVec3::Z, projection, [8, 8]).is_err());
    let projection = Projection::Orthographic { height: nan };
    assert!(Camera::new(DVec3::ZERO, DVec3::X, DVec3::Z, projection, [8, 8]).is_err());
    let fine = Projection::Orthographic { height: 1.0 };
    assert!(Camera::new(DVec3::splat(nan), DVec3::X, DVec3::Z, fine, [8, 8]).is_err());
    let camera = Camera::new(DVec3::ZERO, DVec3::X, DVec3::Z, fine, [8, 8]).unwrap();
    assert!(camera.clone().with_depth_range(Some(nan), None).is_err());
    assert!(camera.with_depth_range(None, Some(nan)).is_err());
}

#[test]
fn depth_is_reversed_and_reaches_infinity() {
    let camera = camera(DVec3::ZERO, 60.0).with_depth_range(Some(0.5), None).unwrap();
    let depth = |distance: f64| camera.pixel_from_relative(camera.forward() * distance).unwrap()[2];
    assert!((depth(0.5) - 1.0).abs() < 1e-12);
    assert!(depth(1e12) > 0.0 && depth(1e12) < 1e-11);
    let ended = camera.clone().with_depth_range(Some(0.5), Some(100.0)).unwrap();
    let depth = |distance: f64| ended.pixel_from_relative(ended.forward() * distance).unwrap()[2];
    assert!((depth(0.5) - 1.0).abs() < 1e-12 && depth(100.0).abs() < 1e-12);
    let flat = Projection::Orthographic { height: 10.0 };
    let flat = Camera::new(DVec3::ZERO, DVec3::X, DVec3::Z, flat, [8, 8]).unwrap();
    let bounds = WorldBox::new([5.0; 3], [90.0, 7.0, 7.0]).unwrap();
    let flat = flat.reaching(&bounds);
    for corner in bounds.corners() {
        let depth = flat.pixel_from_relative(corner).unwrap()[2];
        assert!((0.0..=1.0).contains(&depth));
    }
}

#[test]
fn a_length_has_as_many_pixels_as_its_projection() {
    let camera = camera(DVec3::new(4e6, -1e6, 4e6), 35.0);
    let (distance, length) = (20.0, 0.25);
    let up = camera.view_from_relative().row(1);
    let center = camera.forward() * distance;
    let y = |p: DVec3| camera.pixel_from_relative(p).unwrap()[1];
    let px = y(center - up * length / 2.0) - y(center + up * length / 2.0);
    assert!((px - camera.pixels_of_length(length, distance)).abs() < 1e-9);
    assert_eq!(camera.pixels_of_length(length, 0.0), f64::INFINITY);
    assert_eq!(camera.pixels_of_length(0.0, 0.0), 0.0);
}

proptest! {
    #[test]
    fn the_frustum_agrees_with_the_projection(
        eye in prop::array::uniform3(-1e7_f64..1e7),
        fov in prop::sample::select(vec![0.01, 1.0, 60.0, 120.0, 179.0]),
        point in prop::array::uniform3(-50.0_f64..50.0),
        half in prop::array::uniform3(0.0_f64..20.0),
        far in prop::option::of(1.0_f64..60.0),
    ) {
        let camera = camera(DVec3::from_array(eye), fov).with_depth_range(Some(0.1), far).unwrap();
        let frustum = camera.frustum();
        let visible = |p: DVec3| camera.pixel_from_relative(p).is_some_and(|[x, y, z]| {
            (0.0..=1280.0).contains(&x) && (0.0..=720.0).contains(&y) && (0.0..=1.0).contains(&z)
        });
        let (point, half) = (DVec3::from_array(point), DVec3::from_array(half));
        let relative = WorldBox::new((point - half).to_array(), (point + half).to_array()).unwrap();
        let containment = frustum.classify(&relative);
        for i in 0..5_u8 {
            for p in relative.corners() {
                let p = point + (p - point) * f64::from(i) / 4.0;
                // On a plane itself either answer is right.
                if frustum.contains(p * 1.000001) == frustum.contains(p * 0.999999) {
                    prop_assert_eq!(frustum.contains(p), visible(p));
                }
                match containment {
                    Containment::Inside => prop_assert!(frustum.contains(p)),
                    Containment::Outside => prop_assert!(!frustum.contains(p)),
                    Containment::Partly => {}
                }
            }
        }
    }

    #[test]
    fn the_view_of_a_whole_site_shows_every_corner(
        center in prop::array::uniform3(-1e7_f64..1e7),
        half in prop::array::uniform3(prop::sample::select(vec![0.0, 0.01, 3.0, 500.0, 1e5])),
        size in prop::array::uniform2(1_u32..4000),
    ) {
        let (center, half) = (DVec3::from_array(center), DVec3::from_array(half));
        let bounds = WorldBox::new((center - half).to_array(), (center + half).to_array()).unwrap();
        let camera = Camera::looking_at_all(&bounds, size).unwrap();
        for corner in bounds.corners() {
            let [x, y, z] = camera.pixel_from_relative(corner - camera.eye()).unwrap();
            prop_assert!((0.0..=f64::from(size[0])).contains(&x), "{} of {:?}", x, size);
            prop_assert!((0.0..=f64::from(size[1])).contains(&y), "{} of {:?}", y, size);
            prop_assert!((0.0..=1.0).contains(&z));
        }
    }

    #[test]
    fn boxes_are_measured_as_their_points_are(
        low in prop::array::uniform3(-9.0_f64..9.0), side in prop::array::uniform3(0.0_f64..9.0),
        eye in prop::array::uniform3(-20.0_f64..20.0), t in prop::array::uniform3(0.0_f64..1.0),
    ) {
        let (low, side, eye) = (DVec3::from_array(low), DVec3::from_array(side), DVec3::from_array(eye));
        let bounds = WorldBox::new(low.to_array(), (low + side).to_array()).unwrap();
        let inside = low + side * DVec3::from_array(t);
        prop_assert!(bounds.distance_to(eye) <= inside.distance(eye) + 1e-12);
        prop_assert!(bounds.farthest_distance_to(eye) >= inside.distance(eye) - 1e-12);
        let nearest = eye.clamp(bounds.min(), bounds.max());
        prop_assert!((bounds.distance_to(eye) - nearest.distance(eye)).abs() < 1e-12);
    }
}
