//! Distances and heights between picked points.

use crate::geometry::DVec3;

/// Points in a row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measurement {
    points: Vec<DVec3>,
}

/// From one point to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Straight.
    pub distance: f64,
    /// In plan.
    pub horizontal: f64,
    /// Upwards.
    pub height: f64,
}

impl Measurement {
    /// One more point.
    pub fn add(&mut self, point: DVec3) {
        self.points.push(point);
    }

    /// Takes the last one back.
    pub fn undo(&mut self) {
        self.points.pop();
    }

    /// Begins anew.
    pub fn clear(&mut self) {
        self.points.clear();
    }

    /// The points.
    pub fn points(&self) -> &[DVec3] {
        &self.points
    }

    /// The way from each point to the next.
    pub fn segments(&self) -> impl Iterator<Item = Segment> + '_ {
        self.points.windows(2).map(|ends| Segment::between(ends[0], ends[1]))
    }

    /// From the first to the last point along all of them.
    pub fn length(&self) -> f64 {
        self.segments().map(|s| s.distance).sum()
    }

    /// From the first point straight to the last.
    pub fn span(&self) -> Option<Segment> {
        let (first, last) = (self.points.first()?, self.points.last()?);
        (self.points.len() > 1).then(|| Segment::between(*first, *last))
    }
}

impl Segment {
    fn between(from: DVec3, to: DVec3) -> Self {
        let way = to - from;
        Self { distance: way.length(), horizontal: way.truncate().length(), height: way.z }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_way_has_lengths_and_heights() {
        let mut way = Measurement::default();
        assert_eq!((way.length(), way.span()), (0.0, None));
        for p in [[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [3.0, 4.0, 12.0], [0.0, 0.0, 12.0]] {
            // Far from the origin nothing is lost.
            way.add(DVec3::from_array(p) + DVec3::new(690_000.0, 5_330_000.0, 500.0));
        }
        assert!((way.length() - 22.0).abs() < 1e-6);
        let span = way.span().unwrap();
        assert!((span.height - 12.0).abs() < 1e-9 && span.horizontal < 1e-6);
        way.undo();
        assert_eq!(way.segments().map(|s| s.distance.round()).collect::<Vec<_>>(), [5.0, 12.0]);
        assert_eq!(way.span().unwrap().distance.round(), 13.0);
        way.clear();
        assert!(way.points().is_empty());
    }
}
