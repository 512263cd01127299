//! Coordinates at which the errors of a machine may change abruptly, and coordinates at which they must be sampled so that no feature is missed.

use volcomp_curve::{Curve, Field};

use crate::Machine;

impl Machine {
    /// The nodes of the machine's curves and grids along each axis, mm or deg, inside and outside the travel: where an error may change
    /// abruptly ([`Curve::breakpoints`](volcomp_curve::Curve::breakpoints)). Ascending, without duplicates.
    pub fn nodes(&self) -> Vec<Vec<f64>> {
        self.along_axes(Curve::breakpoints)
    }

    /// The coordinates along each axis, mm or deg, at which the machine's curves must be sampled: their nodes, and as many points between
    /// them as the kind of curve needs ([`Curve::places`](volcomp_curve::Curve::places)). Equidistant samples alone could hit an error that
    /// repeats with the pitch of a screw only at its zeros. Within the travel, including its ends; ascending, without duplicates.
    pub fn places(&self) -> Vec<Vec<f64>> {
        let mut places = self.along_axes(Curve::places);
        for (places, axis) in places.iter_mut().zip(self.axes()) {
            let [low, high] = axis.travel;
            places.retain(|place| (low..=high).contains(place));
            places.extend([low, high]);
            in_order(places);
        }
        places
    }

    /// The coordinates `of` each curve along its axis, and the nodes of grids.
    fn along_axes(&self, of: fn(&Curve) -> Vec<f64>) -> Vec<Vec<f64>> {
        let mut along = vec![Vec::new(); self.axes().len()];
        for (name, curve) in self.errors() {
            for field in curve.fields() {
                match field {
                    Field::Curve(curve) => {
                        let own = self.index_of(name.axis).ok();
                        if let Some(along) = own.and_then(|own| along.get_mut(own)) {
                            along.extend(of(curve));
                        }
                    }
                    Field::Grid(grid) => {
                        for (axis, nodes) in grid.axes().into_iter().zip(grid.nodes()) {
                            if let Some(along) = along.get_mut(axis) {
                                along.extend(nodes);
                            }
                        }
                    }
                }
            }
        }
        for along in &mut along {
            in_order(along);
        }
        along
    }
}

fn in_order(places: &mut Vec<f64>) {
    places.sort_by(f64::total_cmp);
    places.dedup();
}
