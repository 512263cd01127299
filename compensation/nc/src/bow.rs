//! Arcs by their chord and their sag: what stays well-defined where an arc is so shallow that its centre is not.

/// An arc of less than a whole turn between two places.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bow {
    pub(crate) start: [f64; 2],
    pub(crate) end: [f64; 2],
    /// How far the middle of the arc is from that of its chord, mm.
    pub(crate) sag: f64,
    pub(crate) clockwise: bool,
}

impl Bow {
    pub(crate) fn chord(&self) -> f64 {
        (self.end[0] - self.start[0]).hypot(self.end[1] - self.start[1])
    }

    /// The direction from the middle of the chord to that of the arc.
    pub(crate) fn normal(&self) -> [f64; 2] {
        let chord = self.chord();
        let way = [self.end[0] - self.start[0], self.end[1] - self.start[1]];
        let side = if self.clockwise { -1.0 } else { 1.0 };
        [side * way[1] / chord, -side * way[0] / chord]
    }

    pub(crate) fn radius(&self) -> f64 {
        let half = 0.5 * self.chord();
        0.5 * (half * half / self.sag + self.sag)
    }

    /// The place at a distance from the middle of the chord along the normal.
    fn on_normal(&self, distance: f64) -> [f64; 2] {
        let normal = self.normal();
        std::array::from_fn(|i| 0.5 * (self.start[i] + self.end[i]) + distance * normal[i])
    }

    pub(crate) fn middle(&self) -> [f64; 2] {
        self.on_normal(self.sag)
    }

    pub(crate) fn centre(&self) -> [f64; 2] {
        self.on_normal(self.sag - self.radius())
    }

    /// The arc between two other places near these: of the same radius where it turns by less than a quarter, else of the same sag.
    pub(crate) fn between(&self, start: [f64; 2], end: [f64; 2]) -> Self {
        let mut other = Self {
            start,
            end,
            ..*self
        };
        let (radius, half) = (self.radius(), 0.5 * other.chord());
        if self.sag < 0.3 * radius && half < radius {
            other.sag = half * half / (radius + (radius * radius - half * half).sqrt());
        }
        other
    }
}

/// The sag of an arc that turns by an angle, rad.
pub(crate) fn sag_of(radius: f64, turns: f64) -> f64 {
    2.0 * radius * (0.25 * turns).sin().powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_at(found: [f64; 2], expected: [f64; 2]) {
        let off = (found[0] - expected[0]).hypot(found[1] - expected[1]);
        assert!(off < 1e-9, "{found:?}, expected {expected:?}");
    }

    #[test]
    fn a_quarter_a_half_and_three_quarters_of_a_circle() {
        let half_root = 0.5_f64.sqrt();
        for (turns, end, middle) in [
            (0.5, [0.0, 10.0], [10.0 * half_root, 10.0 * half_root]),
            (1.0, [-10.0, 0.0], [0.0, 10.0]),
            (1.5, [0.0, -10.0], [-10.0 * half_root, 10.0 * half_root]),
        ] {
            let bow = Bow {
                start: [10.0, 0.0],
                end,
                sag: sag_of(10.0, turns * std::f64::consts::PI),
                clockwise: false,
            };
            assert_at(bow.middle(), middle);
            assert_at(bow.centre(), [0.0, 0.0]);
            // The same arc the other way round.
            let back = Bow {
                start: bow.end,
                end: bow.start,
                clockwise: true,
                ..bow
            };
            assert_at(back.middle(), middle);
            assert_at(back.centre(), [0.0, 0.0]);
            assert!((back.radius() - 10.0).abs() < 1e-9);
        }
    }

    /// A chord that is a step longer leaves a shallow arc its radius, and a half circle its sag: neither centre jumps.
    #[test]
    fn a_step_more_of_the_chord_moves_the_centre_by_little() {
        let shallow = Bow {
            start: [10.0, 0.0],
            end: [10.4, 0.0],
            sag: 0.04 / (100.0 + 0.2_f64.hypot(100.0)),
            clockwise: false,
        };
        assert_at(shallow.centre(), [10.2, 100.0]);
        let longer = shallow.between([10.0, 0.0], [10.401, 0.0]);
        assert!((longer.radius() - shallow.radius()).abs() < 1e-9);
        let half = Bow {
            start: [0.0, 0.0],
            end: [100.0, 0.0],
            sag: 50.0,
            clockwise: false,
        };
        let longer = half.between([0.0, 0.0], [100.009, 0.0]);
        assert!(longer.centre()[1].abs() < 0.01, "{:?}", longer.centre());
    }
}
