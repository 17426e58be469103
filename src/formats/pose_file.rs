//! Files of poses: matrices or translations with quaternions, as text or JSON.

use super::FormatError;
use crate::geometry::{Pose, PoseError};
use serde_json::Value;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// A pose file longer than this is none.
const LONGEST: u64 = 16 << 20;

/// What a file has to hold, in words.
const EXPECTED: &str =
    "poses of 16 numbers (a row-major 4 x 4 matrix) or 7 (tx ty tz qw qx qy qz), in one line each or in 4 lines of 4";

/// Reads the poses of a file, in its order. Each is a rotation and translation, with one scale at most.
///
/// As text: a pose is a line of 16 numbers (a row-major 4 x 4 matrix), four lines of 4, or a line of 7 (a translation, then
/// a quaternion, real part first); `#` begins a remark. As JSON: the same numbers in an array, a matrix also as four arrays
/// or as `{"matrix": ..}`, or `{"translation": [x, y, z], "rotation": [w, x, y, z]}`; several poses in an array.
///
/// # Errors
///
/// [`FormatError::Malformed`] with the place of what is no pose, or is none of a rigid body.
pub fn read_poses(path: &Path) -> Result<Vec<Pose>, FormatError> {
    let malformed = |offset, expected: &str, found: String| FormatError::Malformed {
        path: path.to_owned(),
        offset,
        expected: expected.to_owned(),
        found,
    };
    let io = |action, source| FormatError::Io { path: path.to_owned(), action, source };
    // Read from its start to its end, so that a pipe will do.
    let file = File::open(path).map_err(|e| io("opening", e))?;
    let mut raw = Vec::new();
    file.take(LONGEST + 1).read_to_end(&mut raw).map_err(|e| io("reading", e))?;
    if raw.len() as u64 > LONGEST {
        return Err(malformed(LONGEST, EXPECTED, "more text".to_owned()));
    }
    let Ok(text) = std::str::from_utf8(&raw) else {
        return Err(malformed(0, EXPECTED, "no text".to_owned()));
    };
    let poses = if text.trim_start().starts_with(['[', '{']) {
        let value = serde_json::from_str(text).map_err(|e| malformed(0, "JSON", e.to_string()))?;
        from_json(&value).map_err(|found| malformed(0, EXPECTED, found))?
    } else {
        from_text(text).map_err(|(offset, found)| malformed(offset as u64, EXPECTED, found))?
    };
    Ok(poses)
}

fn from_text(text: &str) -> Result<Vec<Pose>, (usize, String)> {
    let mut poses = Vec::new();
    let mut matrix: Vec<f64> = Vec::new();
    let mut offset = 0;
    for line in text.split_inclusive('\n') {
        let content = line.split('#').next().unwrap_or("");
        let words = content.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty());
        let numbers: Option<Vec<f64>> = words.map(|w| w.parse().ok()).collect();
        let numbers = numbers.ok_or_else(|| (offset, format!("`{}`", content.trim().escape_default())))?;
        let pose = match numbers.len() {
            0 => None,
            7 | 16 if matrix.is_empty() => Some(from_numbers(&numbers)),
            4 => {
                matrix.extend(numbers);
                (matrix.len() == 16).then(|| from_numbers(&std::mem::take(&mut matrix)))
            }
            n => return Err((offset, format!("a line of {n} numbers"))),
        };
        if let Some(pose) = pose {
            poses.push(pose.map_err(|found| (offset, found))?);
        }
        offset += line.len();
    }
    if !matrix.is_empty() {
        return Err((offset, format!("{} of the 4 lines of a matrix", matrix.len() / 4)));
    }
    if poses.is_empty() {
        return Err((0, "none".to_owned()));
    }
    Ok(poses)
}

fn from_json(value: &Value) -> Result<Vec<Pose>, String> {
    if let Some(pose) = pose_of(value) {
        return Ok(vec![pose?]);
    }
    match value {
        Value::Array(items) if !items.is_empty() => {
            items.iter().map(|v| pose_of(v).unwrap_or_else(|| Err(shown(v)))).collect()
        }
        _ => Err(shown(value)),
    }
}

fn shown(value: &Value) -> String {
    let text: String = value.to_string().chars().take(60).collect();
    format!("`{text}`")
}

/// The pose that a JSON value is; `None` if it is of another form.
fn pose_of(value: &Value) -> Option<Result<Pose, String>> {
    if let Value::Object(map) = value {
        if let Some(matrix) = map.get("matrix") {
            return pose_of(matrix);
        }
        let mut all = numbers(map.get("translation")?)?;
        all.extend(numbers(map.get("rotation").or_else(|| map.get("quaternion"))?)?);
        return (all.len() == 7).then(|| from_numbers(&all));
    }
    let flat = match value {
        Value::Array(rows) if rows.len() == 4 => {
            let rows: Vec<_> = rows.iter().map(|r| numbers(r).filter(|r| r.len() == 4)).collect::<Option<_>>()?;
            rows.concat()
        }
        value => numbers(value)?,
    };
    matches!(flat.len(), 7 | 16).then(|| from_numbers(&flat))
}

fn numbers(value: &Value) -> Option<Vec<f64>> {
    value.as_array()?.iter().map(Value::as_f64).collect()
}

fn from_numbers(n: &[f64]) -> Result<Pose, String> {
    let pose = match *n {
        [x, y, z, qw, qx, qy, qz] => Pose::from_quaternion([x, y, z], [qw, qx, qy, qz]),
        _ => <&[f64; 16]>::try_from(n).map_err(|_| PoseError::LastRow).and_then(Pose::from_matrix),
    };
    let rigid = pose.and_then(|p| p.rigid_scale().map(|_| p));
    rigid.map_err(|e| format!("a pose that is none: {e}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<Pose>, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pose.txt");
        std::fs::write(&path, text).unwrap();
        read_poses(&path).map_err(|e| e.to_string())
    }

    #[test]
    fn every_form_says_the_same_pose() {
        let expected = Pose::from_quaternion([1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0]).unwrap();
        let forms = [
            "1 2 3 0 0 0 1",
            "# a half turn\n1, 2, 3, 0, 0, 0, 2\n",
            "-1 0 0 1\n0 -1 0 2\n\n0 0 1 3\n0 0 0 1",
            "-1 0 0 1 0 -1 0 2 0 0 1 3 0 0 0 1",
            "[1,2,3,0,0,0,1]",
            "[[-1,0,0,1],[0,-1,0,2],[0,0,1,3],[0,0,0,1]]",
            r#"{"matrix": [-1,0,0,1,0,-1,0,2,0,0,1,3,0,0,0,1]}"#,
            r#"[{"translation": [1,2,3], "rotation": [0,0,0,1]}]"#,
        ];
        for form in forms {
            assert_eq!(
                read(form).map(|p| p.iter().map(Pose::to_matrix).collect::<Vec<_>>()),
                Ok(vec![expected.to_matrix()]),
                "{form}"
            );
        }
        assert_eq!(read("1 2 3 1 0 0 0\n4 5 6 1 0 0 0").unwrap().len(), 2);
        assert_eq!(read("[[1,2,3,1,0,0,0],[4,5,6,1,0,0,0]]").unwrap()[1].scanner(), [4.0, 5.0, 6.0]);
    }

    #[cfg(unix)]
    #[test]
    fn poses_come_through_a_pipe() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        let poses = std::thread::scope(|scope| {
            scope.spawn(|| std::fs::write(&path, "1 2 3 1 0 0 0\n").unwrap());
            read_poses(&path).unwrap()
        });
        assert_eq!(poses[0].scanner(), [1.0, 2.0, 3.0]);
    }

    #[test]
    fn what_is_no_pose_is_refused_with_its_place() {
        let cases = [
            ("", "at byte 0: expected poses of 16 numbers"),
            ("1 2 3\n", "at byte 0: expected poses of 16 numbers (a row-major 4 x 4 matrix) or 7"),
            ("1 2 3 1 0 0 0\n1 2 x", "at byte 14: "),
            ("1 0 0 0\n0 1 0 0\n", "found 2 of the 4 lines of a matrix"),
            ("1 2 3 0 0 0 0", "the quaternion is zero"),
            ("1 0 0 0 0 1 0 0 0 0 0 0 0 0 0 1", "the matrix is singular"),
            ("1 0 0 0 0 1 0 0 0 0 2 0 0 0 0 1", "stretches axes by different factors"),
            ("1 0 0 0 0 1 0 0 0 0 1 0 5 5 5 1", "the last row is not 0 0 0 1"),
            ("[1,2]", "found `1`"),
            ("{", "expected JSON"),
            ("[[1,2,3,4]]", "found `[1,2,3,4]`"),
        ];
        for (text, expected) in cases {
            let error = read(text).unwrap_err();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
