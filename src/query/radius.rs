//! How far a radius reaches, in squares of distances.

/// The greatest square whose root is at most `radius`, which is not negative: `radius * radius` may be rounded below it.
pub(super) fn square_within(radius: f64) -> f64 {
    let mut square = radius * radius;
    while square.sqrt() > radius {
        square = square.next_down();
    }
    while square.is_finite() && square.next_up().sqrt() <= radius {
        square = square.next_up();
    }
    square
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_reach_just_as_far_as_the_radius() {
        let radii = [0.0, 1e-200, 1e-160, 0.1, 0.866_025_403_784_438_6, 3.0, 1e160, f64::MAX];
        let roots = (1..1000).map(|n| f64::from(n).sqrt());
        for radius in radii.into_iter().chain(roots) {
            let square = square_within(radius);
            assert!(square.sqrt() <= radius, "{radius}");
            assert!(square == f64::MAX || square.next_up().sqrt() > radius, "{radius}");
        }
        assert_eq!(square_within(0.866_025_403_784_438_6), 0.75);
        assert_eq!(square_within(f64::INFINITY), f64::INFINITY);
    }
}
