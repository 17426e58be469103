//! Whether this machine's processor has what the program was compiled for.

/// A line for people if the processor lacks instructions that the compiler was allowed to use (`.cargo/config.toml`). To be
/// asked before anything else is done, since the system ends a program that meets one.
#[must_use]
pub fn lacks() -> Option<String> {
    message(&wanted())
}

/// The features that were compiled in, and whether they are there.
#[cfg(target_arch = "x86_64")]
fn wanted() -> Vec<(&'static str, bool)> {
    // `is_x86_feature_detected` answers yes to what was compiled in without looking.
    use std::arch::x86_64::{__cpuid, __cpuid_count};
    let highest = __cpuid(0).eax;
    let (basic, extended) = (__cpuid(1), __cpuid(0x8000_0001));
    let more = if highest < 7 { 0 } else { __cpuid_count(7, 0).ebx };
    let has = |register: u32, bit: u32| register >> bit & 1 == 1;
    let mut wanted = Vec::new();
    macro_rules! feature {
        ($name:literal, $present:expr) => {
            if cfg!(target_feature = $name) {
                wanted.push(($name, $present));
            }
        };
    }
    feature!("sse4.2", has(basic.ecx, 20));
    feature!("popcnt", has(basic.ecx, 23));
    feature!("fma", has(basic.ecx, 12));
    // Without the system's help (27) the wide registers can't be used.
    feature!("avx", has(basic.ecx, 28) && has(basic.ecx, 27));
    feature!("avx2", has(more, 5));
    feature!("bmi1", has(more, 3));
    feature!("bmi2", has(more, 8));
    feature!("lzcnt", has(extended.ecx, 5));
    wanted
}

/// Nothing is compiled in elsewhere that not every processor has.
#[cfg(not(target_arch = "x86_64"))]
fn wanted() -> Vec<(&'static str, bool)> {
    Vec::new()
}

fn message(wanted: &[(&str, bool)]) -> Option<String> {
    let missing: Vec<&str> = wanted.iter().filter(|(_, present)| !present).map(|(name, _)| *name).collect();
    (!missing.is_empty()).then(|| {
        format!(
            "this build is for processors with {}, which this one lacks; build it with RUSTFLAGS= (empty) in the environment",
            missing.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_processor_that_runs_the_tests_has_what_they_were_compiled_for() {
        assert_eq!(lacks(), None);
        // By the level that the project asks for.
        assert!(!cfg!(target_feature = "avx2") || wanted().len() == 8, "{:?}", wanted());
    }

    #[test]
    fn what_is_missing_is_named() {
        let message = message(&[("avx", true), ("avx2", false), ("bmi2", false)]).unwrap();
        assert!(message.contains("with avx2, bmi2, which this one lacks"), "{message}");
    }
}
