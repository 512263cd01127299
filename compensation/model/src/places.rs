//! Where a machine may bend, and where it has to be looked at, so that nothing of its errors falls between the places that are looked
//! at.

use volcomp_curve::{Curve, Field};

use crate::Machine;

impl Machine {
    /// The nodes of the machine's curves and grids along each axis, mm or deg: where an error may change abruptly
    /// ([`Curve::breakpoints`](volcomp_curve::Curve::breakpoints)), beyond the travel, too. Rising, none twice.
    pub fn nodes(&self) -> Vec<Vec<f64>> {
        self.along_axes(Curve::breakpoints)
    }

    /// The places along each axis, mm or deg, at which a curve of the machine has to be looked at: its nodes, and as many
    /// between them as its kind takes ([`Curve::places`](volcomp_curve::Curve::places)). Places at equal distances meet an
    /// error that repeats with the pitch of a screw at its zeros only. Within the travel, or what an axis with `modulo` has of
    /// it; its ends are among them. Rising, none twice.
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

    /// What each curve has along its axis, and the nodes of grids.
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
