//! Values of options: sizes, lists of numbers.

/// `64MiB`, `2G`, `500000`: powers of 1024 with or without the `i`.
pub(super) fn size(text: &str) -> Result<u64, String> {
    let trimmed = text.trim();
    let split = trimmed.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(trimmed.len());
    let (number, unit) = trimmed.split_at(split);
    let factor: f64 = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "k" | "kb" | "kib" => 1024.0,
        "m" | "mb" | "mib" => 1024.0 * 1024.0,
        "g" | "gb" | "gib" => 1024.0 * 1024.0 * 1024.0,
        "t" | "tb" | "tib" => 1024.0 * 1024.0 * 1024.0 * 1024.0,
        other => return Err(format!("'{other}' is no unit; write a size such as 512MiB or 4GiB")),
    };
    let number: f64 = number.parse().map_err(|_| format!("'{text}' is no size; write one such as 512MiB"))?;
    let bytes = number * factor;
    if !(1.0..=1e18).contains(&bytes) {
        return Err(format!("'{text}' is no size that can be used"));
    }
    Ok(bytes as u64)
}

/// A size that a command can do with.
pub(super) fn memory(text: &str) -> Result<u64, String> {
    match size(text)? {
        bytes if bytes < 1 << 20 => Err("1MiB is the least".to_owned()),
        bytes => Ok(bytes),
    }
}

/// Numbers separated by commas; `inf` and `-inf` are numbers, NaN is not.
pub(super) fn numbers(text: &str) -> Result<Vec<f64>, String> {
    text.split(',')
        .map(|part| match part.trim().parse::<f64>() {
            Ok(value) if !value.is_nan() => Ok(value),
            _ => Err(format!("'{}' is no number", part.trim())),
        })
        .collect()
}

/// One number for all axes, or one per axis.
pub(super) fn per_axis(text: &str) -> Result<[f64; 3], String> {
    match numbers(text)?.as_slice() {
        [one] => Ok([*one; 3]),
        [x, y, z] => Ok([*x, *y, *z]),
        other => Err(format!("{} numbers; give one, or three separated by commas", other.len())),
    }
}

/// The name of a scan, which may begin with a dash. With two it is an option more likely, whose name was forgotten before it.
pub(super) fn name(text: &str) -> Result<String, String> {
    if text.starts_with("--") {
        return Err("it looks like an option; a scan of such a name is given by its number".into());
    }
    Ok(text.into())
}

/// As [`per_axis`], of steps.
pub(super) fn steps(text: &str) -> Result<[f64; 3], String> {
    let steps = per_axis(text)?;
    if steps.iter().all(|step| *step > 0.0 && step.is_finite()) {
        return Ok(steps);
    }
    Err(format!("'{text}' is no positive number"))
}

/// As [`per_axis`], of numbers that are finite.
pub(super) fn finite_per_axis(text: &str) -> Result<[f64; 3], String> {
    let values = per_axis(text)?;
    let finite = values.iter().all(|value| value.is_finite());
    if finite { Ok(values) } else { Err(format!("'{text}' is not finite")) }
}

/// A positive, finite number.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err(format!("'{text}' is no positive number")),
    }
}

/// A finite number that is not negative.
pub(super) fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value >= 0.0 && value.is_finite() => Ok(value),
        _ => Err(format!("'{text}' is no number from 0 up")),
    }
}

/// A count, with `k`, `M` or `G` for thousands, millions, thousand millions: `2M`.
pub(super) fn count(text: &str) -> Result<u64, String> {
    let trimmed = text.trim().replace('_', "");
    let (number, factor) = match trimmed.chars().last() {
        Some('k' | 'K') => (&trimmed[..trimmed.len() - 1], 1e3),
        Some('m' | 'M') => (&trimmed[..trimmed.len() - 1], 1e6),
        Some('g' | 'G') => (&trimmed[..trimmed.len() - 1], 1e9),
        _ => (trimmed.as_str(), 1.0),
    };
    if factor == 1.0
        && let Ok(exact) = number.parse::<u64>()
    {
        return Ok(exact);
    }
    match number.parse::<f64>() {
        Ok(value) if (0.0..=1e15).contains(&(value * factor)) && (value * factor).fract() == 0.0 => {
            Ok((value * factor) as u64)
        }
        _ => Err(format!("'{text}' is no count; write one such as 500000 or 2M")),
    }
}

/// As [`count`], from 1 up.
pub(super) fn positive_count(text: &str) -> Result<u64, String> {
    match count(text)? {
        0 => Err("it must be 1 or more".into()),
        count => Ok(count),
    }
}

/// `WxH` in pixels.
#[cfg(feature = "render")]
pub(super) fn pixels(text: &str) -> Result<[u32; 2], String> {
    let parsed = text.split_once(['x', 'X']).and_then(|(w, h)| Some([w.trim().parse().ok()?, h.trim().parse().ok()?]));
    match parsed {
        Some([w, h]) if w > 0 && h > 0 => Ok([w, h]),
        _ => Err(format!("'{text}' is no size in pixels; write one such as 1280x720")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_units() {
        assert_eq!(size("64MiB"), Ok(64 << 20));
        assert_eq!(size("1.5g"), Ok(3 << 29));
        assert_eq!(size("1000"), Ok(1000));
        assert!(memory("1MiB").is_ok() && memory("1000K").is_err() && memory("64").is_err());
        assert!(size("0").is_err() && size("-1M").is_err() && size("1X").is_err() && size("").is_err());
    }

    #[test]
    fn numbers_are_checked() {
        assert_eq!(numbers("-1, 2.5,inf"), Ok(vec![-1.0, 2.5, f64::INFINITY]));
        assert!(numbers("1,,2").is_err() && numbers("nan").is_err());
        assert!(positive("0").is_err() && positive("inf").is_err() && positive("nan").is_err());
        assert!(not_negative("0").is_ok() && not_negative("-0.1").is_err());
        assert_eq!(count("2M"), Ok(2_000_000));
        assert_eq!(count("1.5k"), Ok(1500));
        assert!(count("1.5").is_err() && count("-1").is_err());
        assert!(positive_count("0").is_err() && positive_count("1") == Ok(1));
        assert!(finite_per_axis("inf").is_err() && finite_per_axis("0,-1,2") == Ok([0.0, -1.0, 2.0]));
        assert_eq!(per_axis("0.01"), Ok([0.01; 3]));
        assert!(per_axis("1,2").is_err());
    }

    #[cfg(feature = "render")]
    #[test]
    fn sizes_of_pictures_are_checked() {
        assert_eq!(pixels("1280x720"), Ok([1280, 720]));
        assert!(pixels("0x10").is_err() && pixels("10").is_err());
    }
}
